//! Writes decoded pictures, with a note about a profile that does not fit.

use std::path::Path;

use ssplat::unstable::bitstream::splats::Metadata;
use ssplat::unstable::colour;
use ssplat::{Channels, PixelSource, Samples, SamplesMut};

use crate::failure::Failure;
use crate::rows::{Format, RowWriter, Shape};
use crate::sink::Sink;
use crate::source::Source;

/// Writes a picture that is in memory. Returns a note if its profile does not fit the format.
pub fn write_pixels(source: Source, format: Format, sink: &Sink, path: &Path) -> Result<Option<String>, Failure> {
    let Source { pixels, cicp, icc, exif, .. } = source;
    format.check(path, pixels.size(), pixels.channels())?;
    let shape =
        Shape { width: pixels.width(), height: pixels.height(), channels: pixels.channels(), depth: pixels.depth() };
    let mut metadata = Metadata::default();
    (metadata.cicp, metadata.icc, metadata.exif) = (cicp, icc, exif);
    let note = misfit(&metadata, format, pixels.channels());
    metadata.icc = metadata.icc.filter(|_| note.is_none());
    let io = |e| Failure::io(path, &e);
    let mut rows = RowWriter::new(sink, format, shape, &metadata).map_err(io)?;
    match &mut pixels.into_samples() {
        Samples::U8(samples) => rows.write(SamplesMut::U8(samples)).map_err(io)?,
        Samples::U16(samples) => rows.write(SamplesMut::U16(samples)).map_err(io)?,
    }
    rows.finish(path)?;
    Ok(note)
}

/// Returns a note about a profile that does not fit the samples of the output.
pub fn misfit(metadata: &Metadata, format: Format, channels: Channels) -> Option<String> {
    if !format.has_profile() {
        return None;
    }
    let why = metadata.icc.as_ref().and_then(|icc| colour::misfit(icc, format.is_grey(channels)))?;
    Some(format!("the ICC profile {why}, and is left out"))
}
