//! Points for splat viewers: the PLY of 3D Gaussian Splatting (Kerbl et al., 2023), flat in z.
//!
//! x to the right and y down in pixels, z 0; scales as natural logarithms, rotations as quaternions w, x, y, z about z,
//! colours as coefficients of the constant spherical harmonic, opacity as a logit. Viewers composite the points by
//! opacity, so they show the Gaussians and not the picture.

use ssplat::{Channels, Gaussians};

/// The constant spherical harmonic, `1/(2·√π)`.
const HARMONIC: f32 = 0.282_094_8;

/// Opacity of Gaussians without alpha, and the largest opacity, because the logit of 1 is infinite.
const OPAQUE: f32 = 0.999;

/// Thickness in units of the minor scale.
const THICKNESS: f32 = 1e-3;

/// Properties of a point, in order.
const PROPERTIES: [&str; 17] = [
    "x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2", "rot_0",
    "rot_1", "rot_2", "rot_3",
];

/// Returns the file.
pub fn write(picture: &Gaussians) -> Vec<u8> {
    let mut header = format!(
        "ply\nformat binary_little_endian 1.0\ncomment ssplat: pixels, y down, picture {} x {}\nelement vertex {}\n",
        picture.width,
        picture.height,
        picture.list.len()
    );
    for property in PROPERTIES {
        header += &format!("property float {property}\n");
    }
    header += "end_header\n";
    let mut out = header.into_bytes();
    for g in &picture.list {
        let [red, green, blue] = match picture.channels {
            Channels::Grey | Channels::GreyAlpha => [g.color[0]; 3],
            Channels::Rgb | Channels::Rgba => [g.color[0], g.color[1], g.color[2]],
        };
        let alpha = picture.channels.alpha().map_or(OPAQUE, |k| g.color[k].clamp(1.0 - OPAQUE, OPAQUE));
        let (sin, cos) = (0.5 * g.rotation).sin_cos();
        let [s1, s2] = g.scale;
        let point: [f32; PROPERTIES.len()] = [
            g.mean[0],
            g.mean[1],
            0.0,
            0.0,
            0.0,
            1.0,
            (red - 0.5) / HARMONIC,
            (green - 0.5) / HARMONIC,
            (blue - 0.5) / HARMONIC,
            (alpha / (1.0 - alpha)).ln(),
            s1.ln(),
            s2.ln(),
            (THICKNESS * s2).ln(),
            cos,
            0.0,
            0.0,
            sin,
        ];
        out.extend(point.iter().flat_map(|v| v.to_le_bytes()));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use ssplat::{Blend, Gaussian};

    #[test]
    fn a_point_has_the_properties_that_viewers_look_for() {
        let g = Gaussian { mean: [3.0, 4.0], scale: [2.0, 0.5], rotation: 1.0, color: [0.5, 1.0, 0.0, 0.0] };
        let (channels, blend) = (Channels::Rgb, Blend::Sum);
        let picture = Gaussians {
            width: 8,
            height: 6,
            channels,
            depth: ssplat::Depth::Eight,
            blend,
            background: [0.0; 4],
            list: vec![g; 2],
        };
        let file = write(&picture);
        let end = b"end_header\n";
        let at = file.windows(end.len()).position(|w| w == end).unwrap() + end.len();
        let header = String::from_utf8(file[..at].to_vec()).unwrap();
        assert!(header.starts_with("ply\nformat binary_little_endian 1.0\n") && header.contains("element vertex 2\n"));
        let names: Vec<&str> = header.lines().filter_map(|l| l.strip_prefix("property float ")).collect();
        assert_eq!(file.len() - at, 2 * 4 * names.len());
        let value = |name: &str| {
            let from = at + 4 * names.iter().position(|n| *n == name).unwrap();
            f32::from_le_bytes(file[from..from + 4].try_into().unwrap())
        };
        assert_eq!([value("x"), value("y"), value("z")], [3.0, 4.0, 0.0]);
        assert_eq!([value("f_dc_0"), value("f_dc_1") + value("f_dc_2")], [0.0, 0.0]);
        assert!((value("f_dc_1") * 0.282_094_8 - 0.5).abs() < 1e-6);
        assert!((value("scale_0").exp() - 2.0).abs() < 1e-6 && value("scale_2") < value("scale_1"));
        // The x axis, rotated by the quaternion: 1 − 2z² and 2wz.
        let (w, z) = (value("rot_0"), value("rot_3"));
        assert!((1.0 - 2.0 * z * z - 1f32.cos()).abs() < 1e-6 && (2.0 * w * z - 1f32.sin()).abs() < 1e-6);
        assert!((1.0 / (1.0 + (-value("opacity")).exp()) - OPAQUE).abs() < 1e-6);
    }
}
