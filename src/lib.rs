//! Image compression with 2D Gaussians, a detail layer and an exact layer: encoder and decoder of the `.ssplat`
//! format.
//!
//! A file stores a picture as coloured, stretched and rotated Gaussians ("splats") instead of pixels, and where it
//! pays, a second layer with texture. It describes a continuous image, so any region can be rendered at any size. The
//! format is designed for high compression: a photograph of 768 × 512 pixels takes 1 to 20 kB, and a placeholder 100 to
//! 1000 bytes. Pictures can also be stored without loss.
//!
//! This page leads through the crate: [encoding](#encoding), [decoding](#decoding),
//! [rendering regions](#rendering-regions), [the `image` crate](#the-image-crate),
//! [limits and untrusted files](#limits-and-untrusted-files), [the GPU](#the-gpu) and the [features](#features).
//!
//! # Encoding
//!
//! [`Encoder`] has a setter for each option. The target is a perceptual quality, a [ratio](Encoder::ratio) (raw size
//! divided by file size), a size in [bytes](Encoder::bytes), a [PSNR](Encoder::psnr) or a number of Gaussians; see
//! [`Target`]. The default is a quality of 70: hard to tell from the original side by side.
//! [`effort`](Encoder::effort) and [`time`](Encoder::time) trade time for quality.
//!
//! ```
//! use ssplat::{Channels, Encoder, Pixels};
//!
//! // A grey gradient of 32 × 16 pixels: rows from the top, 8 bits per sample.
//! let gradient: Vec<u8> = (0..32 * 16).map(|i| (i % 32 * 8) as u8).collect();
//! let pixels = Pixels::new(32, 16, Channels::Grey, gradient)?;
//!
//! let encoded = Encoder::new().bytes(120).effort(1).encode(&pixels)?;
//! assert!(encoded.bytes.len() <= 120);
//! println!("{} Gaussians, {:.2} dB", encoded.report.gaussians, encoded.report.psnr);
//! # Ok::<(), ssplat::Error>(())
//! ```
//!
//! [`Encoder::encode_with_progress`] reports progress and can be cancelled. A picture that is larger than memory is
//! encoded from an implementation of [`PixelSource`], in tiles of 2048 pixels.
//!
//! # Decoding
//!
//! [`Decoder`] decodes a file in one call: the whole picture, a [region](Decoder::region), at any
//! [size](Decoder::size). [`Reader::thumbnail`] reads the thumbnail of a large file.
//!
//! ```
//! # use ssplat::{Channels, Encoder, Pixels};
//! # let gradient: Vec<u8> = (0..32 * 16).map(|i| (i % 32 * 8) as u8).collect();
//! # let pixels = Pixels::new(32, 16, Channels::Grey, gradient)?;
//! # let bytes = Encoder::new().bytes(120).effort(1).encode(&pixels)?.bytes;
//! use ssplat::Decoder;
//!
//! let decoded = Decoder::new().decode(&bytes)?;
//! assert_eq!((decoded.pixels.width(), decoded.pixels.height()), (32, 16));
//! assert!(decoded.metadata.icc.is_none());
//!
//! let small = Decoder::new().size([8, 4]).decode(&bytes)?.pixels; // low-pass filtered
//! assert_eq!((small.width(), small.height()), (8, 4));
//! # Ok::<(), ssplat::Error>(())
//! ```
//!
//! # Rendering regions
//!
//! A viewer renders a file many times. [`Reader`] reads the header of bytes in memory, of a [file](Reader::open) or of
//! any [`std::io::Read`](Reader::from_read), and [`Reader::read`] the rest. The resulting [`SsplatImage`] renders any
//! [`View`]: a region of the picture at a size. Only what is visible in the view is rendered. [`Reader::read_for`]
//! reads only the data that a view needs, which is little for a small region of a large file.
//!
//! ```
//! # use ssplat::{Channels, Encoder, Pixels};
//! # let gradient: Vec<u8> = (0..32 * 16).map(|i| (i % 32 * 8) as u8).collect();
//! # let pixels = Pixels::new(32, 16, Channels::Grey, gradient)?;
//! # let bytes = Encoder::new().effort(1).encode(&pixels)?.bytes;
//! use ssplat::{Limits, Reader, Rect};
//!
//! let reader = Reader::new(&bytes, &Limits::default())?; // reads the header only
//! assert_eq!((reader.width(), reader.height()), (32, 16));
//!
//! let image = reader.read()?;
//! let region = image.view().crop(Rect::new(8, 4, 16, 8))?; // left, top, width, height in pixels of the picture
//! let enlarged = image.render(&region.resized(64, 32)?)?;
//! assert_eq!((enlarged.width(), enlarged.height()), (64, 32));
//! # Ok::<(), ssplat::Error>(())
//! ```
//!
//! A view also selects the [layers](View::layers) of the file: the Gaussians, the detail layer or both.
//! [`SsplatImage::render_into`] renders into the caller's memory, and [`SsplatImage::renderer`] returns a [`Renderer`]
//! that renders a view band by band. The results have the same bits for any number of threads and any division into
//! parts.
//!
//! # Gaussians
//!
//! [`SsplatImage::gaussians`] returns the [`Gaussians`] of a file with float parameters, and
//! [`Encoder::encode_gaussians`] writes Gaussians from any source to a file. A [`Renderer`] renders them without a
//! file.
//!
//! ```
//! # use ssplat::{Channels, Pixels};
//! # let gradient: Vec<u8> = (0..32 * 16).map(|i| (i % 32 * 8) as u8).collect();
//! # let pixels = Pixels::new(32, 16, Channels::Grey, gradient)?;
//! # let bytes = ssplat::Encoder::new().effort(1).encode(&pixels)?.bytes;
//! use ssplat::{Encoder, Limits, Reader};
//!
//! let mut gaussians = Reader::new(&bytes, &Limits::default())?.read()?.gaussians()?;
//! gaussians.list.iter_mut().for_each(|g| g.color[0] *= 0.5);
//! let darker = Encoder::new().encode_gaussians(&gaussians)?.bytes;
//! # assert!(!darker.is_empty());
//! # Ok::<(), ssplat::Error>(())
//! ```
//!
//! # The `image` crate
//!
//! With the default feature `image`, the hooks of the [`image`](https://docs.rs/image) crate open `.ssplat` files, and
//! [`Encoder`] encodes pictures of that crate.
#![cfg_attr(
    feature = "image",
    doc = r#"
```
use ssplat::Encoder;
# let folder = tempfile::tempdir()?;
# let path = folder.path().join("picture.ssplat");

let picture = image::DynamicImage::new_rgb8(8, 8);
let bytes = Encoder::new().effort(1).encode(&picture)?.bytes;
Encoder::new().effort(1).save(&picture, &path)?; // to a file
# assert!(!bytes.is_empty());

ssplat::register(); // from here on, image::open, ImageReader and load_from_memory read .ssplat
let picture = image::open(&path)?;
assert_eq!(picture.width(), 8);
# Ok::<(), Box<dyn std::error::Error>>(())
```

`image` has no hook for saving, so use [`Encoder::save`], or [`SsplatEncoder`] where an `image::ImageEncoder` is needed.
[`Encoder::transcode`] encodes a file and keeps its ICC profile and orientation.
"#
)]
//!
//! # Limits and untrusted files
//!
//! Any input gives a picture or an [`Error`], without panics and without `unsafe` code in this crate. [`Limits`] bound
//! the dimensions, the memory and the work of decoding, and are checked before memory or time is spent. The defaults
//! allow large pictures; a service that decodes uploads should set its own:
//!
//! ```
//! # use ssplat::{Channels, Encoder, Pixels};
//! # let gradient: Vec<u8> = (0..32 * 16).map(|i| (i % 32 * 8) as u8).collect();
//! # let pixels = Pixels::new(32, 16, Channels::Grey, gradient)?;
//! # let bytes = Encoder::new().bytes(120).effort(1).encode(&pixels)?.bytes;
//! use ssplat::{Decoder, Error, Limit, Limits};
//!
//! let limits = Limits::default()
//!     .width(16) // pixels
//!     .alloc(64 << 20); // bytes, including the output
//!
//! match Decoder::new().limits(limits).decode(&bytes) {
//!     Err(Error::LimitExceeded { limit, requested, allowed }) => {
//!         assert_eq!((limit, requested, allowed), (Limit::Width, 32, 16));
//!     }
//!     other => panic!("{other:?}"),
//! }
//! # Ok::<(), ssplat::Error>(())
//! ```
//!
//! Damaged and truncated files are refused by default. With [`Damage::Accept`], the intact parts of large files are
//! decoded, and [`MissingParts`] counts the others. Decode untrusted files on the CPU.
//!
//! # The GPU
//!
//! With the feature `gpu`, [`Encoder::backend`] can select a GPU for fitting (Vulkan, Metal, Direct3D 12), and
//! pictures can be rendered into buffers and textures of `wgpu`. Nothing uses a GPU for decoding unless the caller asks
//! for it.
#![cfg_attr(
    feature = "gpu",
    doc = r#"
```no_run
use ssplat::gpu::{Adapters, Device, Renderer};
use ssplat::{Depth, Limits, Reader};

let image = Reader::open("photo.ssplat", &Limits::default())?.read()?;
let device = Device::open(Adapters::Hardware)?;
let mut renderer = Renderer::of(&device, &image)?;
let pixels = renderer.render(&image.view(), Depth::Eight)?;
# Ok::<(), Box<dyn std::error::Error>>(())
```

See [`gpu`] for rendering into the textures of a program.
"#
)]
//!
//! # Features
//!
//! | feature | adds |
//! |---|---|
//! | `rayon` (default) | multithreading; results do not depend on the number of threads |
//! | `encode` (default) | the encoder; without it, the crate reads and renders, and needs no C compiler |
//! | `image` (default) | the hooks of the `image` crate, and encoding of its pictures |
//! | `quality` (default) | `Target::Quality`, the default target: encoding to a perceptual quality (SSIMULACRA2); without it, the default is a ratio of 25 |
//! | `gpu` | fitting and rendering on a GPU through `wgpu` |
//! | `unstable` | internal modules for the tools of the repository; any release may change them |
//!
//! # Stability
//!
//! The file format is final: every later version reads every file that a 1.x version writes. The names on this page
//! follow semantic versioning; those of the feature `unstable` do not. `image` occurs in public types and is re-exported:
//! a release that moves to an incompatible version of `image` is a major release of this crate. Types of `wgpu` occur
//! only in `gpu::wgpu_30`, which a minor release may replace.
//!
//! The repository's `docs/ARCHITECTURE.md` is a map of the modules, and `spec/ssplat.md` defines the format.

#![cfg_attr(not(any(test, feature = "unstable")), warn(missing_docs))]
// Without that feature, what it exports cannot be reached. Tests include files of other crates.
#![cfg_attr(
    all(feature = "unstable", feature = "encode", not(any(test, target_family = "wasm"))),
    warn(unreachable_pub, unnameable_types)
)]
// docs.rs builds with nightly; each item then shows the feature that it needs.
#![cfg_attr(docsrs, feature(doc_cfg))]

// Unit tests share pictures with the integration tests, which refer to this crate by its name.
#[cfg(test)]
extern crate self as ssplat;

mod angle;
#[cfg_attr(not(feature = "encode"), allow(dead_code, reason = "only the encoder uses the rest"))]
mod bitstream;
mod budget;
#[cfg(feature = "encode")]
mod constants;
mod decode;
mod depth;
#[cfg_attr(not(feature = "encode"), allow(dead_code, reason = "only the encoder uses the rest"))]
mod detail;
#[cfg(feature = "encode")]
mod effort;
#[cfg(feature = "encode")]
mod encode;
#[cfg(feature = "encode")]
mod encoder;
mod error;
#[cfg(feature = "encode")]
mod fit;
mod gaussian;
#[cfg(feature = "gpu")]
pub mod gpu;
#[cfg(feature = "image")]
mod image_crate;
#[cfg(feature = "encode")]
mod instant;
mod limits;
#[cfg(feature = "encode")]
mod metrics;
mod options;
#[cfg(feature = "encode")]
mod pack;
#[cfg_attr(not(feature = "encode"), allow(dead_code, reason = "only the encoder uses the rest"))]
mod parallel;
mod parameter;
#[cfg(feature = "encode")]
mod pixel_source;
mod pixels;
#[cfg_attr(not(feature = "encode"), allow(dead_code, reason = "only the encoder uses the rest"))]
mod quantize;
mod raster;
#[cfg(feature = "encode")]
mod rdo;
mod rect;
#[cfg_attr(not(feature = "encode"), allow(dead_code, reason = "only the encoder uses the rest"))]
mod simd;
#[cfg(feature = "quality-hook")]
mod ssimulacra2;
#[cfg(feature = "encode")]
mod strict_math;
mod target;
#[cfg(any(test, feature = "unstable"))]
pub mod unstable;
#[cfg(feature = "encode")]
mod used_range;
#[cfg(feature = "encode")]
mod weighting;

pub use bitstream::MissingParts;
pub use bitstream::cicp::Cicp;
pub use bitstream::splats::{Layout, Metadata};
pub use decode::{Decoded, Decoder, Reader, SsplatImage};
#[cfg(feature = "encode")]
pub use encode::{EncodeReport, Encoded, Progress, Workers, work_on_tile};
#[cfg(feature = "encode")]
pub use encoder::Encoder;
pub use error::{Error, FormatError, GpuError, Result};
pub use gaussian::{Blend, Channels, Gaussian, Gaussians};
#[cfg(feature = "image")]
pub use image;
#[cfg(all(feature = "encode", feature = "image"))]
pub use image_crate::SsplatEncoder;
#[cfg(feature = "image")]
pub use image_crate::{EXTENSION, SsplatDecoder, register};
pub use limits::Limits;
#[cfg(feature = "encode")]
pub use options::{Backend, Detail, HiddenColors, MetadataPolicy, Thumbnail, Tune};
pub use options::{Damage, Layers};
pub use parameter::{Limit, Parameter};
#[cfg(feature = "encode")]
pub use pixel_source::PixelSource;
pub use pixels::{Depth, Pixels, Samples};
pub use raster::{Renderer, SamplesMut, View};
pub use rect::Rect;
pub use target::Target;

#[cfg(feature = "encode")]
/// Types of the encode report.
pub mod report {
    pub use crate::encode::{Chosen, SkipReason, Skipped, StageTime};
}
