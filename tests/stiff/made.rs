//! Building blocks of synthetic pictures.

use ssplat::{Channels, Pixels, Samples};

/// Returns a picture of `channels` from values in `0..=1`, by pixel and channel.
pub fn picture(width: u32, height: u32, channels: Channels, value: impl Fn(u32, u32, usize) -> f64) -> Pixels {
    let count = channels.count();
    let mut samples = Vec::with_capacity(width as usize * height as usize * count);
    for y in 0..height {
        for x in 0..width {
            samples.extend((0..count).map(|k| (value(x, y, k).clamp(0.0, 1.0) * 255.0 + 0.5) as u8));
        }
    }
    Pixels::new(width, height, channels, Samples::U8(samples)).expect("as many samples as the size says")
}

/// Returns noise in `0..1` for a position and a channel: a hash that is the same everywhere and every time.
pub fn noise(x: u32, y: u32, k: usize) -> f64 {
    let mut h = x.wrapping_mul(0x9E37_79B1) ^ y.wrapping_mul(0x85EB_CA6B) ^ (k as u32).wrapping_mul(0xC2B2_AE35);
    for _ in 0..2 {
        h = (h ^ h >> 15).wrapping_mul(0x2C1B_3C6D);
        h = (h ^ h >> 13).wrapping_mul(0x297A_2D39);
    }
    f64::from(h >> 8) / f64::from(1 << 24)
}

/// Returns 1 within a line of `width` pixels through the middle of a picture of `side`, at `angle` radians, and 0
/// elsewhere.
pub fn line(side: u32, width: f64, angle: f64, x: u32, y: u32) -> f64 {
    let middle = f64::from(side) / 2.0;
    let (dx, dy) = (f64::from(x) + 0.5 - middle, f64::from(y) + 0.5 - middle);
    let distance = (dy * angle.cos() - dx * angle.sin()).abs();
    (width / 2.0 + 0.5 - distance).clamp(0.0, 1.0)
}

/// Returns a diagram of `side` pixels: two axes, three straight lines in saturated colours and a bar, on white.
pub fn diagram(side: u32) -> Pixels {
    const INKS: [[f64; 3]; 3] = [[0.85, 0.1, 0.1], [0.05, 0.35, 0.8], [0.1, 0.6, 0.2]];
    picture(side, side, Channels::Rgb, |x, y, k| {
        let edge = side / 10;
        if x == edge || y == side - edge {
            return 0.0;
        }
        if (edge..2 * edge).contains(&x) && (side / 2..side - edge).contains(&y) {
            return [0.95, 0.75, 0.3][k];
        }
        let strokes = INKS.iter().enumerate().map(|(i, ink)| (line(side, 1.5, 0.3 + 0.45 * i as f64, x, y), ink[k]));
        strokes.fold(1.0, |under, (cover, ink)| under + (ink - under) * cover)
    })
}
