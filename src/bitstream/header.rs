//! The fixed header of a file: size and kind of the picture, step sizes and layout (spec §2).

use std::io::{ErrorKind, Read};

use super::bytes::{put_varint, varint};
use super::checksum::hash;
use super::splats::{Layout, Metadata, PackedGaussian, PackedSplats, Steps};
use crate::budget::Budget;
use crate::error::{Error, FormatError, Result};
use crate::gaussian::{Blend, Channels};
use crate::limits::Limits;
use crate::parameter::Limit;
use crate::pixels::Depth;

/// The first four bytes of every file. They are not valid text.
pub const MAGIC: [u8; 4] = [0x89, b'S', b'S', b'P'];

/// The format version that this crate reads and writes.
pub const VERSION: u8 = 6;

/// Maximum side of a picture, pixels.
pub const MAX_SIDE: u32 = 1 << 20;

/// The finest position step is `2^MIN_EXPONENT` pixels, so that positions stay below 2³⁰.
pub const MIN_EXPONENT: i32 = -10;

const BLEND_SUM: u8 = 1 << 2;
const DEPTH_SIXTEEN: u8 = 1 << 5;
const CODEBOOK: u8 = 1 << 6;
const SECTIONS: u8 = 1 << 7;

/// Whether each Gaussian stores its colour or a codebook index.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Coloring {
    /// Colours are stored with the Gaussians.
    Direct,
    /// Colours are stored once, in a codebook.
    Codebook,
}

/// Division of the Gaussians into separately coded parts (spec §8.7).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Grouping {
    /// One part that ends with the file.
    Single,
    /// A directory of groups, each with its length and checksum.
    Groups,
}

/// Whether sections follow the header.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Sections {
    /// None.
    Absent,
    /// The number of sections, followed by the sections.
    Present,
}

/// Length of the longest valid header. A few more bytes may be read of an invalid one, because a varint may have up to
/// nine bytes.
const MAX_HEADER_BYTES: usize = 20;

/// Everything that a file states before its first section.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct Header {
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
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
    /// Number of Gaussians.
    pub gaussians: u32,
    /// Whether there is a codebook.
    pub coloring: Coloring,
    /// Whether the payload is divided into groups.
    pub grouping: Grouping,
    /// Whether sections follow.
    pub sections: Sections,
    /// The bytes of the header, which the file's checksum covers.
    bytes: Vec<u8>,
}

impl Header {
    /// Reads and checks the header, and nothing after it.
    ///
    /// # Errors
    /// [`Error::Format`] if it breaks spec §2, [`Error::UnsupportedVersion`] for another version,
    /// [`Error::LimitExceeded`] if the picture exceeds `limits`, [`Error::Io`] from the reader.
    pub fn read<R: Read>(reader: &mut R, limits: &Limits) -> Result<Self> {
        let mut tee = Tee { reader, bytes: Vec::with_capacity(MAX_HEADER_BYTES) };
        let mut found = [0u8; 4];
        for i in 0..found.len() {
            found[i] = match tee.byte("signature") {
                // For a short file of another kind, the wrong signature is a better error than truncation.
                Err(Error::Format(FormatError::Truncated { .. })) if found[..i] != MAGIC[..i] => {
                    return Err(FormatError::BadMagic { found }.into());
                }
                byte => byte?,
            };
        }
        if found != MAGIC {
            return Err(FormatError::BadMagic { found }.into());
        }
        let version = tee.byte("version")?;
        if version != VERSION {
            return Err(Error::UnsupportedVersion { found: version });
        }
        let flags = tee.byte("flags")?;
        let width = side("width", tee.varint("width")?)?;
        let height = side("height", tee.varint("height")?)?;
        let gaussians = tee.varint("number of Gaussians")?;
        let steps = unpack_steps([tee.byte("steps")?, tee.byte("steps")?, tee.byte("steps")?])?;
        Limits::check(Limit::Width, width.into(), limits.width.into())?;
        Limits::check(Limit::Height, height.into(), limits.height.into())?;
        Limits::check(Limit::Gaussians, gaussians, limits.gaussians)?;
        Budget::of(limits).check(gaussians.saturating_mul(size_of::<PackedGaussian>() as u64))?;
        let gaussians = u32::try_from(gaussians)
            .map_err(|_| FormatError::BadValue { field: "number of Gaussians", value: gaussians })?;
        let (layout, grouping) = match flags & 3 {
            0 => (Layout::Packed, Grouping::Single),
            1 => (Layout::Planes, Grouping::Single),
            2 => (Layout::Coded, Grouping::Single),
            _ => (Layout::Coded, Grouping::Groups),
        };
        if layout == Layout::Packed && steps.range != 0 {
            return Err(FormatError::BadValue { field: "position range", value: steps.range.into() }.into());
        }
        Ok(Header {
            width,
            height,
            channels: [Channels::Grey, Channels::GreyAlpha, Channels::Rgb, Channels::Rgba][usize::from(flags >> 3 & 3)],
            depth: if flags & DEPTH_SIXTEEN == 0 { Depth::Eight } else { Depth::Sixteen },
            blend: if flags & BLEND_SUM == 0 { Blend::Normalized } else { Blend::Sum },
            layout,
            steps,
            gaussians,
            coloring: if flags & CODEBOOK == 0 { Coloring::Direct } else { Coloring::Codebook },
            grouping,
            sections: if flags & SECTIONS == 0 { Sections::Absent } else { Sections::Present },
            bytes: tee.bytes,
        })
    }

    /// Returns the CRC-32 of the header.
    pub(crate) fn checksum(&self) -> u32 {
        hash(&self.bytes)
    }

    /// Returns the picture of this header without Gaussians.
    pub(crate) fn empty(&self, metadata: Metadata) -> PackedSplats {
        PackedSplats {
            width: self.width,
            height: self.height,
            channels: self.channels,
            depth: self.depth,
            blend: self.blend,
            layout: self.layout,
            steps: self.steps,
            background: [0; 4],
            codebook: None,
            gaussians: Vec::new(),
            levels: Vec::new(),
            detail: None,
            exact: None,
            metadata,
        }
    }

    /// Returns the bytes of the header as read.
    pub(crate) fn bytes(&self) -> &[u8] {
        &self.bytes
    }
}

/// Appends the header of `splats`, which must have been checked.
pub(crate) fn put_header(splats: &PackedSplats, grouping: Grouping, sections: Sections, out: &mut Vec<u8>) {
    out.extend_from_slice(&MAGIC);
    let mut flags = match (splats.layout, grouping) {
        (Layout::Packed, _) => 0,
        (Layout::Planes, _) => 1,
        (Layout::Coded, Grouping::Single) => 2,
        (Layout::Coded, Grouping::Groups) => 3,
    };
    flags |= (splats.channels.count() as u8 - 1) << 3;
    for (set, flag) in [
        (splats.blend == Blend::Sum, BLEND_SUM),
        (splats.depth == Depth::Sixteen, DEPTH_SIXTEEN),
        (splats.codebook.is_some(), CODEBOOK),
        (sections == Sections::Present, SECTIONS),
    ] {
        if set {
            flags |= flag;
        }
    }
    out.extend_from_slice(&[VERSION, flags]);
    put_varint(splats.width.into(), out);
    put_varint(splats.height.into(), out);
    put_varint(splats.gaussians.len() as u64, out);
    out.extend_from_slice(&pack_steps(&splats.steps));
}

fn side(field: &'static str, value: u64) -> Result<u32> {
    match u32::try_from(value) {
        Ok(side @ 1..=MAX_SIDE) => Ok(side),
        _ => Err(FormatError::BadValue { field, value }.into()),
    }
}

fn pack_steps(s: &Steps) -> [u8; 3] {
    [s.scale | s.angle << 4 | s.chroma << 6, s.position | s.luma << 4, (s.coarsest + 6) as u8 | s.range << 4]
}

fn unpack_steps([a, b, c]: [u8; 3]) -> Result<Steps> {
    let steps = Steps {
        scale: a & 15,
        angle: a >> 4 & 3,
        chroma: a >> 6,
        position: b & 15,
        luma: b >> 4,
        coarsest: (c & 15) as i8 - 6,
        range: c >> 4,
    };
    if i32::from(steps.coarsest) - i32::from(steps.range) < MIN_EXPONENT {
        return Err(FormatError::BadValue { field: "position range", value: steps.range.into() }.into());
    }
    Ok(steps)
}

/// Records the bytes that pass through a reader.
struct Tee<'a, R> {
    reader: &'a mut R,
    bytes: Vec<u8>,
}

impl<R: Read> Tee<'_, R> {
    fn byte(&mut self, what: &'static str) -> Result<u8> {
        let mut byte = [0u8];
        match self.reader.read_exact(&mut byte) {
            Ok(()) => {
                self.bytes.push(byte[0]);
                Ok(byte[0])
            }
            Err(e) if e.kind() == ErrorKind::UnexpectedEof => {
                Err(FormatError::Truncated { what, offset: self.bytes.len() as u64 }.into())
            }
            Err(e) => Err(e.into()),
        }
    }

    fn varint(&mut self, field: &'static str) -> Result<u64> {
        varint(field, || self.byte(field))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_step_triple_round_trips_or_is_refused() {
        for code in 0..1u32 << 24 {
            let bytes = [code as u8, (code >> 8) as u8, (code >> 16) as u8];
            match unpack_steps(bytes) {
                Ok(steps) => assert_eq!(pack_steps(&steps), bytes),
                Err(_) => assert!(i32::from(bytes[2] & 15) - 6 - i32::from(bytes[2] >> 4) < MIN_EXPONENT),
            }
        }
    }
}
