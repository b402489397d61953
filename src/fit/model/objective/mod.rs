//! The objective of a fit: the target as planes at several sizes, and the weight of each pixel.

pub(crate) mod blur;
pub(crate) mod masking;
pub mod planes;
pub(crate) mod reduced;
pub(crate) mod reweigh;
pub mod rows;
