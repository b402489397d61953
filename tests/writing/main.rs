//! Tests of the encoder: one program, because linking takes longer than most of its tests.
//! `cargo test --release --test writing tiles::` runs one module.

#[path = "../sha256/mod.rs"]
mod sha256;
#[path = "../stiff/mod.rs"]
mod stiff;
#[path = "../synthetic/mod.rs"]
mod synthetic;
#[path = "../waves/mod.rs"]
mod waves;

mod encode;
mod exact;
mod hidden;
mod left_out;
mod metrics;
mod pinned;
mod properties;
mod quality;
mod rate_control;
mod stability;
mod tiles;
