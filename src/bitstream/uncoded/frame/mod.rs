//! One zstd frame of a plane, made and read (spec §7).
//!
//! It is read by one library on every machine. Libraries differ in what they make of a broken frame: with zstd itself here and another
//! one in WebAssembly, where no C is compiled, a file could be accepted here and refused there.

mod compress;
mod decompress;
mod outline;

pub(super) use compress::compress;
pub(super) use decompress::decompress;
pub(super) use outline::outline;
