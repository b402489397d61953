//! Converts integers to Gaussians by the specification's formulas (spec §5.1), and Gaussians to the nearest integers.

use crate::bitstream::lattice::Lattice;
use crate::bitstream::rules::most_color;
use crate::bitstream::splats::{Layout, PackedGaussian, PackedSplats, Steps};
use crate::gaussian::{Channels, Gaussian, Gaussians};
use crate::parallel;

/// Chroma steps in units of the luma step (spec §4.1).
const CHROMA_RATIOS: [f32; 4] = [1.0, 1.5, 2.0, 3.0];

/// Conversion between [`PackedGaussian`] and [`Gaussian`] for the step sizes of one file.
#[derive(Debug, Clone)]
pub struct Quantizer {
    lattice: Lattice,
    size: [u32; 2],
    channels: Channels,
    /// log₂ of the ratio of neighbouring scales.
    delta: f64,
    luma: f32,
    chroma: f32,
    /// Largest magnitude of the colour integers.
    most_color: [i16; 4],
    scales: Vec<f32>,
}

impl Quantizer {
    /// Returns the conversion for a picture of `size` pixels (width, height).
    #[must_use]
    pub fn new(steps: &Steps, layout: Layout, size: [u32; 2], channels: Channels) -> Self {
        let delta = (f64::from(steps.scale) + 4.0) / 32.0;
        let luma = (f64::from(steps.luma) / 3.0 - 7.0).exp2() as f32;
        let scales = (0..256).map(|i| (f64::from(i) * delta - 2.0).min(20.0).exp2() as f32).collect();
        let chroma = luma * CHROMA_RATIOS[usize::from(steps.chroma & 3)];
        let most_color = most_color(steps, channels);
        Quantizer { lattice: Lattice::new(steps, layout), size, channels, delta, luma, chroma, most_color, scales }
    }

    /// Returns the angle counts and position exponents for these steps.
    #[must_use]
    pub fn lattice(&self) -> &Lattice {
        &self.lattice
    }

    /// Returns the scale of index `i`, pixels.
    #[must_use]
    pub fn scale(&self, index: u8) -> f32 {
        self.scales[usize::from(index)]
    }

    /// Returns the steps of the four colour integers, in the order of [`PackedGaussian::color`].
    #[must_use]
    pub fn color_steps(&self) -> [f32; 4] {
        match self.channels {
            Channels::Grey | Channels::GreyAlpha => [self.luma; 4],
            Channels::Rgb | Channels::Rgba => [self.luma, self.chroma, self.chroma, self.luma],
        }
    }

    /// Returns the colour of the integers: grey and alpha directly, RGB by the YCoCg transform (spec §5.1).
    #[must_use]
    pub fn dequantize_color(&self, color: [i16; 4]) -> [f32; 4] {
        let steps = self.color_steps();
        let v: [f32; 4] = std::array::from_fn(|k| f32::from(color[k]) * steps[k]);
        match self.channels {
            Channels::Grey => [v[0], 0.0, 0.0, 0.0],
            Channels::GreyAlpha => [v[0], v[1], 0.0, 0.0],
            Channels::Rgb | Channels::Rgba => {
                let rest = v[0] - 0.5 * v[2];
                let alpha = if self.channels == Channels::Rgba { v[3] } else { 0.0 };
                [rest + 0.5 * v[1], v[2] + rest, rest - 0.5 * v[1], alpha]
            }
        }
    }

    /// Transforms a colour to the components of [`PackedGaussian::color`], without rounding: the inverse of the
    /// transform of spec §5.1.
    #[must_use]
    pub fn transform_color(&self, c: [f32; 4]) -> [f32; 4] {
        match self.channels {
            Channels::Grey | Channels::GreyAlpha => c,
            Channels::Rgb | Channels::Rgba => {
                [0.25 * c[0] + 0.5 * c[1] + 0.25 * c[2], c[0] - c[2], c[1] - 0.5 * (c[0] + c[2]), c[3]]
            }
        }
    }

    /// Returns the largest magnitude of each of the four colour integers (spec §4).
    #[must_use]
    pub fn most_color(&self) -> [i16; 4] {
        self.most_color
    }

    /// Returns the nearest colour integers that the format allows.
    #[must_use]
    pub fn quantize_color(&self, color: [f32; 4]) -> [i16; 4] {
        let (axes, steps) = (self.transform_color(color), self.color_steps());
        std::array::from_fn(|k| {
            if k < self.channels.count() {
                let most = f32::from(self.most_color[k]);
                (axes[k] / steps[k] + 0.5).floor().clamp(-most, most) as i16
            } else {
                0
            }
        })
    }

    /// Returns the Gaussian of the integers.
    #[must_use]
    pub fn dequantize(&self, p: &PackedGaussian) -> Gaussian {
        let [ex, ey] = self.lattice.exponents(p.major, p.minor, p.angle);
        Gaussian {
            mean: [center(p.x, ex), center(p.y, ey)],
            scale: [self.scale(p.major), self.scale(p.minor)],
            rotation: self.rotation(p.major, p.minor, p.angle),
            color: self.dequantize_color(p.color),
        }
    }

    /// Returns the angle of the integers, radians.
    #[must_use]
    pub fn rotation(&self, major: u8, minor: u8, angle: u16) -> f32 {
        (std::f64::consts::PI * f64::from(angle) / f64::from(self.lattice.angles(major, minor))) as f32
    }

    /// Returns the integers nearest to `g`: first the shape, then the nearest position in units of that shape.
    #[must_use]
    pub fn quantize(&self, g: &Gaussian) -> PackedGaussian {
        let (major, minor, angle) = self.quantize_shape(g.scale, g.rotation);
        let mut p = PackedGaussian { x: 0, y: 0, major, minor, angle, color: self.quantize_color(g.color) };
        self.place(&mut p, g.mean);
        p
    }

    /// Returns the nearest integers of the scales (pixels) and the rotation (radians).
    #[must_use]
    pub fn quantize_shape(&self, scale: [f32; 2], rotation: f32) -> (u8, u8, u16) {
        let index =
            |s: f32| ((f64::from(s).log2() + 2.0) / self.delta + 0.5).floor().clamp(0.0, self.max_scale_index()) as u8;
        let (mut s, mut turn) = (scale, f64::from(rotation) / std::f64::consts::PI);
        if s[0] < s[1] {
            s.swap(0, 1);
            turn += 0.5;
        }
        let (major, minor) = (index(s[0]), index(s[1]));
        let n = self.lattice.angles(major, minor);
        let angle = ((turn - turn.floor()) * f64::from(n) + 0.5).floor() as u16 % n;
        (major, minor, angle)
    }

    /// Moves `p` to the lattice point nearest to `mean` (pixels) in the metric of its own covariance.
    pub fn place(&self, p: &mut PackedGaussian, mean: [f32; 2]) {
        let [ex, ey] = self.lattice.exponents(p.major, p.minor, p.angle);
        let (s1, s2) = (self.scale(p.major), self.scale(p.minor));
        let (sin, cos) = self.rotation(p.major, p.minor, p.angle).sin_cos();
        let yy = s1 * s1 * sin * sin + s2 * s2 * cos * cos;
        // Regression of x on y: moving y by e moves the best x by shear·e.
        let shear = sin * cos * (s1 * s1 - s2 * s2) / yy;
        let last = [Lattice::positions(self.size[0], ex) - 1, Lattice::positions(self.size[1], ey) - 1];
        let near = nearest(mean[1], ey, last[1]);
        let mut best = f32::INFINITY;
        for y in near.saturating_sub(1)..=(near + 1).min(last[1]) {
            let dy = center(y, ey) - mean[1];
            let x = nearest(mean[0] + shear * dy, ex, last[0]);
            let dx = center(x, ex) - mean[0];
            let (u, v) = ((cos * dx + sin * dy) / s1, (cos * dy - sin * dx) / s2);
            let distance = u * u + v * v;
            if distance < best {
                (best, p.x, p.y) = (distance, x, y);
            }
        }
    }

    /// Returns whether the position of `p` lies within the picture.
    #[must_use]
    pub fn holds(&self, p: &PackedGaussian) -> bool {
        let [ex, ey] = self.lattice.exponents(p.major, p.minor, p.angle);
        p.x < Lattice::positions(self.size[0], ex) && p.y < Lattice::positions(self.size[1], ey)
    }

    /// Returns whether the format allows `index` as a scale.
    #[must_use]
    pub fn holds_scale(&self, index: i16) -> bool {
        index >= 0 && f64::from(index) <= self.max_scale_index()
    }

    /// Returns the highest scale index that the format allows: `i·δ − 2 ≤ 20`.
    fn max_scale_index(&self) -> f64 {
        (22.0 / self.delta).floor().min(255.0)
    }
}

/// Returns the centre of cell `i` at exponent `e`, pixels.
fn center(i: u32, e: i32) -> f32 {
    ((f64::from(i) + 0.5) * power(e)) as f32
}

/// Returns `2^e` for an exponent between −1022 and 1023.
fn power(e: i32) -> f64 {
    f64::from_bits(((1023 + i64::from(e)) as u64) << 52)
}

/// Returns the cell that contains the position `v` (pixels) at exponent `e`, clamped to `0..=last`.
fn nearest(v: f32, e: i32, last: u32) -> u32 {
    (f64::from(v) * power(-e)).floor().clamp(0.0, f64::from(last)) as u32
}

impl PackedSplats {
    /// Returns the conversion between the integers of this file and Gaussians.
    #[must_use]
    pub fn quantizer(&self) -> Quantizer {
        Quantizer::new(&self.steps, self.layout, [self.width, self.height], self.channels)
    }

    /// Returns all Gaussians. [`SsplatImage::gaussians`](crate::SsplatImage::gaussians) checks their memory first.
    #[must_use]
    pub fn to_gaussians(&self) -> Gaussians {
        let q = self.quantizer();
        Gaussians {
            width: self.width,
            height: self.height,
            channels: self.channels,
            blend: self.blend,
            depth: self.depth,
            background: q.dequantize_color(self.background),
            list: parallel::map(self.gaussians.len(), |i| q.dequantize(&self.gaussians[i])),
        }
    }
}
