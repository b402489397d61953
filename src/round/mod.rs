//! Rounding fitted primitives to integers: step sizes, freezing on the lattice, descent over the integers, the asked size.
//!
//! Rounding works on the integers of [`bitstream::splats`](crate::bitstream::splats) and never sees a file: whoever makes
//! it tells through [`finish::Client`] how many bytes it takes.

mod bit_cost;
pub(crate) mod descend;
pub(crate) mod finish;
mod freeze;
mod local_quadratic;
mod patch;
pub(crate) mod rounded;
pub(crate) mod size;
