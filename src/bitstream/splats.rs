//! The integers of a picture, which every layout stores exactly (spec §4).

use std::sync::Arc;

use super::cicp::Cicp;
use super::detail::DetailLayer;
use super::exact::ExactLayer;
use crate::gaussian::{Blend, Channels};
use crate::pixels::Depth;

/// The step sizes of the integers, as the indices that the header stores (spec §4.1).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Steps {
    /// `0..=15`: scales are `2^(i·δ − 2)` with `δ = (scale + 4)/32`.
    pub scale: u8,
    /// `0..=3`: angle steps are coarser by a factor of `τ = 2^((angle − 1)/2)`.
    pub angle: u8,
    /// `0..=15`: position steps are about `2^(−position/4)` of the Gaussian's own extent.
    pub position: u8,
    /// `−6..=9`: the coarsest position step is `2^coarsest` pixels.
    pub coarsest: i8,
    /// `0..=15`: the finest position step is `2^(coarsest − range)` pixels.
    pub range: u8,
    /// `0..=15`: the step of luma, grey and alpha is `2^(luma/3 − 7)`.
    pub luma: u8,
    /// `0..=3`: the chroma step is 1, 1.5, 2 or 3 luma steps.
    pub chroma: u8,
}

/// One Gaussian in integers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
pub struct PackedGaussian {
    /// x of the mean: `(x + ½)·2^ex` pixels, where `ex` follows from the scales and the angle (spec §4.3).
    pub x: u32,
    /// y of the mean: `(y + ½)·2^ey` pixels.
    pub y: u32,
    /// Index of the major scale; never below `minor`.
    pub major: u8,
    /// Index of the minor scale.
    pub minor: u8,
    /// Angle `π·angle/n`, where `n` follows from `major − minor` (spec §4.2).
    pub angle: u16,
    /// Grey: `[Y]`; grey with alpha: `[Y, A]`; colour: `[Y, Co, Cg]`, then `A`; unused values are 0.
    pub color: [i16; 4],
}

/// Layout of the integers in a file (spec §6 to §8).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Layout {
    /// Fixed-size records, 7 bytes each for a colour picture.
    Packed,
    /// The fields of the records as separate streams, compressed with zstd.
    Planes,
    /// Adaptive entropy coding, which gives the smallest files.
    #[default]
    Coded,
}

/// Name of the section with code points of colours.
pub const CICP: [u8; 4] = *b"cicp";
/// Name of the ICC profile's section.
pub const ICC: [u8; 4] = *b"iccp";
/// Name of the EXIF block's section.
pub const EXIF: [u8; 4] = *b"exif";
/// Name of the thumbnail's section.
pub const THUMBNAIL: [u8; 4] = *b"thmb";

/// Metadata of a file. Profile and EXIF block are unparsed, and stored byte for byte.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
#[non_exhaustive]
#[doc(alias("icc", "exif", "orientation", "cicp", "hdr"))]
pub struct Metadata {
    /// Code points of the colours. They take precedence over a profile: a program that knows them ignores the profile.
    pub cicp: Option<Cicp>,
    /// ICC colour profile.
    pub icc: Option<Vec<u8>>,
    /// EXIF block, starting at its TIFF header.
    pub exif: Option<Vec<u8>>,
    /// Thumbnail: a separate ssplat file with a smaller version of the picture (spec §3).
    pub thumbnail: Option<Vec<u8>>,
    /// Names of the sections that were dropped when reading because their checksums did not match; ignored when
    /// writing.
    pub damaged: Vec<[u8; 4]>,
}

impl Metadata {
    /// Returns the sections that are present, in the order of a file.
    pub(crate) fn sections(&self) -> impl Iterator<Item = ([u8; 4], &[u8])> {
        let blocks = [(EXIF, &self.exif), (ICC, &self.icc), (THUMBNAIL, &self.thumbnail)];
        let blocks = blocks.into_iter().filter_map(|(name, contents)| Some((name, contents.as_deref()?)));
        self.cicp.iter().map(|cicp| (CICP, cicp.as_bytes())).chain(blocks)
    }
}

/// A whole picture in integers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PackedSplats {
    /// Width, pixels, `1..=2²⁰`.
    pub width: u32,
    /// Height, pixels, `1..=2²⁰`.
    pub height: u32,
    /// Channels of the colours.
    pub channels: Channels,
    /// Bits per sample of the source.
    pub depth: Depth,
    /// Rule that combines the Gaussians.
    pub blend: Blend,
    /// Layout of the integers in the file.
    pub layout: Layout,
    /// Step sizes.
    pub steps: Steps,
    /// Background colour as integers in the form of [`PackedGaussian::color`].
    pub background: [i16; 4],
    /// The colours that occur, in ascending order, if each Gaussian stores an index instead of its colour; at most
    /// 65536.
    pub codebook: Option<Vec<[i16; 4]>>,
    /// The Gaussians, level by level.
    pub gaussians: Vec<PackedGaussian>,
    /// Number of Gaussians of each progressive level, coarse levels first, at most 8; empty for one level. Only the
    /// coded layout can have several. A file that is truncated after a level still gives a whole, coarser picture.
    pub levels: Vec<u32>,
    /// The detail layer, which is added to the rendered Gaussians. Only the coded layout can have one.
    pub detail: Option<Arc<DetailLayer>>,
    /// The exact layer, which replaces the pixels that it covers. Only the coded layout can have one.
    pub exact: Option<Arc<ExactLayer>>,
    /// Code points, ICC profile, EXIF block and thumbnail.
    pub metadata: Metadata,
}
