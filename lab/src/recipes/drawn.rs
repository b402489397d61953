//! Conversions of a method's result: planes to code values, their PSNR, and the Gaussians to a picture.

use ssplat::Depth;
use ssplat::unstable::fit::model::objective::planes::Planes;
use ssplat::unstable::gaussian::{Blend, Gaussian, Gaussians};
use ssplat::{Pixels, Samples};

/// Converts planes with the size and layout of `target` to 8-bit pixels; NaN becomes 0.
pub(super) fn pixels(target: &Planes, planes: &[f32]) -> Pixels {
    let (channels, stride) = (target.channels.count(), target.stride);
    let mut samples = Vec::with_capacity(target.width as usize * target.height as usize * channels);
    for row in planes.chunks_exact((channels + 1) * stride).take(target.height as usize) {
        for x in 0..target.width as usize {
            samples.extend((0..channels).map(|k| (row[k * stride + x].clamp(0.0, 1.0) * 255.0 + 0.5) as u8));
        }
    }
    Pixels::new(target.width, target.height, target.channels, Samples::U8(samples)).expect("as many samples as it says")
}

/// Returns a picture of `target`'s size without a background.
pub(super) fn picture(target: &Planes, blend: Blend, gaussians: Vec<Gaussian>) -> Gaussians {
    let Planes { width, height, channels, .. } = *target;
    Gaussians { width, height, channels, depth: Depth::Eight, blend, background: [0.0; 4], list: gaussians }
}

/// Returns the PSNR of a squared error over all samples, dB.
pub(super) fn psnr(target: &Planes, error: f64) -> f64 {
    let samples = f64::from(target.width) * f64::from(target.height) * target.channels.count() as f64;
    -10.0 * (error / samples).log10()
}
