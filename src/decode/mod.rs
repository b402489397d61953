//! Bytes to pixels: [`Decoder`] decodes one picture at a time; [`SsplatImage`] is a file that can be rendered
//! repeatedly.

mod decoder;
mod reader;
mod thumbnail;

pub use decoder::Decoder;
#[cfg(feature = "gpu")]
pub(crate) use reader::check_view;
pub use reader::{Reader, SsplatImage};

use crate::bitstream::MissingParts;
use crate::bitstream::splats::Metadata;
use crate::error::{Error, Result};
use crate::options::DecodeOptions;
use crate::parameter::Parameter;
use crate::pixels::Pixels;
use crate::raster::{SamplesMut, View};

/// A decoded picture.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct Decoded {
    /// The pixels, with the channels and the depth of the source.
    pub pixels: Pixels,
    /// ICC profile and EXIF block.
    pub metadata: Metadata,
    /// Counts of the parts that could not be read. All are 0 unless [`Damage::Accept`](crate::Damage::Accept) was set.
    pub missing: MissingParts,
}

/// Decodes the file `bytes`, or the part of it that `options` select. Parts of the file that are not visible in the
/// region are not rendered, and in a file with groups mostly not even read.
///
/// # Errors
/// [`Error::Format`](crate::Error::Format) and [`Error::UnsupportedVersion`](crate::Error::UnsupportedVersion) for
/// files that cannot be read, [`Error::LimitExceeded`](crate::Error::LimitExceeded) for files that exceed the limits,
/// [`Error::Parameter`](crate::Error::Parameter) for a region that is empty or not within the picture.
pub fn decode(bytes: &[u8], options: &DecodeOptions) -> Result<Decoded> {
    decode_opened(Reader::new(bytes, &options.limits)?, options)
}

/// Decodes an opened file.
fn decode_opened(opening: Reader<'_>, options: &DecodeOptions) -> Result<Decoded> {
    let view = options.view(&opening.view())?;
    let opened = opening.damage(options.damage).read_for(&view)?;
    let (depth, missing) = (opened.splats.depth, opened.missing());
    let renderer = opened.renderer(&view)?;
    // Release the memory of the integers before the pixels are allocated.
    let (metadata, _kept) = opened.into_metadata_and_memory();
    Ok(Decoded { pixels: renderer.render(depth)?, metadata, missing })
}

/// Decodes the file `bytes` into `out`, as [`decode()`] does but with the depth of `out`. Use this function to decode
/// several pictures into the same memory. [`Reader`] returns the size of a picture beforehand.
///
/// # Errors
/// As [`decode()`], and [`Error::Parameter`] naming `out` if `out` does not have exactly as many samples as `options`
/// require.
pub fn decode_into(bytes: &[u8], options: &DecodeOptions, out: SamplesMut<'_>) -> Result<(Metadata, MissingParts)> {
    let opening = Reader::new(bytes, &options.limits)?;
    let view = options.view(&opening.view())?;
    let samples = u64::from(view.width()) * u64::from(view.height()) * opening.header.channels.count() as u64;
    if out.count() as u64 != samples {
        return Err(Error::Parameter {
            parameter: Parameter::Out,
            problem: format!("{} samples where {samples} are needed", out.count()),
        });
    }
    let opened = opening.damage(options.damage).read_for(&view)?;
    opened.render_into(&view, out)?;
    let missing = opened.missing();
    Ok((opened.into_metadata(), missing))
}

impl DecodeOptions {
    /// Returns the view of the requested region and size of the `whole` picture.
    fn view(&self, whole: &View) -> Result<View> {
        let mut view = whole.layers(self.layers);
        if let Some(region) = self.region {
            view = view.crop(region)?;
        }
        match self.size {
            Some([width, height]) => view.resized(width, height),
            None => Ok(view),
        }
    }
}
