//! Gaussians in the formats of other programs: NumPy archives, tables, splat viewers' points, drawings.

pub mod csv;
pub mod foreign;
pub mod format;
pub mod npy;
pub mod npz;
pub mod parameters;
pub mod ply;
pub mod problem;
pub mod svg;
