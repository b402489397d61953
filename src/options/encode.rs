//! Options of the encoder.

use std::time::Duration;

use crate::bitstream::cicp::Cicp;
use crate::bitstream::splats::{Layout, Metadata, Steps};
use crate::fit::engine::Inspector;
use crate::fit::method::FitMethod;
use crate::gaussian::Blend;
use crate::options::fit::{HiddenColors, Rung, Tune};
use crate::target::Target;

/// The method of the fit.
#[derive(Debug, Clone, Copy, Default)]
#[cfg_attr(not(feature = "unstable"), allow(dead_code, reason = "tools bring other methods"))]
pub enum Recipe {
    /// The method of this crate, as described in the README.
    #[default]
    Ssplat,
    /// The method of this crate, starting with the Gaussians of another method.
    StartOf(&'static dyn FitMethod),
    /// Another method.
    Other(&'static dyn FitMethod),
}

/// Methods are equal if they are the same value in memory.
impl PartialEq for Recipe {
    fn eq(&self, other: &Self) -> bool {
        match (*self, *other) {
            (Recipe::Ssplat, Recipe::Ssplat) => true,
            (Recipe::StartOf(a), Recipe::StartOf(b)) | (Recipe::Other(a), Recipe::Other(b)) => std::ptr::addr_eq(a, b),
            _ => false,
        }
    }
}

impl Recipe {
    /// Returns whether the steps are those of this crate.
    pub(crate) fn is_own(self) -> bool {
        !matches!(self, Recipe::Other(_))
    }
}

/// Device that fits the picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
#[non_exhaustive]
pub enum Backend {
    /// The GPU if there is a hardware adapter and the picture is large enough to gain from it, otherwise the CPU.
    #[default]
    Auto,
    /// The CPU.
    Cpu,
    /// The GPU; [`Error::Gpu`](crate::Error::Gpu) if there is none.
    Gpu,
}

/// Parts of a picture that the encoder fits.
#[cfg_attr(not(feature = "unstable"), allow(dead_code, reason = "tools set them"))]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
#[non_exhaustive]
pub enum Needs {
    /// Skip constant channels (opaque alpha, grey stored as RGB). The decoded picture still has the channels of the
    /// input. Also stop the fit and drop Gaussians where the error is already below that of rounding or of the target.
    #[default]
    Measured,
    /// All parts.
    Everything,
}

/// Small version of the picture inside its file, which is drawn in a hundredth of the time (spec §3).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
#[non_exhaustive]
pub enum Thumbnail {
    /// A thumbnail of a hundredth of the file, at most 4000 bytes, in files of at least 100 000 bytes whose picture is
    /// larger than the thumbnail.
    #[default]
    Auto,
    /// No thumbnail.
    Never,
    /// A thumbnail of at most this many bytes, in any file.
    Bytes(u32),
}

/// Detail layer of a file: a coded transform of the difference that the Gaussians leave (spec §11).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[non_exhaustive]
pub enum Detail {
    /// A detail layer where it improves the picture; the encoder finds the best division of the bytes.
    #[default]
    Auto,
    /// No detail layer: Gaussians alone.
    Off,
    /// Share of the bytes for the Gaussians, above 0 and below 1; the layer gets the rest.
    GaussianShare(f64),
}

/// Metadata of the source that a file carries. They count as bytes of the file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
#[non_exhaustive]
pub enum MetadataPolicy {
    /// Everything needed to show the picture as intended: the ICC profile, or code points for colours that no profile
    /// can express, such as PQ and HLG, and the orientation as an EXIF block of 26 bytes if the picture has to be rotated or mirrored. The rest of the EXIF block is omitted, and so is a profile
    /// that is equivalent to sRGB (all 8-bit code values mean the same colours, within 1), because pictures without a
    /// profile are shown as sRGB.
    #[default]
    Needed,
    /// The ICC profile or code points and the whole EXIF block, with everything that a camera writes, such as place, time and model.
    All,
    /// The ICC profile or code points only. A picture that has to be rotated or mirrored is shown without that.
    Icc,
    /// No metadata.
    None,
}

/// Precision of the integers of Gaussians that were fitted elsewhere.
#[cfg_attr(not(feature = "unstable"), allow(dead_code, reason = "tools set them"))]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Precision {
    /// `0..=`[`FINEST`](crate::pack::FINEST), from coarse to fine. The encoder itself uses 2 to 5 and one precision
    /// between 3 and 4. Levels above 6 enlarge the file and change little else.
    Level(u8),
    /// The given steps.
    Steps(Steps),
}

/// Treatment of Gaussians whose mean lies outside the picture, where the format has no positions.
#[cfg_attr(not(feature = "unstable"), allow(dead_code, reason = "tools set them"))]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
#[non_exhaustive]
pub enum Outside {
    /// Return [`Error::Parameter`](crate::Error::Parameter).
    #[default]
    Refuse,
    /// Leave out Gaussians whose support does not reach the picture, and move the means of the others to the nearest
    /// position inside.
    Crop,
}

/// Options of [`Encoder`](crate::Encoder).
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct EncodeOptions {
    /// Target of the encode; the default is [`Target::Auto`], a quality of 70.
    pub target: Target,
    /// `1..=9`: how much work to spend; 5 is the default.
    pub effort: u8,
    /// Time limit of the whole encode, wall clock, however many fits the target takes. If it is too short for the
    /// effort, a lower effort is used. The best state reached is written.
    pub time: Option<Duration>,
    /// Seed of all random numbers. Equal seeds give equal bytes with one version of this crate, and in the planes
    /// layout with one version of zstd.
    pub seed: u64,
    /// How the integers become bytes.
    pub layout: Layout,
    /// How Gaussians blend; `None`: the default of the recipe.
    pub blend: Option<Blend>,
    /// The fitting recipe.
    pub recipe: Recipe,
    /// Quality measure to optimize; `None`: [`Tune::Iq`], except [`Tune::Psnr`] if the target is a PSNR and for recipes
    /// of other methods, which weight all errors equally.
    pub tune: Option<Tune>,
    /// Device that fits the picture.
    pub backend: Backend,
    /// Whether parts that the picture does not need are skipped.
    pub needs: Needs,
    /// Whether the file has a detail layer. Files with a requested size, ratio or quality have one in the coded layout.
    /// Files with a requested number of Gaussians have none.
    pub detail: Detail,
    /// `1..=8`: progressive levels, large Gaussians first, so that a file cut after a level is a whole, coarser
    /// picture. Each costs 1 to 2 % of the bytes. Only the coded layout has more than one.
    pub levels: u8,
    /// Whether the file carries a thumbnail; its bytes count as the file's.
    pub thumbnail: Thumbnail,
    /// Side of the tiles in which the picture is fitted, pixels: a multiple of 128 up to 16384. `None`: pictures of
    /// more than 2²⁵ pixels are fitted in tiles of 2048 unless the recipe excludes tiles or a GPU is used, pictures of
    /// more than 2²⁸ pixels always, and all others as a whole. A picture no larger than a tile is fitted as a whole.
    ///
    /// Tiles bound the memory of a fit. Other methods exclude tiles, because their papers define them on whole
    /// pictures. With tiles, a quality is the mean of the tiles' scores.
    pub tiles: Option<u32>,
    /// Treatment of colours under alpha 0.
    pub hidden: HiddenColors,
    /// What looks at the states of a picture that is fitted as a whole. Reported times exclude it, but a time limit is not
    /// extended for it.
    pub inspector: Option<Inspector>,
    /// Last step of an ablation that is included.
    pub rung: Rung,
    /// Precision of given Gaussians; `None`: level 6, or the finest that the target allows.
    pub precision: Option<Precision>,
    /// Treatment of given Gaussians outside the picture.
    pub outside: Outside,
    /// Metadata of the source that `transcode` and `encode_decoder` copy into the file. Plain pixels have none.
    pub metadata: MetadataPolicy,
    /// Code points of the colours to store, regardless of `metadata`.
    pub cicp: Option<Cicp>,
    /// ICC profile to store, regardless of `metadata`.
    pub icc: Option<Vec<u8>>,
    /// EXIF block to store, from its TIFF header on, regardless of `metadata`.
    pub exif: Option<Vec<u8>>,
    /// Bytes of another file that reaches the quality or the PSNR. A search is worth its time only if it may find a file
    /// that is smaller, and returns the best file found if there is none.
    pub(crate) alternative: Option<u64>,
}

impl EncodeOptions {
    /// Returns the metadata to store in a file, without a thumbnail.
    pub(crate) fn stored(&self) -> Metadata {
        let (cicp, icc, exif) = (self.cicp, self.icc.clone(), self.exif.clone());
        Metadata { cicp, icc, exif, ..Metadata::default() }
    }

    /// Returns the lengths of the metadata to store, bytes.
    pub(crate) fn stored_lengths(&self) -> impl Iterator<Item = u64> {
        let blocks = [&self.icc, &self.exif].into_iter().flatten().map(|block| block.len() as u64);
        self.cicp.iter().map(|cicp| cicp.to_bytes().len() as u64).chain(blocks)
    }

    /// Returns the quality measure that the fit optimizes with these options.
    #[must_use]
    pub fn favoured(&self) -> Tune {
        let is_alike = matches!(self.target, Target::Psnr(_)) || !self.recipe.is_own();
        self.tune.unwrap_or(if is_alike { Tune::Psnr } else { Tune::Iq })
    }
}

impl Default for EncodeOptions {
    fn default() -> Self {
        EncodeOptions {
            target: Target::Auto,
            effort: 5,
            time: None,
            seed: 0,
            layout: Layout::Coded,
            blend: None,
            recipe: Recipe::Ssplat,
            tune: None,
            backend: Backend::Auto,
            needs: Needs::Measured,
            detail: Detail::default(),
            levels: 1,
            thumbnail: Thumbnail::Auto,
            tiles: None,
            hidden: HiddenColors::default(),
            inspector: None,
            rung: Rung::default(),
            precision: None,
            outside: Outside::default(),
            metadata: MetadataPolicy::Needed,
            cicp: None,
            icc: None,
            exif: None,
            alternative: None,
        }
    }
}
