//! The steps of an encode with Gaussians and a detail layer, in order:
//!
//! 1. prepare: continue hidden colours, leave out constant channels, choose the device (`whole`, `tiles::picture`),
//! 2. allocate: divide the bytes between Gaussians and detail layer (`allocation`),
//! 3. fit: Gaussians to the picture (`fit_whole`, `tiles::fit`),
//! 4. quantize: round them to the integers of the file (`quantize_whole`, `tiles::quantize`),
//! 5. layers: code the residual (`layer`),
//! 6. write: add thumbnail and metadata, and report the result (`thumbnail`, `write`).
//!
//! Rate control repeats steps 2 to 5 until the file has the requested size, PSNR or quality.

use std::ops::ControlFlow;
use std::time::Duration;

use super::allocation::{Allocation, Division, allocate, keep};
use super::detail::{LARGEST, division_search, layered_in_parts, over_one_color};
use super::gaussians::{fit, quantize};
use super::prepared::Prepared;
use super::report::{Encoded, Progress};
use super::state::Outcome;
use super::texture::Texture;
use super::workers::Executor;
use super::write::write;
use super::{device, machine_speed, rate_control, thumbnail, tiles, timed_effort, whole};
use crate::error::Result;
use crate::options::EncodeOptions;
use crate::parallel;
use crate::pixel_source::PixelSource;
use crate::pixels::Pixels;
use crate::rdo::size::Size;
use crate::rect::Rect;

/// Encodes the picture of `source` with Gaussians and a detail layer. The options are valid.
pub(super) fn encode(
    source: &dyn PixelSource,
    options: &EncodeOptions,
    executor: Executor<'_>,
    progress: &mut dyn FnMut(&Progress) -> ControlFlow<()>,
) -> Result<Encoded> {
    let side = tile_side(source, options);
    let texture = || if side.is_none() { source.as_pixels().and_then(Texture::of_pixels) } else { None };
    let effort = timed_effort::affordable(source.size(), source.channels(), options, texture, machine_speed::slowness);
    let lower = (effort < options.effort).then(|| EncodeOptions { effort, ..options.clone() });
    let options = lower.as_ref().unwrap_or(options);
    let whole = |pixels: &Pixels, progress: &mut dyn FnMut(&Progress) -> ControlFlow<()>| {
        let work =
            |ask: &mut dyn FnMut(Progress) -> ControlFlow<()>| encode_whole(pixels, options, 1.0, &mut |now| ask(*now));
        parallel::on_pool(work, &mut |now| progress(&now))
    };
    match (side, source.as_pixels()) {
        (Some(side), _) => tiles::picture::prepare(source, options, side, executor, progress, |picture| {
            encode_prepared(Prepared::Tiled(picture))
        }),
        (None, Some(pixels)) => whole(pixels, progress),
        (None, None) => whole(&source.part(Rect::new(0, 0, source.width(), source.height()))?, progress),
    }
}

/// Encodes `pixels` as a whole. `iterations` is a factor on the iterations of the fits.
pub(super) fn encode_whole(
    pixels: &Pixels,
    options: &EncodeOptions,
    iterations: f32,
    progress: &mut dyn FnMut(&Progress) -> ControlFlow<()>,
) -> Result<Encoded> {
    let encode = |picture: whole::WholePicture<'_>| encode_prepared(Prepared::Whole(picture));
    whole::prepare(pixels, options, iterations, progress, encode)
}

/// Encodes a picture to the target of the options.
fn encode_prepared(mut prepared: Prepared<'_>) -> Result<Encoded> {
    let (mut outcome, thumbnail) = rate_control::to_target(&mut prepared, encode_at)?;
    thumbnail::add(&mut prepared, &mut outcome, thumbnail, encode_whole)?;
    write(prepared, outcome)
}

/// Encodes to a file of `size`. `time` is the part of the time budget that this file may take; `None` means all of the
/// remaining time.
fn encode_at(prepared: &mut Prepared<'_>, size: Size, time: Option<Duration>) -> Result<Outcome> {
    match allocate(prepared, size, time)? {
        Allocation::Gaussians(request) => {
            let fitted = fit(prepared, &request)?;
            quantize(prepared, fitted, &request)
        }
        Allocation::OneColor(max_bytes) => {
            let base = prepared.flat_base(max_bytes)?;
            over_one_color(prepared, base, max_bytes)
        }
        Allocation::Shared(division) => {
            let kept = division.kept_base(prepared.state());
            let is_new = kept.is_none();
            let base = match kept {
                Some(base) => base,
                None => {
                    let request = division.base_request(prepared.state(), division.base_budget as u64, Vec::new());
                    let fitted = fit(prepared, &request)?;
                    quantize(prepared, fitted, &request)?
                }
            };
            layers(prepared, base, is_new, &division)
        }
    }
}

/// Codes a detail layer over `base`. `is_new` is whether `base` was fitted for this file.
fn layers(prepared: &mut Prepared<'_>, base: Outcome, is_new: bool, division: &Division) -> Result<Outcome> {
    match prepared {
        Prepared::Whole(picture) if picture.state.pixels() <= LARGEST => {
            division_search::layered(picture, base, is_new, division)
        }
        _ => {
            if is_new {
                keep(prepared.state_mut(), &base, division.base_budget);
            }
            layered_in_parts(prepared, base, division.max_bytes())
        }
    }
}

/// Maximum number of pixels that are fitted as a whole by default. Larger pictures are fitted in tiles even if
/// [`EncodeOptions::tiles`] is not set.
pub const MAX_WHOLE_PIXELS: u64 = 1 << 28;
/// Maximum number of pixels that are fitted as a whole by default if tiles are possible. Tiles give the same quality in
/// a fraction of the memory. A fit of a whole picture takes 40 to 50 bytes per pixel.
const MAX_UNTILED_PIXELS: u64 = 1 << 25;

/// Returns the side of the tiles in which a picture is fitted, or `None` if it is fitted as a whole.
fn tile_side(source: &dyn PixelSource, options: &EncodeOptions) -> Option<u32> {
    let [width, height] = source.size();
    let area = u64::from(width) * u64::from(height);
    // The search for a GPU takes time, so it is the last condition.
    let by_default = || {
        area > MAX_WHOLE_PIXELS
            || area > MAX_UNTILED_PIXELS && tiles::picture::check(options).is_ok() && !device::takes_gpu(options)
    };
    let side = options.tiles.or_else(|| by_default().then_some(tiles::DEFAULT_TILE_SIDE));
    side.filter(|&side| width > side || height > side)
}
