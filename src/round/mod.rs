//! Rounding fitted primitives to integers: step sizes, freezing on the lattice, descent over the integers, the asked size.

pub(crate) mod bit_cost;
pub(crate) mod bowl;
pub(crate) mod descend;
pub(crate) mod finish;
pub(crate) mod freeze;
mod patch;
