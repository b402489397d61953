//! A drawing for figures: an ellipse at one scale for each Gaussian, with small ones above large ones.

use std::fmt::Write;

use ssplat::{Channels, Gaussians};

/// Returns the file, in pixels of the picture.
pub fn write(picture: &Gaussians) -> String {
    let (width, height) = (picture.width, picture.height);
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" viewBox=\"0 0 {width} {height}\">\n\
         <rect width=\"{width}\" height=\"{height}\" fill=\"{}\"/>\n",
        color(picture.channels, picture.background).0
    );
    let mut order: Vec<_> = picture.list.iter().collect();
    order.sort_by(|a, b| (b.scale[0] * b.scale[1]).total_cmp(&(a.scale[0] * a.scale[1])));
    for g in order {
        let ([x, y], [s1, s2]) = (g.mean, g.scale);
        let (fill, alpha) = color(picture.channels, g.color);
        let opacity = if alpha < 1.0 { format!(" fill-opacity=\"{alpha:.3}\"") } else { String::new() };
        let _ = writeln!(
            out,
            "<ellipse cx=\"{x:.3}\" cy=\"{y:.3}\" rx=\"{s1:.3}\" ry=\"{s2:.3}\" fill=\"{fill}\"{opacity} \
             transform=\"rotate({:.2} {x:.3} {y:.3})\"/>",
            g.rotation.to_degrees()
        );
    }
    out + "</svg>\n"
}

/// Returns a colour in the notation of SVG, and its alpha.
fn color(channels: Channels, color: [f32; 4]) -> (String, f32) {
    let code = |v: f32| (v.clamp(0.0, 1.0) * 255.0).round() as u8;
    let [red, green, blue] = match channels {
        Channels::Grey | Channels::GreyAlpha => [code(color[0]); 3],
        Channels::Rgb | Channels::Rgba => [code(color[0]), code(color[1]), code(color[2])],
    };
    (format!("#{red:02x}{green:02x}{blue:02x}"), channels.alpha().map_or(1.0, |k| color[k].clamp(0.0, 1.0)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use ssplat::{Blend, Gaussian};

    #[test]
    fn small_ellipses_lie_over_large_ones() {
        let at = |scale, color| Gaussian { mean: [4.0, 3.0], scale: [scale, scale / 2.0], rotation: 0.5, color };
        let gaussians = vec![at(1.0, [0.0, 1.0, 0.0, 0.5]), at(9.0, [2.0, -1.0, 0.0, 1.0])];
        let (channels, blend) = (Channels::Rgba, Blend::Sum);
        let background = [1.0, 1.0, 1.0, 1.0];
        let text = write(&Gaussians {
            width: 8,
            height: 6,
            channels,
            depth: ssplat::Depth::Eight,
            blend,
            background,
            list: gaussians,
        });
        let lines: Vec<&str> = text.lines().collect();
        assert!(lines[1].contains("#ffffff"));
        assert!(lines[2].contains("rx=\"9.000\"") && lines[2].contains("#ff0000") && !lines[2].contains("opacity"));
        assert!(lines[3].contains("fill-opacity=\"0.500\"") && lines[3].contains("rotate(28.65 4.000 3.000)"));
        assert_eq!(lines.len(), 5);
    }
}
