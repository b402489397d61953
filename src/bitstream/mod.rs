//! Bytes to integers and back; exact. Knows no colour and no pixel (spec §2 to §8).

mod attributes;
mod bits;
mod bytes;
mod coded;
pub mod header;
mod hilbert;
mod kd;
pub mod lattice;
mod model;
mod neighbours;
mod packed;
mod palette;
mod range;
pub mod report;
pub mod rules;
pub mod sections;
pub mod splats;

use std::io::{Read, Write};

use crc32fast::Hasher;

use self::bytes::Bytes;
use self::header::{Grouping, Header, Sections, put_header};
use self::report::{Report, Tally};
use self::sections::{SectionInfo, put_sections, read_sections};
use self::splats::{Layout, Metadata, PackedGaussian, PackedSplats};
use crate::error::{Error, FormatError, Result};
use crate::limits::Limits;

/// Bytes of the checksum at the end.
const CHECKSUM: usize = 4;

/// How many primitives a payload of `bytes` bytes may hold: real ones take 20 bits or more, and a file that claims
/// millions in a few bytes must not cost the work of millions.
fn most_primitives(bytes: usize) -> u64 {
    1024 + 8 * bytes as u64
}

/// Writes `splats` in their layout. The primitives of a level are put into the layout's own order.
///
/// # Errors
/// [`Error::Parameter`] if the integers break spec §4, [`Error::Io`] from the writer.
pub fn write<W: Write>(splats: &PackedSplats, writer: &mut W) -> Result<()> {
    writer.write_all(&to_bytes(splats)?)?;
    Ok(())
}

/// The file of `splats`; see [`write`].
///
/// # Errors
/// [`Error::Parameter`] if the integers break spec §4.
pub fn to_bytes(splats: &PackedSplats) -> Result<Vec<u8>> {
    rules::check(splats)?;
    let has_sections = splats.metadata.icc.is_some() || splats.metadata.exif.is_some();
    let sections = if has_sections { Sections::Present } else { Sections::Absent };
    let (mut out, mut checksum) = (Vec::new(), Hasher::new());
    put_header(
        splats,
        if splats.layout == Layout::Coded { coded::grouping(splats) } else { Grouping::Single },
        sections,
        &mut out,
    );
    checksum.update(&out);
    if has_sections {
        put_sections(&splats.metadata, &mut out, &mut checksum);
    }
    let payload = out.len();
    match splats.layout {
        Layout::Packed => packed::put(splats, &mut out)?,
        Layout::Coded => coded::put(splats, &mut out)?,
        Layout::Planes => {
            return Err(Error::Parameter { name: "layout", problem: "planes are not written yet".into() });
        }
    }
    checksum.update(&out[payload..]);
    if splats.gaussians.len() as u64 > most_primitives(out.len() - payload) {
        let problem = format!("{} are more than 1024 and 8 a byte", splats.gaussians.len());
        return Err(Error::Parameter { name: "primitive count", problem });
    }
    out.extend_from_slice(&checksum.finalize().to_le_bytes());
    Ok(out)
}

/// Reads a file, holding every length against `limits` and against the bytes that are there before allocating.
///
/// A damaged optional section does not fail the file: it is left out and named in [`Metadata::damaged`].
///
/// # Errors
/// [`Error::Format`] if the file breaks the specification, [`Error::UnsupportedVersion`] if it is newer,
/// [`Error::LimitExceeded`] if it is sound but too large, [`Error::Io`] from the reader.
pub fn read<R: Read>(mut reader: R, limits: &Limits) -> Result<PackedSplats> {
    let header = Header::read(&mut reader, limits)?;
    header.read_body(reader, limits)
}

/// Reads a file and reports where its bytes go.
///
/// # Errors
/// As [`read`].
pub fn inspect(bytes: &[u8], limits: &Limits) -> Result<(PackedSplats, Report)> {
    let mut rest = bytes;
    let header = Header::read(&mut rest, limits)?;
    let mut tally = Tally::default();
    tally.part("header", header.bytes().len());
    let (splats, sections) = header.parse(rest, limits, &mut tally)?;
    tally.part("checksum", CHECKSUM);
    let levels = splats.levels.clone();
    let Tally { parts, fields, groups } = tally;
    let report = Report { header, bytes: bytes.len() as u64, parts, sections, fields, levels, groups: groups.max(1) };
    Ok((splats, report))
}

impl Header {
    /// Reads what follows the header.
    ///
    /// # Errors
    /// As [`read`].
    pub fn read_body<R: Read>(&self, reader: R, limits: &Limits) -> Result<PackedSplats> {
        let mut rest = Vec::new();
        // What is read is backed by bytes that somebody sent; the limit stops endless streams.
        reader.take(limits.alloc.saturating_add(1)).read_to_end(&mut rest)?;
        Limits::check("alloc", rest.len() as u64, limits.alloc)?;
        self.parse(&rest, limits, &mut Tally::default()).map(|(splats, _)| splats)
    }

    /// Parses the bytes behind the header.
    fn parse(&self, rest: &[u8], limits: &Limits, tally: &mut Tally) -> Result<(PackedSplats, Vec<SectionInfo>)> {
        let records = u64::from(self.primitives) * size_of::<PackedGaussian>() as u64;
        Limits::check("alloc", rest.len() as u64 + records, limits.alloc)?;
        let base = self.bytes().len() as u64;
        let end = rest
            .len()
            .checked_sub(CHECKSUM)
            .ok_or(FormatError::Truncated { what: "checksum", offset: base + rest.len() as u64 })?;
        let mut bytes = Bytes::new(&rest[..end], base);
        let mut checksum = Hasher::new();
        checksum.update(self.bytes());
        let (metadata, sections) = match self.sections {
            Sections::Absent => (Metadata::default(), Vec::new()),
            Sections::Present => {
                let read = read_sections(&mut bytes, limits, &mut checksum)?;
                tally.part("sections", bytes.taken().len());
                read
            }
        };
        let payload = &rest[bytes.taken().len()..end];
        checksum.update(payload);
        let computed = checksum.finalize();
        let stored = Bytes::new(&rest[end..], 0).u32("checksum")?;
        if stored != computed && !cfg!(fuzzing) {
            return Err(FormatError::Checksum { what: "file", stored, computed }.into());
        }
        if u64::from(self.primitives) > most_primitives(payload.len()) {
            return Err(FormatError::BadValue { field: "primitive count", value: self.primitives.into() }.into());
        }
        let mut splats = PackedSplats {
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
            metadata,
        };
        match self.layout {
            Layout::Packed => packed::read(&mut bytes, self, &mut splats, tally)?,
            Layout::Coded => coded::read(&mut bytes, self, &mut splats, tally)?,
            Layout::Planes => {
                return Err(Error::Parameter { name: "layout", problem: "planes are not written yet".into() });
            }
        }
        bytes.finish()?;
        Ok((splats, sections))
    }
}
