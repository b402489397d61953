//! A picture made smaller, for the first steps of a fit.

use crate::fit::model::objective::planes::Planes;
use crate::fit::model::problem::{Problem, Scene};

/// A picture made smaller.
pub(crate) struct Reduced {
    scene: Scene,
    target: Planes,
    /// How many times its sides are shorter: a power of two.
    pub by: u32,
}

impl Reduced {
    /// Halves the picture so many times, at least once.
    pub(crate) fn new(problem: &Problem<'_>, times: u32) -> Self {
        let mut target = problem.target.halved();
        for _ in 1..times {
            target = target.halved();
        }
        Reduced { scene: Scene { width: target.width, height: target.height, ..problem.scene }, target, by: 1 << times }
    }

    /// Returns the same problem at the smaller size.
    pub(crate) fn problem(&self) -> Problem<'_> {
        Problem { scene: self.scene, target: &self.target }
    }
}

/// Which iterations see a picture made smaller.
#[derive(Clone, Copy)]
pub(crate) struct Coarse<'a> {
    pub reduced: &'a Reduced,
    /// The share of all iterations that do, from the first on.
    pub share: f32,
}
