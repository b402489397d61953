//! The work on a tile: what can be done with it, and with which primitives around it.

use super::floats::{self, Show};
use super::global::GlobalContext;
use super::grid::{Area, Window};
use super::integers::Part;
use super::mosaic::{Around, Mosaic, TileResult};
use crate::bitstream::splats::PackedGaussian;
use crate::error::Result;
use crate::fit::model::drawing::project::Primitive;

/// Work on the floats of a tile.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum FloatWork {
    /// The fit of a tile by itself.
    Begin,
    /// Continuation of the fit, in the pass of [`floats::JOINED`] with this index.
    Join(usize),
}

/// Work on the integers of a tile.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum IntegerWork {
    /// Look at the error, weighted as it is fitted.
    Weigh,
    /// A sweep, in which a bit must save so much of the squared error.
    Sweep(f64),
}

/// Primitives that can be worked on. What comes of it follows from the whole, the window, the work and the primitives
/// alone, wherever it is done.
pub(super) trait Worked: Copy + Send {
    /// Kinds of work on these primitives.
    type Work: Copy + Sync;

    /// Returns the pixels that the work takes.
    fn pixels(window: &Window, work: Self::Work) -> Area;

    /// Does the work.
    fn work(
        global: &GlobalContext<'_>,
        what: (&Window, Self::Work),
        around: Around<Self>,
        show: Show<'_>,
    ) -> Result<TileResult<Self>>;

    /// Returns the primitives that the work takes.
    fn around(mosaic: &Mosaic<'_, Self>, window: &Window, work: Self::Work) -> Around<Self> {
        mosaic.around(&window.core, &Self::pixels(window, work))
    }
}

impl Worked for Primitive {
    type Work = FloatWork;

    fn pixels(window: &Window, _: FloatWork) -> Area {
        window.seen
    }

    fn work(
        global: &GlobalContext<'_>,
        (window, work): (&Window, FloatWork),
        around: Around<Self>,
        show: Show<'_>,
    ) -> Result<TileResult<Self>> {
        match work {
            FloatWork::Begin => floats::begin(global, window, show),
            FloatWork::Join(pass) => floats::join(global, (pass, window), around, show),
        }
    }
}

impl Worked for PackedGaussian {
    type Work = IntegerWork;

    fn pixels(window: &Window, _: IntegerWork) -> Area {
        window.seen
    }

    fn work(
        global: &GlobalContext<'_>,
        (window, work): (&Window, IntegerWork),
        around: Around<Self>,
        _: Show<'_>,
    ) -> Result<TileResult<Self>> {
        match work {
            IntegerWork::Weigh => Ok(TileResult::seen(Part::new(global, window, around).error()?)),
            IntegerWork::Sweep(lambda) => Part::new(global, window, around).sweep(lambda),
        }
    }
}
