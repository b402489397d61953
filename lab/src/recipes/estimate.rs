//! Estimates the size of Gaussians that the format cannot store: numbers on uniform grids, at the entropy of their
//! codes.
//!
//! It is a lower bound for coders of this order: neither the tables of the codes nor a header are included. Positions
//! cost as many bits as their grid has points, because the order in which Gaussians are stored matters.

use std::collections::HashMap;

use super::optimizer::NUMBERS;

/// Rounds the numbers `used` to multiples of `steps` times a common factor, the smallest for which the estimate is at
/// most `bytes`. Returns the estimate and the rounded numbers, or `None` if there is no such factor or a number is
/// NaN.
pub(super) fn rounded(
    numbers: &[[f32; NUMBERS]],
    steps: &[f32; NUMBERS],
    used: &[usize],
    bytes: u64,
) -> Option<(u64, Vec<[f32; NUMBERS]>)> {
    if numbers.is_empty() || numbers.iter().flatten().any(|v| !v.is_finite()) {
        return None;
    }
    let size = |factor: f32| used.iter().map(|&k| bits(numbers, k, steps[k] * factor)).sum::<f64>() / 8.0;
    // Factors of 2^-6 to 2^6, by bisection.
    let (mut low, mut high) = (-6.0f32, 6.0f32);
    if size(high.exp2()) > bytes as f64 {
        return None;
    }
    for _ in 0..12 {
        let middle = 0.5 * (low + high);
        if size(middle.exp2()) > bytes as f64 { low = middle } else { high = middle }
    }
    let factor = high.exp2();
    let mut out = numbers.to_vec();
    for n in &mut out {
        for &k in used {
            n[k] = (n[k] / (steps[k] * factor)).round() * (steps[k] * factor);
        }
    }
    Some((size(factor).ceil() as u64, out))
}

/// Returns the bits of number `k` of all Gaussians.
fn bits(numbers: &[[f32; NUMBERS]], k: usize, step: f32) -> f64 {
    let codes = numbers.iter().map(|n| (n[k] / step).round() as i64);
    if k < 2 {
        let [least, largest] = codes.fold([i64::MAX, i64::MIN], |r, c| [r[0].min(c), r[1].max(c)]);
        return numbers.len() as f64 * (largest as f64 - least as f64 + 1.0).log2();
    }
    let mut times: HashMap<i64, u32> = HashMap::new();
    codes.for_each(|c| *times.entry(c).or_default() += 1);
    let mut times: Vec<u32> = times.into_values().collect();
    // Sorted, so that sums do not depend on the order of a hash table.
    times.sort_unstable();
    times.iter().map(|&t| f64::from(t) * (numbers.len() as f64 / f64::from(t)).log2()).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_cost_their_entropy_and_places_their_grid() {
        // Four equally frequent codes, then a single code.
        let numbers: Vec<[f32; NUMBERS]> = (0..64)
            .map(|i| {
                let mut n = [0.0; NUMBERS];
                (n[0], n[3]) = ((i % 32) as f32, (i % 4) as f32);
                n
            })
            .collect();
        assert_eq!(bits(&numbers, 3, 1.0), 128.0);
        assert_eq!(bits(&numbers, 4, 1.0), 0.0);
        assert_eq!(bits(&numbers, 0, 1.0), 320.0);
    }

    #[test]
    fn the_finest_factor_within_the_size_is_taken() {
        let numbers: Vec<[f32; NUMBERS]> = (0..200u32)
            .map(|i| std::array::from_fn(|k| (i.wrapping_mul(2_654_435_761 + k as u32) >> 16) as f32 / 65536.0))
            .collect();
        let used: Vec<usize> = (0..NUMBERS).collect();
        let steps = [0.05; NUMBERS];
        let mut before = f32::INFINITY;
        for bytes in [300, 600, 1000] {
            let (found, rounded) = rounded(&numbers, &steps, &used, bytes).unwrap();
            assert!(found <= bytes && found > bytes * 95 / 100, "{found} of {bytes}");
            let error: f32 = numbers.iter().flatten().zip(rounded.iter().flatten()).map(|(a, b)| (a - b).abs()).sum();
            assert!(error < before, "{error}");
            before = error;
        }
        assert!(super::rounded(&[[f32::NAN; NUMBERS]], &steps, &used, 1000).is_none());
    }
}
