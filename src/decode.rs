//! Bytes to pixels: the whole decoder behind one function.

use crate::bitstream::header::Header;
use crate::bitstream::splats::Metadata;
use crate::bitstream::{self, Missing};
use crate::error::Result;
use crate::options::{Damage, DecodeOptions};
use crate::pixels::Pixels;
use crate::raster::{Renderer, View};

/// A decoded picture.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct Decoded {
    /// The pixels, with the channels and the depth of the source.
    pub pixels: Pixels,
    /// ICC profile and EXIF block.
    pub metadata: Metadata,
    /// What could not be read; nothing unless [`Damage::Accept`] was asked for.
    pub missing: Missing,
}

/// Decodes the file `bytes`, or the part of it that `options` ask for; what cannot be seen in that part
/// is not drawn, and in a file with groups mostly not even read.
///
/// # Errors
/// [`Error::Format`](crate::Error::Format) and [`Error::UnsupportedVersion`](crate::Error::UnsupportedVersion) for
/// what cannot be read, [`Error::LimitExceeded`](crate::Error::LimitExceeded) for what is too large,
/// [`Error::Parameter`](crate::Error::Parameter) for a region outside the picture or an empty one.
pub fn decode(bytes: &[u8], options: &DecodeOptions) -> Result<Decoded> {
    let limits = &options.limits;
    let header = Header::read(&mut &bytes[..], limits)?;
    let mut view = View::of_size(header.width, header.height);
    if let Some([x, y, width, height]) = options.region {
        view = view.crop(x, y, width, height)?;
    }
    if let Some([width, height]) = options.size {
        view = view.resized(width, height)?;
    }
    let (splats, missing) = match options.damage {
        Damage::Accept => bitstream::read_partial(bytes, limits)?,
        Damage::Refuse => (bitstream::read_area(bytes, &view.area().into(), limits)?, Missing::default()),
    };
    let picture = splats.to_picture();
    let pixels = Renderer::new(&picture, &view, limits)?.render(splats.depth)?;
    Ok(Decoded { pixels, metadata: splats.metadata, missing })
}
