//! A downscaled picture for the first steps of a fit.

use std::rc::Rc;

use crate::fit::model::objective::planes::Planes;
use crate::fit::model::problem::{Problem, Scene};

/// A problem with a downscaled picture.
pub(crate) struct Reduced {
    scene: Scene,
    target: Planes,
    /// Factor by which the sides are shorter: a power of two.
    pub by: u32,
}

impl Reduced {
    /// Halves the picture `times` times, at least once.
    pub(crate) fn new(problem: &Problem<'_>, times: u32) -> Self {
        let mut target = problem.target.halved();
        for _ in 1..times {
            target = target.halved();
        }
        Reduced { scene: Scene { width: target.width, height: target.height, ..problem.scene }, target, by: 1 << times }
    }

    /// Returns the problem at the smaller size.
    pub(crate) fn problem(&self) -> Problem<'_> {
        Problem { scene: self.scene, target: &self.target }
    }
}

/// The part of a fit that uses a downscaled picture.
pub(crate) struct Coarse {
    /// Its memory is released when the last fit that uses it continues at full size.
    pub reduced: Rc<Reduced>,
    /// The fraction of all iterations that use it, counted from the first.
    pub share: f32,
}
