//! Converts levels of the detail layer to additions to a picture; exact, in integers modulo 2³² (spec §11.5).
//!
//! `steps` dequantizes levels, `transform` applies the inverse transform, `lap` filters the block edges, and `tile`
//! does all of it for a tile, in the superblocks that `supers` selects.

pub(crate) mod lap;
pub(crate) mod steps;
pub(crate) mod supers;
pub(crate) mod tile;
pub(crate) mod transform;
