//! The thumbnail of a large file: the coded picture, rendered at a small size and encoded as a separate file.

use std::ops::ControlFlow;

use super::prepared::Prepared;
use super::render::drawn;
use super::report::ReportBuilder;
use super::state::Outcome;
use super::{Encoded, Progress};
use crate::bitstream::splats::PackedSplats;
use crate::constants::encode;
use crate::error::{Error, Result};
use crate::options::{Backend, Detail, EncodeOptions, Thumbnail};
use crate::parameter::Parameter;
use crate::pixels::Pixels;
use crate::raster::View;
use crate::rdo::size::Size;
use crate::target::Target;

/// Encodes a picture as a whole. The number is a factor on the iterations of the fit.
pub(super) type EncodeWhole =
    fn(&Pixels, &EncodeOptions, f32, &mut dyn FnMut(&Progress) -> ControlFlow<()>) -> Result<Encoded>;

/// Maximum overhead of a section, bytes: the number of sections, name, length and checksum.
const HEADER_BYTES: u64 = 1 + 4 + 5 + 4;

/// Returns the maximum size in bytes of the thumbnail of a picture of `size` pixels in a file of `bytes`. Returns 0 if
/// the file has no thumbnail.
fn room(options: &EncodeOptions, size: [u32; 2], bytes: u64) -> u64 {
    match options.thumbnail {
        Thumbnail::Never => 0,
        Thumbnail::Bytes(max_bytes) => max_bytes.into(),
        Thumbnail::Auto
            if bytes < encode::MIN_FILE_BYTES_WITH_THUMBNAIL || size[0].max(size[1]) <= encode::MAX_THUMBNAIL_SIDE =>
        {
            0
        }
        Thumbnail::Auto => (bytes / encode::FILE_PER_THUMBNAIL).min(encode::MAX_THUMBNAIL_BYTES),
    }
}

/// Returns the bytes that the thumbnail of a picture of `size` pixels takes in a file of `bytes` bytes.
pub(super) fn reserved(options: &EncodeOptions, size: [u32; 2], bytes: u64) -> u64 {
    let room = room(options, size, bytes);
    if room > 0 { room + HEADER_BYTES } else { 0 }
}

/// Returns the part of `size` that remains for the picture next to a thumbnail of `room` bytes.
fn without_thumbnail(size: Size, room: u64) -> Size {
    match size {
        Size::Bytes(max_bytes) if room > 0 => Size::Bytes(max_bytes.saturating_sub(room + HEADER_BYTES)),
        size => size,
    }
}

/// Adds a thumbnail of `room` bytes to an error about the size of a file. `asked` is the size that was requested.
pub(super) fn counted(error: Error, asked: Size, room: u64) -> Error {
    match (error, asked) {
        (Error::TooSmall { asked, needed, icc, exif, .. }, Size::Bytes(allowed)) if room > 0 => {
            Error::TooSmall { asked, allowed, needed: needed + room + HEADER_BYTES, icc, exif }
        }
        (e, _) => e,
    }
}

/// Returns a thumbnail of at most `max_bytes` bytes: `splats`, rendered at a small size. Passes the fraction of the
/// work that is done to `on_progress`.
fn of(
    splats: &PackedSplats,
    max_bytes: u64,
    options: &EncodeOptions,
    encode: EncodeWhole,
    on_progress: &mut dyn FnMut(f32) -> ControlFlow<()>,
) -> Result<Vec<u8>> {
    let whole = View::new(splats.width, splats.height);
    let small = drawn(splats, &whole.fitted([encode::MAX_THUMBNAIL_SIDE; 2])?, splats.depth)?;
    let options = EncodeOptions {
        target: Target::Bytes(max_bytes),
        effort: options.effort.min(encode::MAX_THUMBNAIL_EFFORT),
        time: options.time.map(|t| t / encode::TIME_PER_THUMBNAIL),
        seed: options.seed,
        tune: options.tune,
        backend: Backend::Cpu,
        hidden: options.hidden,
        thumbnail: Thumbnail::Never,
        // Readers that draw placeholders support Gaussians only.
        detail: Detail::Off,
        ..EncodeOptions::default()
    };
    let made = encode(&small, &options, encode::THUMBNAIL_ITERATIONS, &mut |p| on_progress(p.done));
    let Encoded { bytes, .. } = made.map_err(|e| match e {
        Error::TooSmall { .. } => Error::Parameter { parameter: Parameter::Thumbnail, problem: e.to_string() },
        e => e,
    })?;
    Ok(bytes)
}

/// Returns the part of `size` that remains for the picture, and the size of the thumbnail in bytes. Reserves time for
/// the thumbnail.
pub(super) fn reserve_thumbnail(prepared: &mut Prepared<'_>, size: Size) -> (Size, u64) {
    let Size::Bytes(max_bytes) = size else { return (size, 0) };
    let room = room_in(prepared, max_bytes);
    if room > 0 {
        let time = prepared.state().options.time.unwrap_or_default();
        prepared.state_mut().clock.keep(time / encode::TIME_PER_THUMBNAIL);
    }
    (without_thumbnail(size, room), room)
}

/// Returns the maximum size in bytes of the thumbnail of a file that was made for `size`. Returns 0 if the file has no
/// thumbnail.
pub(super) fn max_bytes(prepared: &Prepared<'_>, outcome: &Outcome, size: Size) -> u64 {
    let bytes = match size {
        Size::Bytes(max_bytes) => max_bytes,
        Size::Free => outcome.bytes.len() as u64,
    };
    room_in(prepared, bytes)
}

/// Adds a thumbnail of at most `max_bytes` bytes to a file, if they are not 0.
pub(super) fn add(
    prepared: &mut Prepared<'_>,
    outcome: &mut Outcome,
    max_bytes: u64,
    encode: EncodeWhole,
) -> Result<()> {
    let state = prepared.state_mut();
    let splats = state.widened(&outcome.splats);
    let thumbnail = of_size(&splats, max_bytes, state.options, encode, &mut state.report)?;
    if thumbnail.is_some() {
        outcome.splats.metadata.thumbnail = thumbnail;
        outcome.bytes = state.file(&outcome.splats)?;
    }
    Ok(())
}

/// Returns a thumbnail for a file of `bytes` bytes, if it should have one.
pub(super) fn for_file(
    splats: &PackedSplats,
    bytes: u64,
    options: &EncodeOptions,
    encode: EncodeWhole,
    report: &mut ReportBuilder<'_>,
) -> Result<Option<Vec<u8>>> {
    of_size(splats, room(options, [splats.width, splats.height], bytes), options, encode, report)
}

fn of_size(
    splats: &PackedSplats,
    max_bytes: u64,
    options: &EncodeOptions,
    encode: EncodeWhole,
    report: &mut ReportBuilder<'_>,
) -> Result<Option<Vec<u8>>> {
    if max_bytes == 0 {
        return Ok(None);
    }
    let since = report.seconds();
    let bytes =
        of(splats, max_bytes, options, encode, &mut |done| (report.progress)(&Progress { stage: "thumbnail", done }))?;
    report.stage("thumbnail", since);
    Ok(Some(bytes))
}

fn room_in(prepared: &Prepared<'_>, bytes: u64) -> u64 {
    let &PackedSplats { width, height, .. } = &prepared.state().blank;
    room(prepared.state().options, [width, height], bytes)
}
