//! The `ssplat` program.

fn main() {}
