//! Stiff and extreme pictures, and the rows of their table; shared by the tests of the whole encoder and of the fit.

mod made;
mod row;

use ssplat::{Channels, Pixels, Target};

#[allow(unused_imports, reason = "not all who share this make pictures of their own")]
pub use made::picture;
use made::{diagram, line, noise};
pub use row::{Bound, Row};

/// A picture to fit.
pub struct Fit {
    pub name: String,
    pub pixels: Pixels,
    pub target: Target,
}

/// Returns the pictures of the table.
pub fn fits() -> Vec<Fit> {
    use Channels::{Grey, GreyAlpha, Rgb, Rgba};
    const SIDE: u32 = 48;
    let grey = |f: &dyn Fn(u32, u32) -> f64| picture(SIDE, SIDE, Grey, |x, y, _| f(x, y));
    let mut list: Vec<(String, Pixels, Target)> = Vec::new();
    let mut add = |name: &str, pixels| list.push((name.into(), pixels, Target::Gaussians(60)));
    add("constant", picture(SIDE, SIDE, Rgb, |_, _, k| [0.3, 0.6, 0.1][k]));
    add("black", grey(&|_, _| 0.0));
    add("white", grey(&|_, _| 1.0));
    add("single bright pixel", grey(&|x, y| f64::from(x == 20 && y == 31)));
    add("checkerboard of single pixels", grey(&|x, y| f64::from((x + y) % 2)));
    for (name, angle) in [
        ("0°", 0.0),
        ("1°", 0.0175),
        ("27°", 0.47),
        ("45°", std::f64::consts::FRAC_PI_4),
        ("90°", std::f64::consts::FRAC_PI_2),
    ] {
        add(&format!("line of one pixel at {name}"), grey(&|x, y| line(SIDE, 0.5, angle, x, y)));
    }
    add("step edge", grey(&|x, _| f64::from(x >= SIDE / 2)));
    add("zone plate", grey(&|x, y| zone_plate(SIDE, x, y)));
    add("white noise", picture(SIDE, SIDE, Rgb, noise));
    add("ramp", grey(&|x, _| f64::from(x) / 47.0));
    add("saturated colours", picture(SIDE, SIDE, Rgb, |x, y, k| f64::from((x / 12 + y / 12) as usize % 3 == k)));
    add("transparent everywhere", picture(SIDE, SIDE, Rgba, |x, y, k| if k == 3 { 0.0 } else { noise(x, y, k) }));
    add(
        "alpha with a hard edge",
        picture(SIDE, SIDE, GreyAlpha, |x, y, k| if k == 1 { f64::from(y > x) } else { 0.8 }),
    );
    add("1 × 1", picture(1, 1, Rgb, |_, _, k| [0.9, 0.2, 0.4][k]));
    add("2 × 1", picture(2, 1, Grey, |x, _, _| f64::from(x)));
    add("1 × 65535", picture(1, 65535, Grey, |_, y, _| 0.5 + 0.5 * (f64::from(y) / 900.0).sin()));
    add("65535 × 1", picture(65535, 1, Grey, |x, _, _| 0.5 + 0.5 * (f64::from(x) / 900.0).sin()));
    add("primes 53 × 31", picture(53, 31, Rgb, |x, y, k| 0.5 + 0.5 * (f64::from(x * (k as u32 + 1) + y) / 7.0).sin()));
    let wave = || picture(96, 96, Rgb, |x, y, k| 0.5 + 0.4 * (f64::from(x * (k as u32 + 1) + 2 * y) / 9.0).sin());
    for ratio in [2.0, 10.0, 100.0, 1000.0] {
        // As many primitives as a ratio of 2 requires are slow even for a tiny picture.
        let pixels = if ratio < 5.0 { picture(40, 40, Rgb, noise) } else { wave() };
        list.push((format!("ratio {ratio}"), pixels, Target::Ratio(ratio)));
    }
    // The layer of a drawing has other steps than that of a photograph.
    for ratio in [3.0, 30.0, 100.0] {
        list.push((format!("diagram, ratio {ratio}"), diagram(96), Target::Ratio(ratio)));
    }
    // A symmetric gradient: a file of a few dozen bytes for millions of samples.
    let wide =
        |side: u32| picture(side, side, Rgb, |x, y, _| f64::from((x + y).min(2 * side - x - y)) / f64::from(side));
    for (side, ratio, name) in [(500, 1e4, "1e4"), (1300, 1e5, "1e5"), (3400, 1e6, "1e6"), (1300, 1e6, "1e6")] {
        list.push((format!("ratio {name}, {side} × {side}"), wide(side), Target::Ratio(ratio)));
    }
    list.push(("N = 0".into(), wave(), Target::Gaussians(0)));
    list.push(("N = 1".into(), wave(), Target::Gaussians(1)));
    list.push(("N = 2".into(), wave(), Target::Gaussians(2)));
    list.push(("N beyond the pixels".into(), grey(&|x, y| noise(x, y, 5)), Target::Gaussians(4000)));
    list.into_iter().map(|(name, pixels, target)| Fit { name, pixels, target }).collect()
}

/// Rings whose frequency rises from the middle to the limit of the grid at the border.
fn zone_plate(side: u32, x: u32, y: u32) -> f64 {
    let middle = f64::from(side) / 2.0;
    let (dx, dy) = (f64::from(x) + 0.5 - middle, f64::from(y) + 0.5 - middle);
    0.5 + 0.5 * (std::f64::consts::PI * (dx * dx + dy * dy) / f64::from(side)).cos()
}
