//! Bytes to integers and back; exact. Knows no colour and no pixel (spec §2 to §8).

mod attributes;
mod bits;
mod broken;
mod bytes;
mod coded;
mod groups;
pub mod header;
mod hilbert;
mod kd;
pub mod lattice;
mod model;
mod neighbours;
mod packed;
mod palette;
mod planes;
mod range;
mod region;
pub mod report;
pub mod rules;
pub mod sections;
pub mod splats;
mod spread;

use std::io::{Read, Write};

use crc32fast::Hasher;

use self::bytes::Bytes;
pub use self::groups::Missing;
use self::header::{Grouping, Header, Sections, put_header};
use self::report::{Detail, Report, Tally};
use self::rules::Area;
use self::sections::{SectionInfo, put_sections, read_sections};
use self::splats::{Layout, Metadata, PackedGaussian, PackedSplats};
use crate::error::{Error, FormatError, Result};
use crate::limits::Limits;

/// Bytes of the checksum at the end.
const CHECKSUM: usize = 4;

/// How often the bytes of a file are counted against the memory limit: reading grows its buffer to twice the size while
/// the old one is there; later, metadata are copied out of it.
const FILE_COPIES: u64 = 3;

/// How many primitives a payload of `bytes` bytes may hold: real ones take 20 bits or more, and a file that claims
/// millions in a few bytes must not cost the work of millions.
fn most_primitives(bytes: u64) -> u64 {
    bytes.saturating_mul(8).saturating_add(1024)
}

/// Most bytes that reading a primitive of a layout takes at any time.
fn working_bytes(layout: Layout) -> u64 {
    let extra = match layout {
        Layout::Packed => 0,
        // A row of ten fields, and planes on their way into rows.
        Layout::Planes => 100,
        // Places by size, growing, then in order; later places and buckets.
        Layout::Coded => 240,
    };
    size_of::<PackedGaussian>() as u64 + extra
}

/// Writes `splats` in their layout. The primitives of a level are put into the layout's own order.
///
/// # Errors
/// [`Error::Parameter`] if the integers break spec §4, [`Error::Io`] from the writer.
pub fn write<W: Write>(splats: &PackedSplats, writer: &mut W) -> Result<()> {
    writer.write_all(&to_bytes(splats)?)?;
    Ok(())
}

/// The file of `splats`; see [`write()`].
///
/// # Errors
/// [`Error::Parameter`] if the integers break spec §4.
pub fn to_bytes(splats: &PackedSplats) -> Result<Vec<u8>> {
    rules::check(splats)?;
    let has_sections = splats.metadata.icc.is_some() || splats.metadata.exif.is_some();
    let sections = if has_sections { Sections::Present } else { Sections::Absent };
    let (mut out, mut checksum) = (Vec::new(), Hasher::new());
    let grouping = groups::grouping(splats);
    put_header(splats, grouping, sections, &mut out);
    checksum.update(&out);
    let header = crc32fast::hash(&out);
    if has_sections {
        put_sections(&splats.metadata, &mut out, &mut checksum);
    }
    let payload = out.len();
    match (splats.layout, grouping) {
        (Layout::Packed, _) => packed::put(splats, &mut out)?,
        (Layout::Planes, _) => planes::put(splats, &mut out)?,
        (Layout::Coded, Grouping::Single) => coded::put(splats, &mut out)?,
        (Layout::Coded, Grouping::Groups) => groups::put(splats, header, &mut out)?,
    }
    checksum.update(&out[payload..]);
    if splats.gaussians.len() as u64 > most_primitives((out.len() - payload) as u64) {
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

/// Reads the primitives that can be seen in `area`, and perhaps others: groups that are out of its reach are not
/// decoded. For the whole picture that is all of them, as [`read`] gives them.
///
/// # Errors
/// As [`read`], but what is wrong in a group that is left out goes unnoticed unless its checksum shows it.
pub fn read_area(bytes: &[u8], area: &Area, limits: &Limits) -> Result<PackedSplats> {
    let mut rest = bytes;
    let header = Header::read(&mut rest, limits)?;
    header.parse(rest, limits, Some(area), &mut Tally::default()).map(|(splats, _)| splats)
}

/// Reads a file and reports where its bytes go.
///
/// # Errors
/// As [`read`].
pub fn inspect(bytes: &[u8], limits: &Limits) -> Result<(PackedSplats, Report)> {
    let mut rest = bytes;
    let header = Header::read(&mut rest, limits)?;
    let mut tally = Tally { detail: Detail::Fields, ..Tally::default() };
    tally.part("header", header.bytes().len());
    let (splats, sections) = header.parse(rest, limits, None, &mut tally)?;
    tally.part("checksum", CHECKSUM);
    let levels = splats.levels.clone();
    let Tally { parts, fields, groups, .. } = tally;
    let report = Report { header, bytes: bytes.len() as u64, parts, sections, fields, levels, groups: groups.max(1) };
    Ok((splats, report))
}

/// Reads what is intact of a damaged or truncated file, and says what is missing.
///
/// Only files in groups have parts that stand alone; any other file is read whole or not at all.
///
/// # Errors
/// As [`read`] when header, sections or the directory of the groups are damaged, or when there are no groups.
pub fn read_partial(bytes: &[u8], limits: &Limits) -> Result<(PackedSplats, Missing)> {
    let mut rest = bytes;
    let header = Header::read(&mut rest, limits)?;
    let error = match header.parse(rest, limits, None, &mut Tally::default()) {
        Ok((splats, _)) => return Ok((splats, Missing::default())),
        Err(error) => error,
    };
    if header.grouping == Grouping::Single || matches!(error, Error::LimitExceeded { .. }) {
        return Err(error);
    }
    let mut cursor = Bytes::new(rest, header.bytes().len() as u64);
    let metadata = match header.sections {
        Sections::Absent => Metadata::default(),
        Sections::Present => read_sections(&mut cursor, limits, &mut Hasher::new())?.0,
    };
    let mut splats = header.empty(metadata);
    let missing = groups::read_intact(&mut cursor, &header, &mut splats)?;
    Ok((splats, missing))
}

impl Header {
    /// Reads what follows the header.
    ///
    /// # Errors
    /// As [`read`].
    pub fn read_body<R: Read>(&self, reader: R, limits: &Limits) -> Result<PackedSplats> {
        let mut rest = Vec::new();
        // What is read is backed by bytes that somebody sent; the limit stops endless streams.
        reader.take(limits.alloc / FILE_COPIES + 1).read_to_end(&mut rest)?;
        self.parse(&rest, limits, None, &mut Tally::default()).map(|(splats, _)| splats)
    }

    /// Parses the bytes behind the header; with an `area`, groups that cannot reach into it are left out.
    fn parse(
        &self,
        rest: &[u8],
        limits: &Limits,
        area: Option<&Area>,
        tally: &mut Tally,
    ) -> Result<(PackedSplats, Vec<SectionInfo>)> {
        let working = u64::from(self.primitives) * working_bytes(self.layout);
        limits.check_alloc(FILE_COPIES * rest.len() as u64 + working)?;
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
        if u64::from(self.primitives) > most_primitives(payload.len() as u64) {
            return Err(FormatError::BadValue { field: "primitive count", value: self.primitives.into() }.into());
        }
        let mut splats = self.empty(metadata);
        match (self.layout, self.grouping) {
            (Layout::Packed, _) => packed::read(&mut bytes, self, &mut splats, tally)?,
            (Layout::Planes, _) => planes::read(&mut bytes, self, &mut splats, tally)?,
            (Layout::Coded, Grouping::Single) => coded::read(&mut bytes, self, &mut splats, tally)?,
            (Layout::Coded, Grouping::Groups) => groups::read(&mut bytes, self, area, &mut splats, tally)?,
        }
        bytes.finish()?;
        Ok((splats, sections))
    }

    /// The picture of this header without primitives.
    fn empty(&self, metadata: Metadata) -> PackedSplats {
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
            metadata,
        }
    }
}
