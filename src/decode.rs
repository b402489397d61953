//! Bytes to pixels: the whole decoder behind one function.

use crate::bitstream::header::Header;
use crate::bitstream::splats::{Metadata, PackedGaussian, PackedSplats};
use crate::bitstream::{self, Missing};
use crate::error::Result;
use crate::limits::Limits;
use crate::options::{Damage, DecodeOptions};
use crate::pixels::Pixels;
use crate::raster::{Canvas, Renderer, View};

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

impl PackedSplats {
    /// What draws `view`. The Gaussians are made on the way: they need not all be there at once, as they would be with
    /// [`to_picture`](PackedSplats::to_picture).
    ///
    /// # Errors
    /// As [`Renderer::new`].
    pub fn renderer(&self, view: &View, limits: &Limits) -> Result<Renderer> {
        let quantizer = self.quantizer();
        let background = quantizer.dequantize_color(self.background);
        let canvas = Canvas { channels: self.channels, blend: self.blend, background };
        let gaussian = |i: usize| quantizer.dequantize(&self.gaussians[i]);
        Renderer::of(&canvas, self.gaussians.len(), gaussian, view, limits)
    }
}

/// What draws `view`, in the memory that the integers leave; they are gone afterwards.
pub(crate) fn renderer(splats: PackedSplats, view: &View, limits: &Limits) -> Result<Renderer> {
    let mut limits = limits.clone();
    limits.alloc = limits.check_alloc((size_of::<PackedGaussian>() * splats.gaussians.len()) as u64)?;
    splats.renderer(view, &limits)
}
