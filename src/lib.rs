//! ssplat: pictures stored as 2D Gaussians ("splats") instead of pixels.
//!
//! Bytes become integers exactly ([`bitstream`]), integers become Gaussians by the specification's formulas
//! ([`quantize`]), Gaussians become pixels within a stated error, and the `image` crate stands at the door.

// Tests inside share pictures with the program, which names this crate from outside.
#[cfg(test)]
extern crate self as ssplat;

mod backend;
pub mod bitstream;
mod convert;
pub mod decode;
mod decoder;
pub mod encode;
mod encoder;
pub mod error;
mod fit;
pub mod gaussian;
#[cfg(feature = "gpu")]
pub mod gpu;
mod leave_out;
pub mod limits;
pub mod metrics;
pub mod options;
mod parallel;
pub mod pixels;
pub mod quantize;
pub mod raster;
mod simd;
mod trace;

pub use backend::Chosen;
pub use decode::{Decoded, decode};
pub use decoder::{EXTENSION, SsplatDecoder, register};
pub use encode::{EncodeReport, Encoded, LeftOut, Progress, encode, encode_with_progress};
pub use encoder::{SsplatEncoder, save};
pub use error::{Error, FormatError, GpuError, Result};
pub use gaussian::{Blend, Channels, Gaussian, Picture};
pub use limits::Limits;
pub use options::{Ablation, Backend, Damage, DecodeOptions, EncodeOptions, Needs, Recipe, Target, Trace, Tune};
pub use pixels::{Depth, Pixels, Samples};
pub use trace::TracePoint;
