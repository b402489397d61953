//! The detail layer: levels of a lapped transform of what the Gaussians leave, tile by tile (spec §11).
//!
//! `head` says how the levels are meant, `index` where each tile's stream lies, `tile` codes one tile, `block` one block of it by
//! the models of `model`.

pub(crate) mod block;
pub(crate) mod decisions;
pub(crate) mod given;
pub(crate) mod head;
pub(crate) mod index;
#[cfg(test)]
mod learn;
pub(crate) mod levels;
mod made;
pub(crate) mod model;
pub(crate) mod scan;
mod start;
pub(crate) mod tile;

pub use head::DetailHead;
pub use index::DetailLayer;
#[doc(hidden)]
pub use made::Maker;
