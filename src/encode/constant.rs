//! Integers of one colour: for pictures that have only one, and for those whose contrasts are finer than the steps of the
//! colours of Gaussians.

use super::input::may_leave_out;
use crate::bitstream::splats::{PackedGaussian, PackedSplats, Steps};
use crate::gaussian::{Blend, CUTOFF_WEIGHT, EPSILON};
use crate::options::EncodeOptions;
use crate::pixels::{Pixels, Samples};

/// Returns whether all pixels of `pixels` are equal.
pub(super) fn is_constant(pixels: &Pixels) -> bool {
    fn same<T: PartialEq>(samples: &[T], count: usize) -> bool {
        samples.chunks_exact(count).all(|p| p == &samples[..count])
    }
    match pixels.samples() {
        Samples::U8(v) => same(v, pixels.channels().count()),
        Samples::U16(v) => same(v, pixels.channels().count()),
    }
}

/// Returns whether the options allow such integers.
pub(super) fn is_possible(options: &EncodeOptions, blend: Blend) -> bool {
    may_leave_out(options) && blend == Blend::Normalized && options.recipe.is_own()
}

/// Sets the steps, the background and the primitives of `splats` such that every pixel has the colour `color`, with an
/// error far below a quantization step. A single primitive, far wider than the picture, covers all pixels. The
/// background has 1/128 of its weight and corrects the rounding error. `splats` must have the normalized blend and the
/// coded layout.
pub(super) fn constant(splats: &mut PackedSplats, color: [f32; 4]) {
    splats.steps = Steps { scale: 15, angle: 0, position: 0, coarsest: 9, range: 0, luma: 0, chroma: 0 };
    let quantizer = splats.quantizer();
    let (axes, steps) = (quantizer.transform_color(color), quantizer.color_steps());
    let weight = 1.0 - CUTOFF_WEIGHT;
    let mut major = 0;
    // Even if the position is off by one coarsest step, the weight falls by less than 1e−3 over the picture.
    let reach = splats.width.max(splats.height).max(512) as f32;
    while quantizer.holds_scale(i16::from(major) + 1) && quantizer.scale(major) < 64.0 * reach {
        major += 1;
    }
    let mut g = PackedGaussian { major, minor: major, ..PackedGaussian::default() };
    for k in 0..splats.channels.count() {
        let nearest = (axes[k] / steps[k] + 0.5).floor();
        let rest = axes[k] - nearest * steps[k];
        g.color[k] = nearest as i16;
        splats.background[k] = (nearest + (rest * (weight + EPSILON) / (EPSILON * steps[k]) + 0.5).floor()) as i16;
    }
    quantizer.place(&mut g, [0.5 * splats.width as f32, 0.5 * splats.height as f32]);
    splats.gaussians = vec![g];
}
