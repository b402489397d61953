//! Encodes pixels to bytes: the whole encoder behind one function.
//!
//! `rate_control` chooses the initial number of primitives and the number of tries, `job` runs a fit and rounds its
//! result, and `file` writes the smallest file for the integers.

mod channels;
mod clock;
mod constant;
mod device;
pub(crate) mod drawn;
mod encoder;
mod exact;
mod file;
mod hidden;
mod input;
mod job;
mod layer;
mod machine_speed;
mod pipeline;
mod prune;
mod rate_control;
mod report;
mod session;
mod skipped;
mod thumbnail;
mod tiles;
mod timed_effort;
mod trace;
#[cfg(feature = "quality-hook")]
mod trim;
mod whole;
mod workers;

use std::borrow::Cow;
use std::ops::ControlFlow;

use crate::bitstream::splats::Layout;
use crate::error::{Error, Result};
use crate::limits::Limits;
#[cfg(feature = "quality-hook")]
use crate::options::Recipe;
use crate::options::{Detail, EncodeOptions};
use crate::parallel;
use crate::parameter::{Limit, Parameter};
use crate::pixel_source::PixelSource;
use crate::pixels::Pixels;
use crate::rect::Rect;
#[cfg(feature = "quality-hook")]
use crate::ssimulacra2;
#[cfg(feature = "quality-hook")]
use crate::target::DEFAULT_QUALITY;
use crate::target::Target;
pub use device::Chosen;
pub use encoder::Encoder;
#[cfg(any(test, feature = "unstable"))]
pub use file::divide;
pub(crate) use file::smallest;
pub use layer::texture::Texture;
use rate_control::MAX_PRIMITIVES;
use report::ReportBuilder;
pub use report::{Progress, StageTime};
pub use skipped::{SkipReason, Skipped};
pub use tiles::work_on_tile;
pub use trace::TracePoint;
use trace::Tracer;
use workers::Executor;
pub use workers::Workers;

/// An encoded picture.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Encoded {
    /// The file.
    pub bytes: Vec<u8>,
    /// Report of the encode.
    pub report: EncodeReport,
}

/// Report of an encode: its result, its cost, and what was skipped.
#[derive(Debug, Clone, Default)]
#[non_exhaustive]
pub struct EncodeReport {
    /// Number of primitives in the file.
    pub primitives: usize,
    /// Effort of the encode, 1 to 9: the requested one, or a lower one if the time limit is too short for it. It is 0
    /// if the Gaussians were given.
    pub effort: u8,
    /// PSNR of the stored picture against the source in dB, before rounding to code values. It is infinite if they are
    /// equal. Errors of colours are weighted by the alpha of the source, even if hidden colours are kept.
    pub psnr: f64,
    /// PSNR of the picture before quantization, in dB.
    pub float_psnr: f64,
    /// SSIMULACRA2 score of the decoded file against the source; `None` unless the target was `Target::Quality`. Pictures
    /// with a side below 64 pixels are mirrored before they are measured, and samples of 16 bits that use less than an
    /// eighth of their range are stretched, as described at `Target::Quality`.
    pub quality: Option<f64>,
    /// Wall-clock seconds of the encode, excluding tracing.
    pub seconds: f64,
    /// Seconds of each stage, in order.
    pub stages: Vec<StageTime>,
    /// Everything that the encode skipped, with the reasons.
    pub skipped: Vec<Skipped>,
    /// Device that fitted the picture, and the reason for the choice.
    pub chosen: Chosen,
    /// Quality during the encode, if it is traced.
    #[cfg(feature = "unstable")]
    pub trace: Vec<TracePoint>,
    #[cfg(not(feature = "unstable"))]
    #[allow(dead_code, reason = "only tools trace encodes")]
    pub(crate) trace: Vec<TracePoint>,
}

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

fn encode_by(
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
    if options.target == Target::Auto && options.recipe == Recipe::Ssplat && ssimulacra2::is_provided() {
        return Cow::Owned(EncodeOptions { target: Target::Quality(DEFAULT_QUALITY), ..options.clone() });
    }
    Cow::Borrowed(options)
}

/// Encodes the picture of `source` with Gaussians and a detail layer. The options are valid.
fn encode_lossy(
    source: &dyn PixelSource,
    options: &EncodeOptions,
    executor: Executor<'_>,
    progress: &mut dyn FnMut(&Progress) -> ControlFlow<()>,
) -> Result<Encoded> {
    let side = side(source, options);
    let texture = || if side.is_none() { source.as_pixels().and_then(Texture::of_pixels) } else { None };
    let effort = timed_effort::affordable(source.size(), source.channels(), options, texture, machine_speed::slowness);
    let lower = (effort < options.effort).then(|| EncodeOptions { effort, ..options.clone() });
    let options = lower.as_ref().unwrap_or(options);
    match (side, source.as_pixels()) {
        (Some(side), _) => {
            tiles::encode(source, options, side, executor, ReportBuilder::new(progress, Tracer::new(options.trace)))
        }
        (None, Some(pixels)) => encode_whole(pixels, options, progress),
        (None, None) => {
            encode_whole(&source.part(Rect::new(0, 0, source.width(), source.height()))?, options, progress)
        }
    }
}

fn encode_whole(
    pixels: &Pixels,
    options: &EncodeOptions,
    progress: &mut dyn FnMut(&Progress) -> ControlFlow<()>,
) -> Result<Encoded> {
    let work =
        |ask: &mut dyn FnMut(Progress) -> ControlFlow<()>| whole::encode(pixels, options, 1.0, &mut |now| ask(*now));
    parallel::on_pool(work, &mut |now| progress(&now))
}

/// Maximum number of pixels that are fitted as a whole by default. Larger pictures are fitted in tiles even if
/// [`EncodeOptions::tiles`] is not set.
pub const MAX_WHOLE_PIXELS: u64 = 1 << 28;
/// Maximum number of pixels that are fitted as a whole by default if tiles are possible. Tiles give the same quality in
/// a fraction of the memory. A fit of a whole picture takes 40 to 50 bytes per pixel.
const MAX_UNTILED_PIXELS: u64 = 1 << 25;
/// Side of the tiles of these pictures, pixels.
const DEFAULT_TILE_SIDE: u32 = 2048;

/// Returns the side of the tiles in which a picture is fitted, or `None` if it is fitted as a whole.
fn side(source: &dyn PixelSource, options: &EncodeOptions) -> Option<u32> {
    let [width, height] = source.size();
    let area = u64::from(width) * u64::from(height);
    // The search for a GPU takes time, so it is the last condition.
    let by_default = || {
        area > MAX_WHOLE_PIXELS
            || area > MAX_UNTILED_PIXELS && tiles::check(options).is_ok() && !device::takes_gpu(options)
    };
    options.tiles.or_else(|| by_default().then_some(DEFAULT_TILE_SIDE)).filter(|&side| width > side || height > side)
}

/// Checks that every option is within its range, and that decoders with default limits read the metadata.
pub(crate) fn check(options: &EncodeOptions) -> Result<()> {
    let bad = |parameter, problem| Err(Error::Parameter { parameter, problem });
    Limits::check(Limit::Metadata, options.stored_lengths().sum(), Limits::default().metadata)?;
    if !(1..=9).contains(&options.effort) {
        return bad(Parameter::Effort, format!("{} is outside 1..=9", options.effort));
    }
    if !(1..=8).contains(&options.levels) {
        return bad(Parameter::Levels, format!("{} is outside 1..=8", options.levels));
    }
    if options.levels > 1 && options.layout != Layout::Coded {
        return bad(Parameter::Levels, "levels above 1 need the coded layout".into());
    }
    if let Some(side) =
        options.tiles.filter(|s| !tiles::TILE_SIDES.contains(s) || !s.is_multiple_of(*tiles::TILE_SIDES.start()))
    {
        let (least, most) = tiles::TILE_SIDES.into_inner();
        return bad(Parameter::Tiles, format!("{side} is not a multiple of {least} within {least}..={most}"));
    }
    match options.detail {
        Detail::Share(share) if !(share > 0.0 && share < 1.0) => {
            return bad(Parameter::Detail, format!("a share of {share} is not between 0 and 1"));
        }
        Detail::Share(_) if options.layout != Layout::Coded => {
            return bad(Parameter::Detail, "only the coded layout has a detail layer".into());
        }
        Detail::Share(_) if matches!(options.target, Target::Primitives(_)) => {
            return bad(Parameter::Detail, "a file of a number of primitives has no detail layer".into());
        }
        _ => {}
    }
    match options.target {
        Target::Ratio(r) if !(r.is_finite() && r > 0.0) => {
            bad(Parameter::Ratio, format!("{r} is not a positive number"))
        }
        Target::Psnr(p) if !(p.is_finite() && p > 0.0) => bad(Parameter::Psnr, format!("{p} is not a positive number")),
        #[cfg(feature = "quality-hook")]
        Target::Quality(q) if !(0.0..=100.0).contains(&q) => bad(Parameter::Quality, format!("{q} is outside 0..=100")),
        Target::Primitives(n) if u64::from(n) > MAX_PRIMITIVES => {
            bad(Parameter::Primitives, format!("{n} is over {MAX_PRIMITIVES}"))
        }
        _ => Ok(()),
    }
}
