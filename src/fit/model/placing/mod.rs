//! Places for primitives: peaks of the error, ridges, detail; and the cost of removing those that are there.

pub(crate) mod peaks;
pub(crate) mod removal;
pub(crate) mod ridge;
pub(crate) mod sample;
