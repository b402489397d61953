//! Rounds fitted primitives to integers: step sizes, descent over the integers, and the requested file size.
//!
//! This module works on the integers of [`bitstream::splats`](crate::bitstream::splats) and never sees a file. The
//! caller, which writes the file, reports its length through [`finish::Client`].

mod bit_cost;
pub(crate) mod descend;
pub(crate) mod finish;
mod local_quadratic;
mod patch;
pub(crate) mod rounded;
pub(crate) mod size;
pub(crate) mod size_loop;
