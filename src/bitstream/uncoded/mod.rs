//! The layouts without an entropy coder of our own: fields of bits, and planes in zstd frames (spec §6, §7).

pub(super) mod bits;
pub(super) mod frame;
pub(super) mod hilbert;
pub(super) mod packed;
pub(super) mod planes;
