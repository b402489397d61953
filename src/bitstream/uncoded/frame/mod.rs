//! Writes and reads the zstd frame of a plane (spec §7).
//!
//! All machines read frames with the same library. Libraries differ in how they treat a broken frame: with zstd on
//! native machines and another library in WebAssembly, where no C is compiled, a file could be accepted by one and
//! refused by the other.

mod compress;
mod decompress;
mod outline;

pub(super) use compress::compress;
pub(super) use decompress::decompress;
pub(super) use outline::outline;
