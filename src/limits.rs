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
    /// Most work of rasterizing one view. On the CPU: the pixels that its Gaussians cover, four times those of narrow ones, and 1024 for
    /// each (Gaussian, tile) pair; and of a detail layer 16 for each sample and 200 for each level. On a GPU: the 256 pixels
    /// of each pair with one of its smaller tiles, and the same for a detail layer.
    pub work: u64,
    /// Most Gaussians over a pixel of a view on average: keeps the work in proportion to output pixels and primitives.
    /// Work of 2³² in all and of 4096 for each primitive is free of it, so that small pictures may be dense.
    pub overlap: u64,
    /// Most bytes that decoding may allocate in all, output included; never more than `isize::MAX`.
    pub alloc: u64,
    /// Most bytes of metadata (ICC profile, EXIF) kept.
    pub metadata: u64,
}

/// Work that [`Limits::overlap`] leaves free: in all, and for each primitive.
const FREE_WORK: u64 = 1 << 32;
const FREE_WORK_EACH: u64 = 4096;

impl Default for Limits {
    fn default() -> Self {
        Limits {
            width: 1 << 20,
            height: 1 << 20,
            primitives: 16 << 20,
            tile_pairs: 256 << 20,
            work: 3 << 34,
            overlap: 256,
            // What can be had of an address space of 32 bits.
            alloc: if usize::BITS < 64 { 1 << 30 } else { 4 << 30 },
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

    /// Most work that a view of so many pixels of a picture of so many primitives may be.
    pub(crate) fn most_work(&self, pixels: u64, primitives: u64) -> u64 {
        let free = FREE_WORK + FREE_WORK_EACH * primitives;
        self.work.min(self.overlap.saturating_mul(pixels).saturating_add(free))
    }
}
