//! The building blocks of a fit: primitives and their projection, the target as planes, errors and gradients, and the
//! places where primitives are missing.

pub mod adam;
pub mod drawing;
pub mod objective;
pub mod placing;
pub mod problem;
