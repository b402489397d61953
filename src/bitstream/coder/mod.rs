//! The entropy coder of the coded layout: Gaussians to bits and back, and estimates of their cost in bits (spec §8).

pub(super) mod attributes;
pub(super) mod coded;
pub(crate) mod expect;
pub(super) mod kd;
pub(super) mod model;
pub(super) mod neighbours;
pub mod range;
pub(super) mod spread;
