//! Additions of a detail layer to a view that is drawn band by band. They are made on the CPU, for as many rows as may
//! be held at once.

use std::ops::Range;
use std::sync::Arc;

use super::lists::MOST_BINDING;
use crate::budget::Budget;
use crate::error::{GpuError, Result};
use crate::limits::Limits;
use crate::raster::{Additions, Overlay, View};

/// The additions to one view.
#[derive(Debug)]
pub(super) struct Layer {
    overlay: Arc<Overlay>,
    view: View,
    work: u64,
    /// Additions of the last band, which may be drawn again with longer lists or fewer rows.
    made: Option<Additions>,
}

impl Layer {
    /// # Errors
    /// [`Error::LimitExceeded`](crate::Error::LimitExceeded) when the layer alone is too much work.
    pub(super) fn new(overlay: &Arc<Overlay>, view: &View, limits: &Limits) -> Result<Self> {
        let work = overlay.work(view, limits)?;
        Limits::check("work", work, limits.work)?;
        Ok(Layer { overlay: Arc::clone(overlay), view: *view, work, made: None })
    }

    /// Returns the work of making all additions, in the units of [`Limits::work`]. It is within the limit.
    pub(super) fn work(&self) -> u64 {
        self.work
    }

    /// Bytes for a row.
    pub(super) fn row_memory(&self) -> u64 {
        self.overlay.row_memory(self.view.width() as usize)
    }

    /// Most rows of a band. They may be fewer than those of a tile, which is then drawn in part.
    ///
    /// # Errors
    /// [`GpuError::Overflow`] when not even one fits into a binding.
    pub(super) fn most_rows(&self) -> Result<u32> {
        let row = self.row_memory();
        if row > MOST_BINDING {
            let what = "bytes of additions to a row";
            return Err(GpuError::Overflow { what, requested: row, allowed: MOST_BINDING }.into());
        }
        let bound = u32::try_from(MOST_BINDING / row.max(1)).unwrap_or(u32::MAX);
        Ok(self.overlay.rows_at_once(self.view.width() as usize).min(bound))
    }

    /// Checks that the additions to bands of so many rows, and what they are made from, can be held.
    ///
    /// # Errors
    /// [`Error::LimitExceeded`](crate::Error::LimitExceeded) when they cannot.
    pub(super) fn check(&self, rows: u32, budget: &Budget) -> Result<()> {
        self.overlay.check_rows(self.view.width() as usize, rows.min(self.view.height()), budget)
    }

    /// Rows of a band of at most `most` rows from row `first` on.
    pub(super) fn rows(&self, first: u32, most: u32) -> u32 {
        self.overlay.rows_from(&self.view, first, most)
    }

    /// Returns the additions to the rows `rows` of the view: row by row, channel after channel within each.
    pub(super) fn additions(&mut self, rows: Range<u32>) -> &[f32] {
        // A band that is drawn again begins where it did, and has no more rows than before.
        let made = self.made.take().and_then(|made| {
            if made.top == rows.start {
                return Some(made);
            }
            self.overlay.used(made);
            None
        });
        let width = self.view.width() as usize;
        let made = made.unwrap_or_else(|| self.overlay.additions(&self.view, 0, width, rows.clone()));
        self.made.insert(made).first(rows.end - rows.start)
    }
}
