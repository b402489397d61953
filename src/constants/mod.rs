//! The fitted constants of the encoder: weights, thresholds, factors and shares that were chosen by measurement.
//!
//! Each part of the encoder has a file. The documentation of a constant states what it decides or bounds, its unit, and
//! what was measured. `python lab/constants.py --list` prints all of them, and this measures the effect of other values of
//! any of them, with a build for each value:
//!
//! ```sh
//! python lab/constants.py detail::MIXED_COST 1.0 1.15 1.3 --pictures PICTURES --ratio 50
//! ```
//!
//! Where another command fits or measures a constant as well, its documentation names the command. The settings of the
//! efforts are in [`effort`](crate::effort). Limits of the format and of memory, sizes of arrays, and guards against
//! rounding errors stay beside their use.

pub(crate) mod allocation;
pub(crate) mod detail;
pub(crate) mod division;
pub(crate) mod encode;
pub(crate) mod exact;
pub(crate) mod fit;
#[cfg(feature = "quality-hook")]
pub(crate) mod quality;
pub(crate) mod rate_control;
pub(crate) mod rdo;
pub(crate) mod tiles;
