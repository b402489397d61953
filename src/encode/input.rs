//! The input of an encode: the caller's picture, the channels of it that are fitted, and the resulting file.

use super::channels::widen;
use crate::bitstream::splats::{Layout, Metadata, PackedSplats, Steps};
use crate::error::{Error, Result};
use crate::fit::model::problem::Scene;
use crate::gaussian::{Blend, Channels};
use crate::options::{EncodeOptions, Needs};
use crate::pixels::{Depth, Pixels};

/// A picture and the caller's options.
#[derive(Debug, Clone, Copy)]
pub(super) struct EncodeInput<'a> {
    /// The caller's picture.
    pub original: &'a Pixels,
    /// The picture that is fitted: the caller's picture, possibly without constant channels.
    pub pixels: &'a Pixels,
    pub options: &'a EncodeOptions,
    /// Factor on the iterations of the fits.
    pub iterations: f32,
}

impl EncodeInput<'_> {
    /// Returns how primitives blend.
    pub(super) fn blend(&self) -> Blend {
        self.options.blend.unwrap_or(if self.options.recipe.is_own() { Blend::Normalized } else { Blend::Sum })
    }

    /// Returns the channels of the file.
    pub(super) fn channels(&self) -> Channels {
        self.original.channels()
    }

    /// Returns the scene of a fit to a picture with the mean colour `mean`.
    pub(super) fn scene(&self, mean: [f32; 4]) -> Scene {
        Scene {
            width: self.pixels.width(),
            height: self.pixels.height(),
            blend: self.blend(),
            background: if self.options.recipe.is_own() { mean } else { [0.0; 4] },
        }
    }

    /// Returns the integers of the fitted picture, without primitives.
    pub(super) fn empty(&self) -> PackedSplats {
        let size = [self.pixels.width(), self.pixels.height()];
        empty(size, (self.pixels.channels(), self.pixels.depth()), self.blend(), self.options)
    }
}

/// Writes the file of a fitted picture. Restores the channels of `channels` that were left out of the fit.
pub(super) fn widened_file(splats: &PackedSplats, channels: Channels) -> Result<Vec<u8>> {
    match channels == splats.channels {
        true => crate::bitstream::to_bytes(splats),
        false => crate::bitstream::to_bytes(&widen(splats, channels)),
    }
}

/// Returns the integers of a picture of `size` pixels, without primitives and metadata. The metadata are added to the
/// finished picture, so that they cannot affect it.
pub(super) fn empty(
    [width, height]: [u32; 2],
    (channels, depth): (Channels, Depth),
    blend: Blend,
    options: &EncodeOptions,
) -> PackedSplats {
    PackedSplats {
        width,
        height,
        channels,
        depth,
        blend,
        layout: options.layout,
        steps: Steps { scale: 2, angle: 1, position: 5, coarsest: 0, range: 0, luma: 6, chroma: 1 },
        background: [0; 4],
        codebook: None,
        gaussians: Vec::new(),
        levels: Vec::new(),
        detail: None,
        exact: None,
        metadata: Metadata::default(),
    }
}

/// Returns the error for a file of `allowed` bytes that needs `needed` bytes even without primitives.
pub(super) fn too_small_with(options: &EncodeOptions, allowed: u64, needed: u64) -> Error {
    let length = |metadata: Option<&Vec<u8>>| metadata.map_or(0, |m| m.len() as u64);
    let (icc, exif) = (length(options.icc.as_ref()), length(options.exif.as_ref()));
    Error::TooSmall { asked: options.target, allowed, needed, icc, exif }
}

/// Returns whether these options allow the encoder to leave out constant channels, the whole fit, or primitives. Only
/// the coded layout stores a constant channel in almost no bytes.
pub(super) fn may_leave_out(options: &EncodeOptions) -> bool {
    options.needs == Needs::Measured && options.layout == Layout::Coded
}

/// Returns the scene of a stored picture.
pub(super) fn stored_scene(splats: &PackedSplats) -> Scene {
    Scene {
        width: splats.width,
        height: splats.height,
        blend: splats.blend,
        background: splats.quantizer().dequantize_color(splats.background),
    }
}
