//! The layouts that do not use the range coder: bit fields, and planes in zstd frames (spec §6, §7).

pub(super) mod bits;
pub(super) mod frame;
pub(super) mod hilbert;
pub(super) mod packed;
pub(super) mod planes;
