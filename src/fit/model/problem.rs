//! The problem that a fit solves: a picture, and how primitives are to make it.

use crate::fit::model::objective::planes::Planes;
use crate::fit::model::objective::rows::RowSet;
use crate::gaussian::Blend;
use crate::strict_math::StrictMath;

/// Pixels of a large picture: smaller ones are done soon enough.
pub const LARGE_PIXELS: u64 = 1 << 21;

/// How primitives make a picture: its size, their blend and the background.
#[derive(Debug, Clone, Copy)]
pub struct Scene {
    pub width: u32,
    pub height: u32,
    pub blend: Blend,
    pub background: [f32; 4],
}

impl Scene {
    /// Tells whether the picture is so large that looks at it leave rows out.
    pub fn is_large(&self) -> bool {
        self.pixels() >= LARGE_PIXELS
    }

    /// Returns the number of pixels.
    pub fn pixels(&self) -> u64 {
        u64::from(self.width) * u64::from(self.height)
    }

    /// Returns about the scale of `count` Gaussians, pixels.
    pub fn typical_scale(&self, count: usize) -> f32 {
        let area = self.width as f32 * self.height as f32;
        0.7 * (area / (std::f32::consts::PI * count.max(1) as f32)).sqrt()
    }

    /// Returns the distance of sampled rows for `count` Gaussians: every one should see a few.
    pub fn row_step(&self, count: usize) -> u32 {
        // Sampling few rows of large Gaussians would save more, but each of a few primitives matters.
        let typical = self.typical_scale(count);
        (f32::min(0.9 * typical, 1.6 * typical.strict_powf(0.6)) as u32).clamp(1, 16).min(self.height)
    }
}

/// A picture, and how primitives are to make it.
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
