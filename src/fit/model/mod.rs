//! The parts of a fit: primitives and their projection, the picture as planes, its errors and gradients, and the places
//! where it lacks something.

pub(crate) mod adam;
pub(crate) mod blur;
pub mod field;
pub mod kernel;
pub(crate) mod masking;
pub(crate) mod peaks;
pub mod planes;
pub mod problem;
pub mod project;
pub(crate) mod reduced;
pub(crate) mod removal;
pub(crate) mod reweigh;
pub(crate) mod ridge;
pub mod rows;
pub(crate) mod sample;
pub mod strips;
pub mod structure;
