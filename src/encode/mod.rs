//! Encodes pixels to bytes: the whole encoder behind one function.
//!
//! `check` checks the options, and `exact` decides whether the file has an exact layer. `steps` has the steps of an
//! encode with Gaussians and a detail layer.

mod allocation;
mod channels;
mod check;
mod clock;
mod constant;
mod detail;
mod device;
mod exact;
mod file;
mod fit_whole;
mod gaussians;
mod hidden;
mod input;
mod machine_speed;
mod prepared;
mod primitive_count;
mod prune;
mod quantize_whole;
mod rate_control;
pub(crate) mod render;
mod report;
#[cfg(feature = "quality-hook")]
mod score_curve;
mod skipped;
mod state;
mod steps;
mod stored_error;
mod texture;
mod thumbnail;
mod tiles;
mod timed_effort;
#[cfg(feature = "quality-hook")]
mod trim;
mod whole;
mod workers;
mod write;

use std::borrow::Cow;
use std::ops::ControlFlow;

use crate::error::{Error, Result};
use crate::options::EncodeOptions;
use crate::parameter::Parameter;
use crate::pixel_source::PixelSource;
#[cfg(any(test, feature = "image", feature = "unstable"))]
use crate::pixels::Pixels;
#[cfg(feature = "quality-hook")]
use crate::ssimulacra2;
#[cfg(feature = "quality-hook")]
use crate::target::DEFAULT_QUALITY;
use crate::target::Target;
pub(crate) use check::check;
pub use device::Chosen;
#[cfg(any(test, feature = "unstable"))]
pub use file::divide;
pub(crate) use file::smallest;
pub use report::{EncodeReport, Encoded, Progress, StageTime};
pub use skipped::{SkipReason, Skipped};
#[cfg(feature = "unstable")]
pub use steps::MAX_WHOLE_PIXELS;
#[cfg(any(test, feature = "unstable"))]
pub use texture::Texture;
pub use tiles::work_on_tile;
pub(crate) use workers::Executor;
pub use workers::Workers;

/// Encodes `pixels`.
///
/// # Errors
/// [`Error::Parameter`] if an option is out of range, and [`Error::TooSmall`] if a file of the requested size cannot
/// hold the picture.
#[cfg(any(test, feature = "image", feature = "unstable"))]
pub fn encode(pixels: &Pixels, options: &EncodeOptions) -> Result<Encoded> {
    encode_with_progress(pixels, options, &mut |_| ControlFlow::Continue(()))
}

/// Encodes `pixels` and calls `progress` a few hundred times during the encode.
///
/// # Errors
/// As [`encode`], and [`Error::Cancelled`] if `progress` returns [`ControlFlow::Break`].
#[cfg(any(test, feature = "image", feature = "unstable"))]
pub fn encode_with_progress(
    pixels: &Pixels,
    options: &EncodeOptions,
    progress: &mut dyn FnMut(&Progress) -> ControlFlow<()>,
) -> Result<Encoded> {
    encode_by(pixels, options, Executor::Own, progress)
}

/// Encodes the picture of `source` with tiles that `executor` processes. Calls `progress` during the encode.
///
/// # Errors
/// As [`Encoder::encode`](crate::Encoder::encode).
pub(crate) fn encode_by(
    source: &dyn PixelSource,
    options: &EncodeOptions,
    executor: Executor<'_>,
    progress: &mut dyn FnMut(&Progress) -> ControlFlow<()>,
) -> Result<Encoded> {
    check(options)?;
    let options = &*with_default(options);
    if options.precision.is_some() {
        return Err(Error::Parameter {
            parameter: Parameter::Precision,
            problem: "it applies to given Gaussians only".into(),
        });
    }
    if options.target == Target::Lossless {
        return exact::lossless(source, options, progress);
    }
    if exact::is_worth_trying(source, options)? {
        return exact::encode(source, options, executor, progress);
    }
    exact::encode_photograph(source, options, executor, progress)
}

/// Replaces [`Target::Auto`] with the default quality if this program can measure it. Other methods keep their ratio.
fn with_default(options: &EncodeOptions) -> Cow<'_, EncodeOptions> {
    #[cfg(feature = "quality-hook")]
    if options.target == Target::Auto && options.recipe.is_own() && ssimulacra2::is_provided() {
        return Cow::Owned(EncodeOptions { target: Target::Quality(DEFAULT_QUALITY), ..options.clone() });
    }
    Cow::Borrowed(options)
}
