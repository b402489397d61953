//! Estimates how many primitives fit into a file.

use super::input::too_small_with;
use crate::bitstream::splats::Layout;
use crate::constants::rate_control;
use crate::error::Result;
use crate::options::EncodeOptions;

/// Maximum number of primitives that an encode fits.
pub(super) const MAX_PRIMITIVES: u64 = 16 << 20;

/// Returns the initial number of primitives for a file of `most` bytes. `fixed` is the size of the file without
/// primitives, in bytes.
///
/// # Errors
/// [`Error::TooSmall`] if the file without primitives is larger than `most`.
pub(super) fn count_for(options: &EncodeOptions, most: u64, fixed: u64, samples: f64) -> Result<usize> {
    if most < fixed {
        return Err(too_small_with(options, most, fixed));
    }
    // These bits per primitive are estimates. The size is corrected while the integers are rounded.
    let bits = match options.layout {
        Layout::Packed => 56.0,
        Layout::Planes => rate_control::PLANES_BITS,
        Layout::Coded => rate_control::CODED_BITS,
    };
    let count = ((most - fixed) as f64 * 8.0 / bits) as u64;
    // More primitives than samples bring no gain.
    Ok(count.min(MAX_PRIMITIVES).min(samples as u64) as usize)
}

/// Returns the average number of bytes of `count` primitives that take `bytes` bytes.
pub(super) fn bytes_per_primitive(bytes: f64, count: usize) -> f64 {
    (bytes / count.max(1) as f64).max(rate_control::MIN_PRIMITIVE_BYTES)
}

/// Returns how many primitives of `each` bytes fit into a file of `max_bytes` bytes, of which `fixed` are not
/// primitives. A fit of `count` primitives may start with some more.
pub(super) fn count_in(max_bytes: u64, fixed: f64, each: f64, count: usize) -> usize {
    ((max_bytes as f64 * excess(count) - fixed) / each).max(0.0) as usize
}

/// Returns the over-allocation factor of a fit of this many primitives. Descent makes the primitives cheaper, and
/// pruning removes the remaining excess.
pub(super) fn excess(primitives: usize) -> f64 {
    match primitives < rate_control::FEW_PRIMITIVES {
        true => rate_control::EXCESS_OF_FEW,
        false => rate_control::EXCESS_OF_MANY,
    }
}
