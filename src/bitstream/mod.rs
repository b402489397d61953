//! Bytes to integers and back; exact. Knows no colour and no pixel.

pub mod lattice;
pub mod splats;
