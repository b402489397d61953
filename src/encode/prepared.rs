//! A picture that is ready to be encoded, as a whole or in tiles, and its measurements.

use super::state::{EncodeState, Outcome};
use super::texture::Texture;
use super::tiles::picture::TiledPicture;
use super::whole::WholePicture;
use crate::bitstream::splats::PackedSplats;
use crate::error::Result;
use crate::pixel_source::PixelSource;

/// A picture that is ready to be encoded.
pub(super) enum Prepared<'a> {
    Whole(WholePicture<'a>),
    Tiled(TiledPicture<'a>),
}

impl<'a> Prepared<'a> {
    pub(super) fn state(&self) -> &EncodeState<'a> {
        match self {
            Prepared::Whole(picture) => &picture.state,
            Prepared::Tiled(picture) => &picture.state,
        }
    }

    pub(super) fn state_mut(&mut self) -> &mut EncodeState<'a> {
        match self {
            Prepared::Whole(picture) => &mut picture.state,
            Prepared::Tiled(picture) => &mut picture.state,
        }
    }

    /// Returns the picture with the channels that are fitted.
    pub(super) fn fitted_source(&self) -> &'a dyn PixelSource {
        match self {
            Prepared::Whole(picture) => picture.input.pixels,
            Prepared::Tiled(picture) => picture.fitted_source,
        }
    }

    /// Returns the texture of a picture that is fitted as a whole.
    pub(super) fn measured_texture(&self) -> Option<Texture> {
        match self {
            Prepared::Whole(picture) => picture.measured_texture(),
            Prepared::Tiled(_) => None,
        }
    }

    /// Returns whether the range of the samples is so narrow that the picture is one colour with a detail layer.
    pub(super) fn has_narrow_range(&self) -> bool {
        match self {
            Prepared::Whole(picture) => picture.range.is_some(),
            Prepared::Tiled(picture) => picture.flat_color.is_some(),
        }
    }

    /// Returns the integers of the picture if it has only one colour.
    pub(super) fn constant(&mut self) -> Result<Option<PackedSplats>> {
        match self {
            Prepared::Whole(picture) => Ok(picture.constant()),
            Prepared::Tiled(picture) => picture.constant(),
        }
    }

    /// Returns Gaussians of one colour as the base of a detail layer, if their file takes at most `max_bytes`.
    pub(super) fn flat_base(&mut self, max_bytes: u64) -> Result<Outcome> {
        let splats = match self {
            Prepared::Whole(picture) => picture.flat(),
            Prepared::Tiled(picture) => picture.flat(),
        };
        let bytes = self.state().file(&splats)?;
        let needed = bytes.len() as u64;
        if needed > max_bytes {
            return Err(self.state().too_small(max_bytes, needed));
        }
        let float_error = self.fitted_error(&splats)?;
        Ok(Outcome { bytes, splats, float_error, quality: None, pruned_bytes: 0 })
    }

    /// Returns the squared error of the stored picture over the fitted samples, weighted as
    /// [`metrics::psnr`](crate::metrics::psnr) does: before it is rounded to code values, or after it in tiles.
    pub(super) fn fitted_error(&mut self, splats: &PackedSplats) -> Result<f64> {
        match self {
            Prepared::Whole(picture) => Ok(picture.shown_error(splats)),
            Prepared::Tiled(picture) => picture.decoded_error(picture.fitted_source, splats),
        }
    }

    /// Returns the squared error of the decoded picture over the samples of all channels, weighted as
    /// [`metrics::psnr`](crate::metrics::psnr) does.
    pub(super) fn error(&mut self, splats: &PackedSplats) -> Result<f64> {
        match self {
            Prepared::Whole(picture) => picture.decoded_error(picture.input.original, splats),
            Prepared::Tiled(picture) => picture.decoded_error(picture.source, splats),
        }
    }

    /// Returns the squared error of the decoded picture over the samples of all channels, which is `all`, relative to
    /// that over the fitted samples; 1 if there is none.
    pub(super) fn error_factor(&mut self, splats: &PackedSplats, all: f64) -> Result<f64> {
        if self.state().fits_all_channels() {
            return Ok(1.0);
        }
        let fitted = match self {
            Prepared::Whole(picture) => picture.decoded_error(picture.input.pixels, splats)?,
            Prepared::Tiled(picture) => picture.decoded_error(picture.fitted_source, splats)?,
        };
        let factor = all / fitted;
        Ok(if factor.is_finite() { factor } else { 1.0 })
    }

    /// Returns the SSIMULACRA2 score of the stored picture, with the channels that were left out restored.
    #[cfg(feature = "quality-hook")]
    pub(super) fn score(&mut self, splats: &PackedSplats) -> Result<f64> {
        match self {
            Prepared::Whole(picture) => picture.score(splats),
            Prepared::Tiled(picture) => picture.score(splats),
        }
    }

    /// Shows the stored picture to the inspector. Pictures in tiles are not inspected.
    pub(super) fn inspect_written(&mut self, splats: &PackedSplats) -> Result<()> {
        match self {
            Prepared::Whole(picture) => picture.inspect_written(splats),
            Prepared::Tiled(_) => Ok(()),
        }
    }
}
