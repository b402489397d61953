//! What a file may ask for: memory and work are bounded before they are spent.

use crate::error::{Error, Result};

/// Bounds on what decoding may cost. The defaults let a 16K picture with two million primitives through.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct Limits {
    /// Largest width, pixels.
    pub width: u32,
    /// Largest height, pixels.
    pub height: u32,
    /// Most primitives.
    pub primitives: u64,
    /// Most (Gaussian, tile) pairs that rasterizing one view may visit.
    pub tile_pairs: u64,
    /// Most (Gaussian, tile) pairs for each tile of a view on average, beyond two a primitive and 2¹⁹ in all: keeps
    /// the work in proportion to output pixels and primitives.
    pub tile_load: u64,
    /// Most bytes that decoding may allocate in all, output included.
    pub alloc: u64,
    /// Most bytes of metadata (ICC profile, EXIF) kept.
    pub metadata: u64,
}

impl Default for Limits {
    fn default() -> Self {
        Limits {
            width: 1 << 20,
            height: 1 << 20,
            primitives: 16 << 20,
            tile_pairs: 256 << 20,
            tile_load: 1024,
            alloc: 4 << 30,
            metadata: 64 << 20,
        }
    }
}

impl Limits {
    /// Checks `requested` against `allowed`.
    ///
    /// # Errors
    /// [`Error::LimitExceeded`] naming `what` when `requested > allowed`.
    pub(crate) fn check(what: &'static str, requested: u64, allowed: u64) -> Result<()> {
        if requested > allowed {
            return Err(Error::LimitExceeded { what, requested, allowed });
        }
        Ok(())
    }
}
