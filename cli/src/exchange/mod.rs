//! Gaussians in formats of other programs: NumPy archives, CSV, points for splat viewers, drawings.

pub mod csv;
pub mod foreign;
pub mod format;
pub mod npy;
pub mod npz;
pub mod parameters;
pub mod ply;
pub mod problem;
pub mod stated;
pub mod svg;
