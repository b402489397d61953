//! Pictures made by rule that leave something out.

use ssplat::{Channels, Pixels, Samples};

/// A picture of `channels` from values in `0..=1`, by pixel and channel.
fn picture(width: u32, height: u32, channels: Channels, value: impl Fn(u32, u32, usize) -> f64) -> Pixels {
    let count = channels.count();
    let mut samples = Vec::with_capacity(width as usize * height as usize * count);
    for y in 0..height {
        for x in 0..width {
            samples.extend((0..count).map(|k| (value(x, y, k).clamp(0.0, 1.0) * 255.0 + 0.5) as u8));
        }
    }
    Pixels::new(width, height, channels, Samples::U8(samples)).expect("as many samples as the size says")
}

/// Returns noise in `0..1` for a place and a channel: a hash that gives the same value everywhere and every time.
fn noise(x: u32, y: u32, k: usize) -> f64 {
    let mut h = x.wrapping_mul(0x9E37_79B1) ^ y.wrapping_mul(0x85EB_CA6B) ^ (k as u32).wrapping_mul(0xC2B2_AE35);
    for _ in 0..2 {
        h = (h ^ h >> 15).wrapping_mul(0x2C1B_3C6D);
        h = (h ^ h >> 13).wrapping_mul(0x297A_2D39);
    }
    f64::from(h >> 8) / f64::from(1 << 24)
}

/// 1 within a line of `width` pixels through the middle of a picture of `side`, at `angle` radians, 0 elsewhere.
fn line(side: u32, width: f64, angle: f64, x: u32, y: u32) -> f64 {
    let middle = f64::from(side) / 2.0;
    let (dx, dy) = (f64::from(x) + 0.5 - middle, f64::from(y) + 0.5 - middle);
    let distance = (dy * angle.cos() - dx * angle.sin()).abs();
    (width / 2.0 + 0.5 - distance).clamp(0.0, 1.0)
}

/// A flat icon: a disc and a bar in three colours, with an alpha channel that is opaque everywhere.
pub fn icon() -> Pixels {
    const SIDE: u32 = 128;
    picture(SIDE, SIDE, Channels::Rgba, |x, y, k| {
        let (dx, dy) = (f64::from(x) - 63.5, f64::from(y) - 63.5);
        let disc = (48.5 - dx.hypot(dy)).clamp(0.0, 1.0);
        let bar = (9.0 - dy.abs()).clamp(0.0, 1.0) * (30.0 - dx.abs()).clamp(0.0, 1.0);
        let layers = [[0.96, 0.96, 0.94, 1.0], [0.12, 0.45, 0.80, 1.0], [1.0, 0.85, 0.25, 1.0]];
        let under = layers[0][k] + (layers[1][k] - layers[0][k]) * disc;
        under + (layers[2][k] - under) * bar
    })
}

/// A grey scan: soft shading, strokes and grain, the same in red, green and blue.
pub fn scan() -> Pixels {
    const SIDE: u32 = 256;
    picture(SIDE, SIDE, Channels::Rgb, |x, y, _| {
        let paper = 0.93 - 0.12 * (f64::from(x) / 256.0 - 0.4).powi(2) - 0.08 * f64::from(y) / 256.0;
        let strokes = (0..5).map(|i| line(SIDE, 3.0, 0.35 + 0.55 * f64::from(i), x, y)).fold(0.0, f64::max);
        paper - 0.7 * strokes + 0.02 * (noise(x, y, 0) - 0.5)
    })
}

/// A gradient between two colours along a diagonal.
pub fn gradient() -> Pixels {
    picture(256, 256, Channels::Rgb, |x, y, k| {
        let t = f64::from(x + y) / 510.0;
        [0.10 + 0.85 * t, 0.25 + 0.30 * t, 0.60 - 0.45 * t][k]
    })
}

/// A page of made-up letters of 5 × 7 cells, black on white, in grey stored as colour.
pub fn text() -> Pixels {
    picture(320, 256, Channels::Rgb, |x, y, _| {
        let (column, row) = (x / 12, y / 20);
        let (i, j) = (x % 12 / 2, y % 20 / 2);
        let written = i < 5 && j < 7 && column > 0 && row > 0 && noise(column / 6, row, 9) > 0.12;
        let ink = written && noise(column * 5 + i, row * 7 + j, 3) > 0.52;
        if ink { 0.05 } else { 1.0 }
    })
}
