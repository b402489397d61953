//! The rows of a picture that one step of the fit uses.

/// Every `step`-th row from `phase` on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RowSet {
    pub step: u32,
    pub phase: u32,
}

impl RowSet {
    pub const ALL: RowSet = RowSet { step: 1, phase: 0 };

    /// Returns how many of `height` rows are in the set.
    pub fn count(self, height: u32) -> usize {
        (height.saturating_sub(self.phase)).div_ceil(self.step) as usize
    }

    /// Returns the index of the first row of the set at or after `y`.
    #[inline(always)]
    pub fn index(self, y: u32) -> usize {
        y.saturating_sub(self.phase).div_ceil(self.step) as usize
    }

    /// Returns the row number of index `i`.
    #[inline(always)]
    pub fn row(self, i: usize) -> u32 {
        self.phase + i as u32 * self.step
    }
}
