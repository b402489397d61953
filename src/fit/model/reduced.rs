//! A picture made smaller, for the first steps of a fit.

use crate::fit::model::field::Scene;
use crate::fit::model::planes::Target;

/// A picture made smaller.
pub(crate) struct Reduced {
    pub scene: Scene,
    pub target: Target,
    /// How many times its sides are shorter: a power of two.
    pub by: u32,
}

impl Reduced {
    /// Halved so many times, at least once.
    pub(crate) fn new(scene: &Scene, target: &Target, times: u32) -> Self {
        let mut target = target.halved();
        for _ in 1..times {
            target = target.halved();
        }
        Reduced { scene: Scene { width: target.width, height: target.height, ..*scene }, target, by: 1 << times }
    }
}

/// Which iterations see a picture made smaller.
#[derive(Clone, Copy)]
pub(crate) struct Coarse<'a> {
    pub reduced: &'a Reduced,
    /// The share of all iterations that do, from the first on.
    pub share: f32,
}
