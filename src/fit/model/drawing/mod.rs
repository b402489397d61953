//! Draws primitives on the pixel grid: their picture, its error and its gradients.

pub mod field;
pub mod kernel;
pub mod project;
pub mod strips;
pub mod walk;
