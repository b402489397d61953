//! The shaders in Rust, stage by stage, with the same names and the same order of statements. Tests compare the device
//! with them.

pub(super) mod adam;
pub(super) mod backward;
pub(super) mod bin;
pub(super) mod blur;
pub(super) mod common;
pub(super) mod forward;
pub(super) mod gather;
pub(super) mod halve;
pub(super) mod importance;
pub(super) mod pair;
pub(super) mod peaks;
pub(super) mod project;
pub(super) mod relocate;
pub(super) mod render;
pub(super) mod residual;
pub(super) mod scan;
pub(super) mod sort;
pub(super) mod tile;
