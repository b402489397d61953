//! Tests of reading, rendering, and the bytes of files: one program, because linking takes longer than most of its
//! tests. `cargo test --release --test reading vectors::` runs one module.
//!
//! Programs of their own: `api`, which uses stable names only and is packaged; `memory`, which counts what is allocated;
//! `image_taken`, which registers another hook; `gpu`, which needs that feature.
#![cfg(feature = "unstable")]

#[path = "../groups/mod.rs"]
mod groups;
#[path = "../scenes/mod.rs"]
mod scenes;
#[path = "../seal/mod.rs"]
mod seal;
#[path = "../sha256/mod.rs"]
mod sha256;
#[path = "../synthetic/mod.rs"]
mod synthetic;

mod bitstream;
mod cut;
#[cfg(feature = "encode")]
mod decode;
mod detail;
mod finds;
#[cfg(all(feature = "encode", feature = "image"))]
mod image;
mod malformed;
mod raster;
#[cfg(feature = "encode")]
mod simd;
#[cfg(feature = "encode")]
mod thumbnail;
mod vectors;
