//! ssplat: pictures stored as 2D Gaussians ("splats") instead of pixels.
//!
//! An `.ssplat` file holds a picture as coloured, stretched and rotated Gaussians. It is a function of the plane, so any
//! region can be drawn at any size. The crate encodes pixels to such files, decodes them, and opens them through the
//! [`image`](https://docs.rs/image) crate.
//!
//! # Three uses
//!
//! Encode pixels, and decode them again:
//!
//! ```
//! use ssplat::{Channels, DecodeOptions, EncodeOptions, Pixels, Samples, Target};
//!
//! // A grey ramp of 32 × 16 pixels, rows from the top, 8 bits a sample.
//! let ramp = (0..32 * 16).map(|i| (i % 32 * 8) as u8).collect();
//! let pixels = Pixels::new(32, 16, Channels::Grey, Samples::U8(ramp))?;
//!
//! let mut options = EncodeOptions::default();
//! options.target = Target::Bytes(120);
//! options.effort = 1;
//! let encoded = ssplat::encode(&pixels, &options)?;
//! assert!(encoded.bytes.len() <= 120);
//!
//! let decoded = ssplat::decode(&encoded.bytes, &DecodeOptions::default())?;
//! assert_eq!((decoded.pixels.width(), decoded.pixels.height()), (32, 16));
//! # Ok::<(), ssplat::Error>(())
//! ```
//!
//! Draw a part of a file at another size. What lies outside is not drawn, and in large files not even read:
//!
//! ```
//! # use ssplat::{Channels, DecodeOptions, EncodeOptions, Pixels, Samples};
//! # let ramp = (0..32 * 16).map(|i| (i % 32 * 8) as u8).collect();
//! # let pixels = Pixels::new(32, 16, Channels::Grey, Samples::U8(ramp))?;
//! # let mut options = EncodeOptions::default();
//! # options.effort = 1;
//! # let bytes = ssplat::encode(&pixels, &options)?.bytes;
//! let mut options = DecodeOptions::default();
//! options.region = Some([8, 4, 16, 8]); // left, top, width, height in pixels of the picture
//! options.size = Some([64, 32]); // width and height of what is drawn
//! let detail = ssplat::decode(&bytes, &options)?.pixels;
//! assert_eq!(detail.width(), 64);
//! # Ok::<(), ssplat::Error>(())
//! ```
//!
//! Open files through the `image` crate, whose hooks know the format after one call:
//!
//! ```
//! ssplat::register();
//! # let folder = tempfile::tempdir()?;
//! # let path = folder.path().join("picture.ssplat");
//! # let mut options = ssplat::EncodeOptions::default();
//! # options.effort = 1;
//! # ssplat::save(&image::DynamicImage::new_rgb8(8, 8), &path, &options)?;
//! let picture = image::open(path)?;
//! assert_eq!(picture.width(), 8);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # The way through the crate
//!
//! Bytes become integers exactly (`bitstream`), integers become Gaussians by the specification's formulas
//! (`quantize`), Gaussians become pixels within a stated error (`raster`), and the `image` crate stands at the door.
//! The repository's `docs/ARCHITECTURE.md` is the map, `spec/ssplat.md` the format.

#![cfg_attr(not(feature = "unstable"), warn(missing_docs))]
// What only the program and the lab use is dead without them.
#![cfg_attr(not(any(test, feature = "unstable")), allow(dead_code))]

// Tests inside share pictures with those outside, which name this crate.
#[cfg(test)]
extern crate self as ssplat;

mod angle;
mod bitstream;
mod budget;
mod decode;
mod detail;
mod encode;
mod error;
mod fit;
mod gaussian;
#[cfg(feature = "gpu")]
pub mod gpu;
#[cfg(feature = "image")]
mod image_crate;
mod limits;
mod metrics;
mod options;
mod pack;
mod parallel;
mod pixel_source;
mod pixels;
mod quantize;
mod raster;
mod round;
mod simd;
#[cfg(feature = "quality")]
mod ssimulacra2;
#[cfg(any(test, feature = "unstable"))]
pub mod unstable;

pub use bitstream::Missing;
pub use bitstream::header::Header;
pub use bitstream::splats::{Layout, Metadata};
pub use decode::{Decoded, Opened, Opening, decode, decode_into, thumbnail};
pub use encode::{
    Chosen, EncodeReport, Encoded, LeftOut, Omission, Progress, TracePoint, Workers, encode, encode_divided,
    encode_source, encode_with_progress, work_on_tile,
};
pub use error::{Error, FormatError, GpuError, Result};
pub use gaussian::{Blend, Channels, Gaussian, Picture};
#[cfg(feature = "image")]
pub use image_crate::{Carried, EXTENSION, SsplatDecoder, SsplatEncoder, encode_decoder, register, save, transcode};
pub use limits::Limits;
pub use options::{Backend, Carry, Damage, DecodeOptions, Detail, EncodeOptions, Layers, Target, Thumbnail, Tune};
pub use pixel_source::PixelSource;
pub use pixels::{Depth, Pixels, Samples};
pub use raster::{Renderer, SamplesMut, View};
