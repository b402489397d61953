//! Sine and cosine from additions and multiplications alone. Results are the same bits on every machine, and the code
//! adds little to a WebAssembly module.

use std::f64::consts::{FRAC_2_PI, FRAC_PI_2};

/// Returns sine and cosine of `angle` (radians), within 10⁻¹⁵ of the exact values for angles of a few turns. For
/// larger angles, rounding of the angle itself dominates the error.
pub(crate) fn sin_cos(angle: f64) -> (f64, f64) {
    let quarters = angle * FRAC_2_PI;
    let nearest = quarters.round();
    let x = (quarters - nearest) * FRAC_PI_2;
    // Taylor polynomials: at π/4, the first omitted term is below 10⁻¹⁷.
    let y = x * x;
    let term = |sum: f64, n: f64| 1.0 - sum * y / (n * (n + 1.0));
    let sin = x * [16.0, 14.0, 12.0, 10.0, 8.0, 6.0, 4.0, 2.0].into_iter().fold(1.0, term);
    let cos = [17.0, 15.0, 13.0, 11.0, 9.0, 7.0, 5.0, 3.0, 1.0].into_iter().fold(1.0, term);
    match nearest as i64 & 3 {
        0 => (sin, cos),
        1 => (cos, -sin),
        2 => (-sin, -cos),
        _ => (-cos, sin),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_of_some_turns_are_within_their_bound() {
        for i in -20_000..=20_000 {
            let angle = f64::from(i) * 1e-3;
            let (sin, cos) = sin_cos(angle);
            let off = (sin - angle.sin()).abs().max((cos - angle.cos()).abs());
            // Half a unit of the quotient at 13 quarter turns is 10⁻¹⁵; both libraries round once more.
            assert!(off < 4e-15, "{angle}: {off:e}");
        }
    }

    #[test]
    fn every_finite_angle_gives_a_point_near_the_circle() {
        for angle in [0.0, -0.0, 1e-300, 1e5, -1e9, 3.4e38, -3.4e38, f64::MAX] {
            let (sin, cos) = sin_cos(angle);
            assert!((sin * sin + cos * cos - 1.0).abs() < 1e-12, "{angle}");
        }
    }
}
