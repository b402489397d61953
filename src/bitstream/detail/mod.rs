//! The detail layer: levels of a lapped transform of the Gaussians' residual, tile by tile (spec §11).
//!
//! `head` has the parameters of the levels, `index` the position of each tile's stream, `tile` codes one tile, and
//! `block` one of its blocks with the models of `model`.

pub(crate) mod block;
#[cfg(feature = "encode")]
pub(crate) mod block_price;
pub(crate) mod decisions;
pub(crate) mod given;
pub(crate) mod head;
pub(crate) mod index;
#[cfg(test)]
mod learn;
pub(crate) mod levels;
#[cfg(any(test, feature = "unstable"))]
mod made;
pub(crate) mod model;
pub(crate) mod scan;
mod start;
pub(crate) mod tile;

#[cfg(any(feature = "encode", feature = "unstable"))]
pub use head::DetailHead;
pub use index::DetailLayer;
#[cfg(any(test, feature = "unstable"))]
pub use made::Maker;
