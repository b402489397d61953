//! The SSIMULACRA2 scores of a typical picture at each size of its file.

use crate::constants::quality;

/// Returns the number of halvings at which the typical curve has this score.
pub(super) fn halvings(points: f64) -> f64 {
    at_points(&quality::TYPICAL_SCORES, points)
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
        assert!(quality::TYPICAL_SCORES.windows(2).all(|c| c[0][0] < c[1][0] && c[0][1] > c[1][1]));
        for [at, points] in quality::TYPICAL_SCORES {
            assert!((halvings(points) - at).abs() < 1e-9, "{points}");
        }
        let all: Vec<f64> = (0..=100).map(|q| halvings(f64::from(q))).collect();
        assert!(all.is_sorted_by(|a, b| a > b) && all[100] < 1.0 && all[0] < 9.0, "{all:?}");
    }
}
