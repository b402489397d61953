//! Tests of the program: one program, because linking takes longer than most of its tests.
//! `cargo test --release --test program view::` runs one module.
//!
//! Programs of their own: `tiled_memory`, which reads the peak of all processes that a test has started; `gpu`, which
//! needs that feature.

#[path = "../folder/mod.rs"]
mod folder;
#[path = "../../../tests/waves/mod.rs"]
mod waves;

#[cfg(feature = "avif")]
mod avif;
mod cli;
mod cut;
#[cfg(unix)]
mod door;
mod exchange;
mod finds;
mod inputs_told;
#[cfg(feature = "jxl")]
mod jxl;
mod partial;
mod placeholder;
mod shell;
mod tiles;
mod view;
