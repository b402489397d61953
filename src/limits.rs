//! Limits on the memory and work of decoding. They are checked before memory or time is spent.

use crate::error::{Error, Result};

/// Limits on the cost of decoding. The defaults allow a 16K picture with two million primitives.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct Limits {
    /// Largest width in pixels; by default 2²⁰, the most that the format allows.
    pub width: u32,
    /// Largest height in pixels; by default 2²⁰.
    pub height: u32,
    /// Largest number of primitives; by default 2²⁴.
    pub primitives: u64,
    /// Largest number of (Gaussian, tile) pairs that rasterizing one view may visit; by default 2²⁸.
    pub tile_pairs: u64,
    /// Largest work of rasterizing one view; by default 3·2³⁴. On the CPU it counts 1 for each pixel that a Gaussian
    /// covers (4 for narrow Gaussians), 1024 for each (Gaussian, tile) pair, and for a detail layer 16 for each sample,
    /// 200 for each level, and in a view of another size 6 for each weight that pixels are sums by. On a GPU it counts 256 for each pair with one of the GPU's smaller tiles, and the same
    /// for a detail layer.
    pub work: u64,
    /// Largest mean number of Gaussians over a pixel of a view; by default 256. It keeps the work in proportion to
    /// output pixels and primitives. Work of up to 2³² + 4096 × primitives is exempt, so that small pictures may be
    /// dense.
    pub overlap: u64,
    /// Most bytes that decoding may allocate at the same time, the output included; by default 4 GiB, or 1 GiB on
    /// 32-bit systems. Values over `isize::MAX` count as that.
    pub alloc: u64,
    /// Most bytes of metadata (ICC profile, EXIF block, thumbnail); by default 64 MiB.
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
            // Part of a 32-bit address space that can usually be allocated.
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

    /// Returns the largest work allowed for a view of `pixels` pixels of a picture of `primitives` primitives.
    pub(crate) fn most_work(&self, pixels: u64, primitives: u64) -> u64 {
        let free = FREE_WORK + FREE_WORK_EACH * primitives;
        self.work.min(self.overlap.saturating_mul(pixels).saturating_add(free))
    }
}
