//! The parts of a fit: primitives and their projection, the picture as planes, its errors and gradients, and the places
//! where it lacks something.

pub(crate) mod adam;
pub(crate) mod blur;
pub(crate) mod field;
pub(crate) mod kernel;
pub(crate) mod masking;
pub(crate) mod peaks;
pub(crate) mod planes;
pub(crate) mod problem;
pub(crate) mod project;
pub(crate) mod reduced;
pub(crate) mod removal;
pub(crate) mod reweigh;
pub(crate) mod ridge;
pub(crate) mod rows;
pub(crate) mod sample;
pub(crate) mod strips;
pub(crate) mod structure;
