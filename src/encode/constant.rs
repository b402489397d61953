//! Pictures of one colour: no fit is needed for them.

use crate::bitstream::splats::{PackedGaussian, PackedSplats, Steps};
use crate::gaussian::{CUTOFF_WEIGHT, EPSILON};
use crate::pixels::{Pixels, Samples};

/// Tells whether all pixels of `pixels` are the same.
pub(super) fn is_constant(pixels: &Pixels) -> bool {
    fn same<T: PartialEq>(samples: &[T], count: usize) -> bool {
        samples.chunks_exact(count).all(|p| p == &samples[..count])
    }
    match pixels.samples() {
        Samples::U8(v) => same(v, pixels.channels().count()),
        Samples::U16(v) => same(v, pixels.channels().count()),
    }
}

/// Gives `splats` one primitive, far wider than the picture, that makes every pixel `color` far more exactly than a
/// step: the background, which has 1/128 of its weight, corrects it. For the normalized blend and the coded layout;
/// `splats` brings everything but steps, background and primitives.
pub(super) fn constant(splats: &mut PackedSplats, color: [f32; 4]) {
    splats.steps = Steps { scale: 15, angle: 0, position: 0, coarsest: 9, range: 0, luma: 0, chroma: 0 };
    let quantizer = splats.quantizer();
    let (axes, steps) = (quantizer.transform_color(color), quantizer.color_steps());
    let weight = 1.0 - CUTOFF_WEIGHT;
    let mut major = 0;
    // Even from a position a coarsest step away, its weight falls by less than 1e−3 over the picture.
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
