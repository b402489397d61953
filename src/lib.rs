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
//! use ssplat::{Channels, Decoder, Encoder, Pixels, Samples};
//!
//! // A grey ramp of 32 × 16 pixels, rows from the top, 8 bits a sample.
//! let ramp = (0..32 * 16).map(|i| (i % 32 * 8) as u8).collect();
//! let pixels = Pixels::new(32, 16, Channels::Grey, Samples::U8(ramp))?;
//!
//! let encoded = Encoder::new().bytes(120).effort(1).encode(&pixels)?;
//! assert!(encoded.bytes.len() <= 120);
//!
//! let decoded = Decoder::new().decode(&encoded.bytes)?;
//! assert_eq!((decoded.pixels.width(), decoded.pixels.height()), (32, 16));
//! # Ok::<(), ssplat::Error>(())
//! ```
//!
//! Open a file once and draw it many times, any part at any size. What lies outside is not drawn:
//!
//! ```
//! # use ssplat::{Channels, Encoder, Pixels, Samples};
//! # let ramp = (0..32 * 16).map(|i| (i % 32 * 8) as u8).collect();
//! # let pixels = Pixels::new(32, 16, Channels::Grey, Samples::U8(ramp))?;
//! # let bytes = Encoder::new().effort(1).encode(&pixels)?.bytes;
//! use ssplat::{Damage, Limits, Reader};
//!
//! let reader = Reader::new(&bytes, &Limits::default())?; // the header and no more
//! assert_eq!(reader.width(), 32);
//! let image = reader.read(Damage::Refuse)?;
//! let view = image.view().crop(8, 4, 16, 8)?; // left, top, width, height in pixels of the picture
//! let part = image.draw(&view.resized(64, 32)?)?;
//! assert_eq!(part.width(), 64);
//! # Ok::<(), ssplat::Error>(())
//! ```
//!
#![cfg_attr(
    feature = "image",
    doc = r#"
Open files through the `image` crate, whose hooks know the format after one call:

```
ssplat::register();
# let folder = tempfile::tempdir()?;
# let path = folder.path().join("picture.ssplat");
# ssplat::Encoder::new().effort(1).save(&image::DynamicImage::new_rgb8(8, 8), &path)?;
let picture = image::open(path)?;
assert_eq!(picture.width(), 8);
# Ok::<(), Box<dyn std::error::Error>>(())
```
"#
)]
//! # What is promised
//!
//! Every file that a 1.x version writes is read by all later ones. The names on this page follow semantic versioning; those
//! of the feature `unstable` do not. `wgpu` and `image` are re-exported: a new minor version of this crate may need a newer one.
//!
//! # The way through the crate
//!
//! Bytes become integers exactly (`bitstream`), integers become Gaussians by the specification's formulas
//! (`quantize`), Gaussians become pixels within a stated error (`raster`), and the `image` crate stands at the door.
//! The repository's `docs/ARCHITECTURE.md` is the map, `spec/ssplat.md` the format.

#![cfg_attr(not(feature = "unstable"), warn(missing_docs))]
// docs.rs builds with nightly; each item then shows the feature that it needs.
#![cfg_attr(docsrs, feature(doc_cfg))]
// Items that only the program and the lab use are dead code without their feature.
#![cfg_attr(not(any(test, feature = "unstable")), allow(dead_code, unused_imports))]

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
mod target;
#[cfg(any(test, feature = "unstable"))]
pub mod unstable;

pub use bitstream::Missing;
pub use bitstream::splats::{Layout, Metadata};
pub use decode::{Decoded, Decoder, Image, Reader};
pub use encode::{EncodeReport, Encoded, Encoder, Progress, Workers, work_on_tile};
pub use error::{Error, FormatError, GpuError, Result};
pub use gaussian::{Blend, Channels, Gaussian, Picture};
#[cfg(feature = "image")]
pub use image;
#[cfg(feature = "image")]
pub use image_crate::{EXTENSION, SsplatDecoder, SsplatEncoder, register};
pub use limits::Limits;
pub use options::{Backend, Carry, Damage, Detail, HiddenColors, Layers, Thumbnail, Tune};
pub use pixel_source::PixelSource;
pub use pixels::{Depth, Pixels, Samples};
pub use raster::{Renderer, SamplesMut, View};
pub use target::Target;

/// Types of the account that an encode gives beside its bytes.
pub mod report {
    pub use crate::encode::{Chosen, LeftOut, Omission, StageTime};
}
