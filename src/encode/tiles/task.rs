//! The kinds of work on a tile, and the pixels and primitives that each kind needs.

use super::floats::{self, OnProgress};
use super::global::GlobalContext;
use super::grid::{Area, Window};
use super::integers::Part;
use super::mosaic::{Mosaic, TileResult, WindowPrimitives};
use crate::bitstream::splats::PackedGaussian;
use crate::error::Result;
use crate::fit::model::drawing::project::Primitive;

/// Work on the floats of a tile.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum FloatWork {
    /// Fits the tile alone.
    Begin,
    /// Continues the fit, in the pass of [`floats::JOINED`] with this index.
    Join(usize),
}

/// Work on the integers of a tile.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum IntegerWork {
    /// Measures the error with the weights of the fit.
    Weigh,
    /// Measures the costs of the primitives, and finds candidates.
    Appraise,
    /// Runs a sweep in which a bit must save this much of the squared error.
    Sweep(f64),
}

/// Primitives that can be worked on. The result depends only on the global context, the window, the work and the
/// primitives, and not on where the work is done.
pub(super) trait TilePrimitive: Copy + Send {
    /// The kinds of work on these primitives.
    type Work: Copy + Sync;

    /// Returns the area of the picture that the work needs.
    fn pixels(window: &Window, work: Self::Work) -> Area;

    /// Does the work and returns its result.
    fn work(
        global: &GlobalContext<'_>,
        task: (&Window, Self::Work),
        primitives: WindowPrimitives<Self>,
        on_progress: OnProgress<'_>,
    ) -> Result<TileResult<Self>>;

    /// Returns the primitives that the work needs.
    fn window_primitives(mosaic: &Mosaic<'_, Self>, window: &Window, work: Self::Work) -> WindowPrimitives<Self> {
        mosaic.window_primitives(&window.core, &Self::pixels(window, work))
    }
}

impl TilePrimitive for Primitive {
    type Work = FloatWork;

    fn pixels(window: &Window, _: FloatWork) -> Area {
        window.padded
    }

    fn work(
        global: &GlobalContext<'_>,
        (window, work): (&Window, FloatWork),
        primitives: WindowPrimitives<Self>,
        on_progress: OnProgress<'_>,
    ) -> Result<TileResult<Self>> {
        match work {
            FloatWork::Begin => floats::begin(global, window, on_progress),
            FloatWork::Join(pass) => floats::join(global, (pass, window), primitives, on_progress),
        }
    }
}

impl TilePrimitive for PackedGaussian {
    type Work = IntegerWork;

    fn pixels(window: &Window, _: IntegerWork) -> Area {
        window.padded
    }

    fn work(
        global: &GlobalContext<'_>,
        (window, work): (&Window, IntegerWork),
        primitives: WindowPrimitives<Self>,
        _: OnProgress<'_>,
    ) -> Result<TileResult<Self>> {
        match work {
            IntegerWork::Weigh => Ok(TileResult::measured(Part::new(global, window, primitives).error()?)),
            IntegerWork::Appraise => Part::new(global, window, primitives).appraise(),
            IntegerWork::Sweep(lambda) => Part::new(global, window, primitives).sweep(lambda),
        }
    }
}
