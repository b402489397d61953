//! Synthetic pictures with data that the encoder can leave out.

#[path = "../../../tests/stiff/made.rs"]
mod made;

pub use made::diagram;
use made::{line, noise, picture};
use ssplat::{Channels, Pixels};

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

/// A page of random letters of 5 × 7 cells, black on white, in grey stored as colour.
pub fn text() -> Pixels {
    picture(320, 256, Channels::Rgb, |x, y, _| {
        let (column, row) = (x / 12, y / 20);
        let (i, j) = (x % 12 / 2, y % 20 / 2);
        let written = i < 5 && j < 7 && column > 0 && row > 0 && noise(column / 6, row, 9) > 0.12;
        let ink = written && noise(column * 5 + i, row * 7 + j, 3) > 0.52;
        if ink { 0.05 } else { 1.0 }
    })
}
