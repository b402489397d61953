//! Whoever works on the tiles of a picture: this thread and its pool, or others elsewhere.

use crate::error::Result;

/// Others who work on the tiles of a picture. Each task is bytes for [`work_on_tile`](super::work_on_tile), each answer is what
/// that returns; on which machine, in how many tries and in which order does not matter to the file.
pub trait Workers {
    /// Hands a task over, and need not wait for it.
    ///
    /// # Errors
    /// Whatever ends the encode.
    fn give(&mut self, task: Vec<u8>) -> Result<()>;

    /// Waits for the answer to the task that was given first of those still unanswered.
    ///
    /// # Errors
    /// Whatever ends the encode.
    fn take(&mut self) -> Result<Vec<u8>>;

    /// Returns how many tasks are to be out at a time: what it takes to keep all workers busy. Each has the pixels of a tile.
    fn at_once(&self) -> usize;
}

/// Who works on tiles.
pub(super) enum Hands<'a> {
    /// This thread and its pool.
    Own,
    /// Others.
    Others(&'a mut dyn Workers),
}
