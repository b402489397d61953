//! The rooms inside, for the program, the lab, the fuzz targets and tools like them. **Every release may change them.**
//!
//! Bytes become integers ([`bitstream`]), integers become Gaussians ([`quantize`]), Gaussians become pixels ([`raster`]);
//! [`fit`] moves Gaussians to a picture, [`pack`] rounds those that came from elsewhere. `docs/ARCHITECTURE.md` is the map.

pub use crate::bitstream::header::Header;
pub use crate::decode::{decode, decode_into, thumbnail};
pub use crate::encode::{LARGEST, TracePoint, divide, encode, encode_with_progress};
#[cfg(feature = "image")]
pub use crate::image_crate::{Carried, encode_decoder, save, transcode};
pub use crate::options::{Ablation, DecodeOptions, EncodeOptions, Needs, Recipe, Rung, Trace};
pub use crate::pack::{FINEST, Outside, PackOptions, Precision, pack};
pub use crate::pixel_source::check_area;
pub use crate::simd::instruction_set;

/// Bytes to integers and back.
pub mod bitstream {
    pub use crate::bitstream::*;
}
/// Pixels to Gaussians.
pub mod fit {
    pub use crate::fit::*;
}
/// The picture as a function of the plane.
pub mod gaussian {
    pub use crate::gaussian::*;
}
/// How far two pictures are apart.
pub mod metrics {
    pub use crate::metrics::*;
}
/// Work on several cores.
pub mod parallel {
    pub use crate::parallel::*;
}
/// Integers to Gaussians and back.
pub mod quantize {
    pub use crate::quantize::*;
}
/// Gaussians to pixels.
pub mod raster {
    pub use crate::raster::*;
}
/// Eight lanes.
pub mod simd {
    pub use crate::simd::*;
}
