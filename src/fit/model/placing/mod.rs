//! Where to place primitives (peaks of the error, ridges, detail), and what it costs to remove existing ones.

pub(crate) mod peaks;
pub(crate) mod removal;
pub(crate) mod ridge;
pub(crate) mod sample;
