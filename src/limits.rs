//! Limits on the memory and work of decoding, checked before memory or time is spent.

use crate::error::{Error, Result};
use crate::parameter::Limit;

/// Limits on the cost of decoding. The defaults allow a picture of 16K resolution with two million Gaussians.
///
/// Set stricter limits for files from untrusted sources. A file that exceeds a limit is refused with
/// [`Error::LimitExceeded`], which names the field.
///
/// ```
/// use ssplat::{Decoder, Limits};
///
/// let limits = Limits::default().width(4096).height(4096).alloc(256 << 20); // 256 MiB
/// let decoder = Decoder::new().limits(limits);
/// # let _ = decoder;
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
#[doc(alias("untrusted", "security", "dos"))]
pub struct Limits {
    /// Maximum width in pixels; by default 2²⁰, the maximum of the format.
    pub width: u32,
    /// Maximum height in pixels; by default 2²⁰, the maximum of the format.
    pub height: u32,
    /// Maximum number of Gaussians; by default 2²⁴.
    pub gaussians: u64,
    /// Maximum number of (Gaussian, tile) pairs that rasterizing one view may visit; by default 2²⁸.
    pub tile_pairs: u64,
    /// Maximum work of rasterizing one view; by default 3·2³⁴. On the CPU, each pixel that a Gaussian covers costs 1
    /// (4 for narrow Gaussians), and each (Gaussian, tile) pair costs 1024. A detail layer costs 16 for each sample,
    /// 200 for each level and, for resized views, 6 per resampling tap. On a GPU, each pair with one of the GPU's
    /// smaller tiles costs 256, and a detail layer costs the same as on the CPU.
    #[doc(alias = "time")]
    pub work: u64,
    /// Maximum mean number of Gaussians over a pixel of a view; by default 256. It bounds the work in proportion to
    /// output pixels and Gaussians. Work of up to 2³² + 4096 × Gaussians is exempt, so that small pictures may be
    /// dense.
    pub overlap: u64,
    /// Maximum number of bytes that decoding may have allocated at the same time, including the output; by default 4
    /// GiB, or 1 GiB on 32-bit systems. Values over `isize::MAX` are treated as `isize::MAX`.
    #[doc(alias("memory", "max_alloc"))]
    pub alloc: u64,
    /// Maximum number of bytes of metadata (ICC profile, EXIF block, thumbnail); by default 64 MiB.
    pub metadata: u64,
}

/// Work that [`Limits::overlap`] does not restrict: a constant, and an amount for each Gaussian.
const FREE_WORK: u64 = 1 << 32;
const FREE_WORK_EACH: u64 = 4096;

impl Default for Limits {
    fn default() -> Self {
        Limits {
            width: 1 << 20,
            height: 1 << 20,
            gaussians: 16 << 20,
            tile_pairs: 256 << 20,
            work: 3 << 34,
            overlap: 256,
            // Amount that can usually be allocated in a 32-bit address space.
            alloc: if usize::BITS < 64 { 1 << 30 } else { 4 << 30 },
            metadata: 64 << 20,
        }
    }
}

/// Defines setters, because a struct that may grow cannot be written as a literal.
macro_rules! setters {
    ($($field:ident: $type:ty,)*) => {$(
        #[doc = concat!("Sets [`", stringify!($field), "`](Self#structfield.", stringify!($field), ").")]
        #[must_use]
        pub const fn $field(mut self, $field: $type) -> Self {
            self.$field = $field;
            self
        }
    )*};
}

impl Limits {
    setters! {
        width: u32,
        height: u32,
        gaussians: u64,
        tile_pairs: u64,
        work: u64,
        overlap: u64,
        alloc: u64,
        metadata: u64,
    }

    /// Checks `requested` against `allowed`.
    ///
    /// # Errors
    /// [`Error::LimitExceeded`] naming `limit` when `requested > allowed`.
    pub(crate) fn check(limit: Limit, requested: u64, allowed: u64) -> Result<()> {
        if requested > allowed {
            return Err(Error::LimitExceeded { limit, requested, allowed });
        }
        Ok(())
    }

    /// Returns the maximum work for a view of `pixels` pixels of a picture with `gaussians` Gaussians.
    pub(crate) fn max_work(&self, pixels: u64, gaussians: u64) -> u64 {
        let free = FREE_WORK + FREE_WORK_EACH * gaussians;
        self.work.min(self.overlap.saturating_mul(pixels).saturating_add(free))
    }
}
