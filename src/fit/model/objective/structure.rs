//! Pixel weights that make the squared error favour structural similarity.

use crate::constants::fit;
use crate::fit::model::objective::blur::blur;
use crate::fit::model::objective::planes::Planes;
use crate::parallel;
use crate::strict_math::StrictMath;

/// Returns [`Planes::amplitude`] for a fit of `count` primitives. Errors weigh more where the picture varies little, as
/// in SSIM, whose contrast term falls by about `e² / (2σ² + C₂)` for an error `e` over a local variance `σ²`.
pub fn amplitudes(target: &Planes, count: usize) -> Vec<f32> {
    let pixels_each = (target.width as usize * target.height as usize) as f32 / count.max(1) as f32;
    normalized(target, &weights(target, pixels_each), None)
}

/// Returns the amplitudes of a part of a picture, given the pixels per primitive and the mean weight of the whole
/// picture.
pub fn amplitudes_of_part(target: &Planes, pixels_each: f32, mean: f64) -> Vec<f32> {
    normalized(target, &weights(target, pixels_each), Some(mean as f32))
}

/// Returns the mean weight of a part of a picture, given the pixels per primitive.
pub fn mean_of_part(target: &Planes, pixels_each: f32) -> f64 {
    let weights = weights(target, pixels_each);
    weights.iter().map(|&w| f64::from(w)).sum::<f64>() / weights.len() as f64
}

fn weights(target: &Planes, pixels_each: f32) -> Vec<f32> {
    let colors = target.channels.count() - usize::from(target.channels.alpha().is_some());
    let (width, height) = (target.width as usize, target.height as usize);
    let power = fit::STRUCTURE_EXPONENT * (pixels_each / fit::STRUCTURE_DENSE_PIXELS).max(1.0).sqrt().recip();
    let mut weights = vec![0.0f32; width * height];
    for k in 0..colors {
        let mut plane = target.plane(k);
        let soften = |p: &[f32]| blur(&blur(p, width, height), width, height);
        let means = soften(&plane);
        for v in &mut plane {
            *v *= *v;
        }
        let squares = soften(&plane);
        for (w, (m, s)) in weights.iter_mut().zip(means.iter().zip(&squares)) {
            *w += (2.0 * (s - m * m).max(0.0) + fit::STRUCTURE_VARIANCE_FLOOR).strict_powf(-power);
        }
    }
    weights
}

/// Converts one weight per pixel to amplitudes: square roots with a mean square of 1. `mean` replaces the mean of
/// `weights`.
pub fn normalized(target: &Planes, weights: &[f32], mean: Option<f32>) -> Vec<f32> {
    let (width, height) = (target.width as usize, target.height as usize);
    let own = || {
        let sums = parallel::map(height, |y| weights[y * width..][..width].iter().map(|&w| f64::from(w)).sum::<f64>());
        (sums.iter().sum::<f64>() / (width * height) as f64) as f32
    };
    let mean = mean.unwrap_or_else(own);
    let mut out = vec![0.0; target.stride * height];
    parallel::map_chunks(&mut out, target.stride, |y, out| {
        for (o, w) in out.iter_mut().zip(&weights[y * width..][..width]) {
            *o = (w / mean).clamp(fit::MAX_STRUCTURE_WEIGHT.recip(), fit::MAX_STRUCTURE_WEIGHT).sqrt();
        }
    });
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Channels, Pixels, Samples};

    #[test]
    fn smooth_areas_have_larger_weights_and_the_mean_is_one() {
        let samples = (0..64 * 40usize).map(|i| if i % 64 < 32 { 90 } else { (i * 7919 % 251) as u8 }).collect();
        let target = Planes::new(&Pixels::new(64, 40, Channels::Grey, Samples::U8(samples)).unwrap());
        let amplitudes = amplitudes(&target, 50);
        assert_eq!(amplitudes.len(), target.stride * 40);
        let rows = amplitudes.chunks_exact(target.stride);
        let mean = rows.clone().flat_map(|r| &r[..64]).map(|a| a * a).sum::<f32>() / (64.0 * 40.0);
        assert!((mean - 1.0).abs() < 1e-4, "{mean}");
        for row in rows {
            assert!(row[10] > 2.0 * row[50], "{} {}", row[10], row[50]);
        }
    }
}
