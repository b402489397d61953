//! Computes the additions of a detail layer to a view that is rendered band by band. This is done on the CPU, for as
//! many rows at once as memory allows.

use std::ops::Range;
use std::sync::Arc;

use super::lists::MAX_BINDING;
use crate::budget::Budget;
use crate::error::{GpuError, Result};
use crate::limits::Limits;
use crate::parameter::Limit;
use crate::raster::{Additions, Overlay, View};

/// The additions to one view.
#[derive(Debug)]
pub(super) struct Layer {
    overlay: Arc<Overlay>,
    view: View,
    work: u64,
    /// Additions of the last band, which may be rendered again with longer lists or fewer rows.
    made: Option<Additions>,
}

impl Layer {
    /// # Errors
    /// [`Error::LimitExceeded`](crate::Error::LimitExceeded) if the work of the layer alone exceeds the limits.
    pub(super) fn new(overlay: &Arc<Overlay>, view: &View, limits: &Limits) -> Result<Self> {
        let work = overlay.work(view, limits)?;
        Limits::check(Limit::Work, work, limits.work)?;
        Ok(Layer { overlay: Arc::clone(overlay), view: *view, work, made: None })
    }

    /// Returns the work of computing all additions, in the units of [`Limits::work`]. It is within the limit.
    pub(super) fn work(&self) -> u64 {
        self.work
    }

    /// Returns the bytes of memory per row.
    pub(super) fn row_memory(&self) -> u64 {
        self.overlay.row_memory(self.view.width() as usize)
    }

    /// Returns the maximum number of rows of a band. It may be lower than the height of a tile, which is then rendered
    /// in parts.
    ///
    /// # Errors
    /// [`GpuError::Overflow`] if not even one row fits into a binding.
    pub(super) fn most_rows(&self) -> Result<u32> {
        let row = self.row_memory();
        if row > MAX_BINDING {
            let what = "bytes of additions to a row";
            return Err(GpuError::Overflow { what, requested: row, allowed: MAX_BINDING }.into());
        }
        let bound = u32::try_from(MAX_BINDING / row.max(1)).unwrap_or(u32::MAX);
        Ok(self.overlay.rows_at_once(self.view.width() as usize).min(bound))
    }

    /// Checks that the additions to bands of this many rows, and their inputs, fit into the budget.
    ///
    /// # Errors
    /// [`Error::LimitExceeded`](crate::Error::LimitExceeded) if they do not.
    pub(super) fn check(&self, rows: u32, budget: &Budget) -> Result<()> {
        self.overlay.check_rows(self.view.width() as usize, rows.min(self.view.height()), budget)
    }

    /// Returns the number of rows of a band that starts at row `first`, at most `most`.
    pub(super) fn rows(&self, first: u32, most: u32) -> u32 {
        self.overlay.rows_from(&self.view, first, most)
    }

    /// Returns the additions to the rows `rows` of the view: row by row, channel after channel within each.
    pub(super) fn additions(&mut self, rows: Range<u32>) -> &[f32] {
        // A band that is rendered again starts at the same row and has no more rows than before.
        let made = self.made.take().and_then(|made| {
            if made.top == rows.start {
                return Some(made);
            }
            self.overlay.recycle_additions(made);
            None
        });
        let width = self.view.width() as usize;
        let made = made.unwrap_or_else(|| self.overlay.additions(&self.view, 0, width, rows.clone()));
        self.made.insert(made).first_rows(rows.end - rows.start)
    }
}
