//! The problem that a fit solves: a target picture, and how primitives are rendered.

use crate::constants::fit;
use crate::fit::model::objective::planes::Planes;
use crate::fit::model::objective::rows::RowSet;
use crate::gaussian::{Blend, CUTOFF_WEIGHT, Gaussian};
use crate::strict_math::StrictMath;

/// How primitives are rendered: picture size, blend and background.
#[derive(Debug, Clone, Copy)]
pub struct Scene {
    pub width: u32,
    pub height: u32,
    pub blend: Blend,
    pub background: [f32; 4],
}

impl Scene {
    /// Returns whether the picture is so large that passes over it skip rows.
    pub fn is_large(&self) -> bool {
        self.pixels() >= fit::LARGE_PIXELS
    }

    /// Returns the number of pixels.
    pub fn pixels(&self) -> u64 {
        u64::from(self.width) * u64::from(self.height)
    }

    /// Returns the approximate scale of `count` Gaussians, pixels.
    pub fn typical_scale(&self, count: usize) -> f32 {
        let area = self.width as f32 * self.height as f32;
        0.7 * (area / (std::f32::consts::PI * count.max(1) as f32)).sqrt()
    }

    /// Returns the distance of sampled rows for `count` Gaussians, such that each Gaussian covers a few.
    pub fn row_step(&self, count: usize) -> u32 {
        let typical = self.typical_scale(count);
        (f32::min(fit::ROW_STEP_PER_SCALE * typical, fit::ROW_STEP_FACTOR * typical.strict_powf(fit::ROW_STEP_EXPONENT))
            as u32)
            .clamp(1, 16)
            .min(self.height)
    }
}

/// Returns how many of `gaussians` cover a pixel of the picture in the mean. It is an upper estimate, because parts of
/// their support outside the picture count.
pub(crate) fn overlap(scene: &Scene, gaussians: &[Gaussian]) -> f32 {
    // The area of an ellipse where the weight is that of the cutoff.
    let unit = -2.0 * std::f32::consts::PI * CUTOFF_WEIGHT.strict_ln();
    let area = scene.pixels() as f32;
    gaussians.iter().map(|g| (unit * g.scale[0] * g.scale[1]).min(area)).sum::<f32>() / area
}

/// A target picture, and how primitives are rendered.
#[derive(Debug, Clone, Copy)]
pub struct Problem<'a> {
    pub scene: Scene,
    pub target: &'a Planes,
}

impl Problem<'_> {
    /// Returns the number of samples in `rows`.
    pub fn samples(&self, rows: RowSet) -> f64 {
        let row = f64::from(self.scene.width) * self.target.channels.count() as f64;
        rows.count(self.scene.height) as f64 * row
    }
}
