//! One zstd frame of a plane, made and read (spec §7): by zstd itself, or in WebAssembly, where no C is compiled, by a
//! reader in Rust.

#[cfg(not(target_family = "wasm"))]
mod native;
mod outline;
#[cfg(target_family = "wasm")]
mod wasm;

#[cfg(not(target_family = "wasm"))]
pub(super) use native::{compress, decompress};
#[cfg(target_family = "wasm")]
pub(super) use wasm::{compress, decompress};

pub(super) use outline::outline;
