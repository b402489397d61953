//! Workers that process the tiles of a picture: this thread and its pool, or workers of the caller.

use crate::error::Result;

/// Interface to workers that process the tiles of a picture. A task is a byte string for
/// [`work_on_tile`](super::work_on_tile), and its answer is the byte string that this function returns. The file does
/// not depend on where, how often or in which order the tasks run.
pub trait Workers {
    /// Starts a task. It may return before the answer is available.
    ///
    /// # Errors
    /// Any error ends the encode.
    fn submit(&mut self, task: Vec<u8>) -> Result<()>;

    /// Waits for the answer to the oldest unanswered task, and returns it.
    ///
    /// # Errors
    /// Any error ends the encode.
    fn receive(&mut self) -> Result<Vec<u8>>;

    /// Returns how many tasks should be in progress at a time to keep all workers busy. Each task contains the pixels
    /// of a tile.
    fn capacity(&self) -> usize;
}

/// Where the tiles are processed.
pub(crate) enum Executor<'a> {
    /// By this thread and its pool.
    Own,
    /// By workers of the caller.
    External(&'a mut dyn Workers),
}

impl Executor<'_> {
    /// Returns the same executor for a shorter time.
    pub(super) fn reborrow(&mut self) -> Executor<'_> {
        match self {
            Executor::Own => Executor::Own,
            Executor::External(workers) => Executor::External(&mut **workers),
        }
    }
}
