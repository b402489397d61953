//! Bytes to pixels: the whole decoder behind one function.

use crate::bitstream::header::Header;
use crate::bitstream::splats::{Metadata, PackedGaussian, PackedSplats};
use crate::bitstream::{self, Missing};
use crate::error::Result;
use crate::gaussian::Gaussian;
use crate::limits::Limits;
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
    // A picture too large to be had is not worth reading.
    let samples = u64::from(view.width()) * u64::from(view.height()) * header.channels.count() as u64;
    limits.check_alloc(samples * header.depth.bytes() as u64)?;
    let (mut splats, missing) = match options.damage {
        Damage::Accept => bitstream::read_partial(bytes, limits)?,
        Damage::Refuse => (bitstream::read_area(bytes, &view.area().into(), limits)?, Missing::default()),
    };
    let (depth, metadata) = (splats.depth, std::mem::take(&mut splats.metadata));
    let held = metadata.icc.iter().chain(&metadata.exif).map(|m| m.len() as u64).sum();
    let mut limits = limits.clone();
    limits.alloc = limits.check_alloc(held)?;
    let pixels = renderer(splats, &view, &limits)?.render(depth)?;
    Ok(Decoded { pixels, metadata, missing })
}

/// What draws `view`, in the memory that the integers leave.
pub(crate) fn renderer(splats: PackedSplats, view: &View, limits: &Limits) -> Result<Renderer> {
    let held = (size_of::<PackedGaussian>() + size_of::<Gaussian>()) as u64 * splats.gaussians.len() as u64;
    let mut limits = limits.clone();
    limits.alloc = limits.check_alloc(held)?;
    let picture = splats.to_picture();
    drop(splats);
    Renderer::new(&picture, view, &limits)
}
