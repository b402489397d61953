//! The SSIMULACRA2 scores of a typical picture at each size of its file.

/// Margin above the requested score that tries aim at, points. Trimming can lower the score without another fit, but
/// cannot raise it.
pub(super) const AIM_ABOVE: f64 = 0.25;

/// Scores that are assumed for a picture until its own are known: halvings of the raw bytes, and points. The values
/// were measured on Kodak; from a ratio of 20 on, they are means of twelve pictures. Pictures differ mostly by a shift
/// along the first axis. `cargo run --release -p ssplat-lab --example rate_distortion -- KODAK` measures the curve.
const TYPICAL_CURVE: [[f64; 2]; 10] = [
    [0.5, 100.0],
    [1.5, 97.0],
    [2.3, 94.5],
    [3.0, 90.5],
    [3.9, 82.0],
    [4.32, 76.1],
    [5.64, 56.1],
    [6.64, 36.7],
    [7.64, 12.7],
    [8.97, -23.9],
];

/// Returns the number of halvings at which the typical curve has this score.
pub(super) fn halvings(points: f64) -> f64 {
    at_points(&TYPICAL_CURVE, points)
}

/// Returns where a curve of falling points has this many: linear between its knots and beyond them.
pub(super) fn at_points(curve: &[[f64; 2]], points: f64) -> f64 {
    let next = curve.iter().position(|c| c[1] <= points).unwrap_or(curve.len() - 1).max(1);
    let [[from, high], [to, low]] = [curve[next - 1], curve[next]];
    from + (to - from) * (high - points) / (high - low)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_typical_curve_decreases_and_passes_through_its_knots() {
        assert!(TYPICAL_CURVE.windows(2).all(|c| c[0][0] < c[1][0] && c[0][1] > c[1][1]));
        for [at, points] in TYPICAL_CURVE {
            assert!((halvings(points) - at).abs() < 1e-9, "{points}");
        }
        let all: Vec<f64> = (0..=100).map(|q| halvings(f64::from(q))).collect();
        assert!(all.is_sorted_by(|a, b| a > b) && all[100] < 1.0 && all[0] < 9.0, "{all:?}");
    }
}
