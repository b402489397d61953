//! Internal modules for the program, the lab, the fuzz targets and similar tools. **Any release may change them.**
//!
//! Bytes become integers ([`bitstream`]), integers become Gaussians ([`quantize`]), and Gaussians become pixels
//! ([`raster`]). [`fit`] fits Gaussians to a picture, and [`Precision`] is how finely
//! [`Encoder::encode_gaussians`](crate::Encoder::encode_gaussians) quantizes Gaussians that were fitted elsewhere.
//! `docs/ARCHITECTURE.md` is a map of the modules.

pub use crate::bitstream::header::Header;
pub use crate::decode::{decode, decode_into};
#[cfg(feature = "encode")]
pub use crate::encode::{MAX_WHOLE_PIXELS, Texture, divide, encode, encode_with_progress};
#[cfg(all(feature = "encode", feature = "image"))]
pub use crate::image_crate::{Carried, encode_decoder, save, transcode};
pub use crate::options::DecodeOptions;
#[cfg(feature = "encode")]
pub use crate::options::{EncodeOptions, Needs, Outside, Precision, Recipe, Rung};
#[cfg(feature = "encode")]
pub use crate::pack::FINEST;
#[cfg(feature = "encode")]
pub use crate::pixel_source::check_area;
pub use crate::simd::instruction_set;
#[cfg(feature = "quality-hook")]
pub use crate::target::DEFAULT_QUALITY;

/// Converts bytes to integers and back.
pub mod bitstream {
    pub use crate::bitstream::*;
}
/// Fits Gaussians to pixels.
#[cfg(feature = "encode")]
pub mod fit {
    pub use crate::fit::*;
}
/// The picture as a continuous function of position.
pub mod gaussian {
    pub use crate::gaussian::*;
}
/// The SSIMULACRA2 of builds that have none of their own.
#[cfg(all(feature = "quality-hook", not(feature = "quality")))]
pub mod score {
    pub use crate::ssimulacra2::provide_score;
}
/// Points in time.
#[cfg(all(feature = "encode", target_family = "wasm", target_os = "unknown"))]
pub mod instant {
    pub use crate::instant::provide_clock;
}
/// What picture files state about their colours.
#[cfg(all(feature = "image", feature = "encode"))]
pub mod colour {
    pub use crate::image_crate::colour::*;
    pub use crate::image_crate::overlay::*;
    pub use crate::image_crate::stated::*;
}
/// Decoding pictures of the `image` crate within limits.
#[cfg(all(feature = "image", feature = "encode"))]
pub mod input {
    pub use crate::image_crate::input::*;
}
/// Measures of the difference between two pictures.
#[cfg(feature = "encode")]
pub mod metrics {
    pub use crate::metrics::*;
}
/// Parallel maps.
pub mod parallel {
    pub use crate::parallel::*;
}
/// Converts integers to Gaussians and back.
pub mod quantize {
    pub use crate::quantize::*;
}
/// Renders Gaussians to pixels.
pub mod raster {
    pub use crate::raster::*;
}
/// Vectors of eight lanes.
pub mod simd {
    pub use crate::simd::*;
}
/// The weights of squared errors.
#[cfg(feature = "encode")]
pub mod weighting {
    pub use crate::weighting::RowWeights;
}
