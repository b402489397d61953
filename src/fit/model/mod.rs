//! The parts of a fit: primitives and their projection, the picture as planes, its errors and gradients, and the places
//! where it lacks something.

pub(crate) mod adam;
pub mod drawing;
pub mod objective;
pub mod placing;
pub mod problem;
