//! Workers on the tiles of a picture: this thread and its pool, or others elsewhere.

use crate::error::Result;

/// Interface to workers on the tiles of a picture. Each task is bytes for [`work_on_tile`](super::work_on_tile), and
/// each answer is the bytes which that returns. The file does not depend on where, how often or in which order the
/// tasks are done.
pub trait Workers {
    /// Starts a task. It need not wait for the answer.
    ///
    /// # Errors
    /// Whatever ends the encode.
    fn submit(&mut self, task: Vec<u8>) -> Result<()>;

    /// Waits for the answer to the oldest task that is still unanswered, and returns it.
    ///
    /// # Errors
    /// Whatever ends the encode.
    fn next(&mut self) -> Result<Vec<u8>>;

    /// Returns the number of tasks to have started at a time, enough to keep all workers busy. Each task holds the
    /// pixels of a tile.
    fn capacity(&self) -> usize;
}

/// Choice of who works on tiles.
pub(super) enum Executor<'a> {
    /// This thread and its pool.
    Own,
    /// Workers of the caller.
    Others(&'a mut dyn Workers),
}
