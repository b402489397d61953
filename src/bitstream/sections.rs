//! Optional blocks after the header: code points, ICC profile, EXIF, thumbnail, and additions of later versions (spec §3).

use super::bytes::{Bytes, put_varint};
use super::checksum::Hasher;
use super::cicp::Cicp;
use super::detail::head::{self as detail_head, DetailHead, Spans};
use super::exact::head::{self as exact_head, ExactHead};
use super::splats::{CICP, EXIF, ICC, Metadata, THUMBNAIL};
use crate::error::{FormatError, Result};
use crate::limits::Limits;
use crate::parameter::Limit;

/// Name of the critical section with the parameters of the detail layer that follows the payload.
pub const DETAIL: [u8; 4] = *b"Dtal";
/// Name of the critical section with the parameters of the exact layer at the end of the file.
pub const EXACT: [u8; 4] = *b"Exac";

/// Maximum number of sections in a file.
pub const MAX_SECTIONS: usize = 64;

/// Bytes of the number of sections, of which a file has at most [`MAX_SECTIONS`].
pub(crate) const SECTION_COUNT_BYTES: u64 = 1;

/// Returns the bytes that a section with `length` bytes of contents takes in a file: name, length, checksum and
/// contents.
pub(crate) fn section_bytes(length: u64) -> u64 {
    let mut varint = Vec::new();
    put_varint(length, &mut varint);
    4 + varint.len() as u64 + 4 + length
}

/// Contents of a file's sections.
#[derive(Debug, Default)]
pub(crate) struct SectionsRead {
    pub metadata: Metadata,
    /// The detail layer's head, and the end of the Gaussians' bytes.
    pub detail: Option<(DetailHead, Spans)>,
    pub exact: Option<ExactHead>,
    pub infos: Vec<SectionInfo>,
}

/// Name, size and treatment of a section, for reports.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SectionInfo {
    /// Four ASCII letters. If the first is a capital, a decoder that does not know the section must refuse the file.
    pub name: [u8; 4],
    /// Bytes of the section in the file, including its head.
    pub bytes: u64,
    /// Treatment by the reader.
    pub fate: SectionFate,
}

/// Treatment of a section by a reader.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum SectionFate {
    /// Understood and kept.
    Kept,
    /// Optional and unknown: skipped.
    Skipped,
    /// Optional, with a checksum that does not match: dropped.
    Damaged,
}

/// Reads the sections. The checksum of the file, which `checksum` accumulates, covers their heads. Each head contains
/// the checksum of its contents, so that a damaged profile does not make the picture unreadable.
///
/// `header` is the checksum of the header. The checksum of each section covers it as well, which ties the section to
/// this picture.
pub(crate) fn read_sections(
    bytes: &mut Bytes<'_>,
    limits: &Limits,
    header: u32,
    checksum: &mut Hasher,
) -> Result<SectionsRead> {
    let (mut metadata, mut layer, mut exact, mut infos) = (Metadata::default(), None, None, Vec::new());
    let mut head = bytes.taken().len();
    let count = bytes.varint("section count")?;
    if !(1..=MAX_SECTIONS as u64).contains(&count) {
        return Err(FormatError::BadValue { field: "section count", value: count }.into());
    }
    let mut total = 0u64;
    let mut last = None;
    for _ in 0..count {
        let before = bytes.left();
        let name = bytes.array::<4>("section name")?;
        if !name.iter().all(u8::is_ascii_alphabetic) || last.is_some_and(|l| l >= name) {
            let value = u64::from(u32::from_be_bytes(name));
            return Err(FormatError::BadValue { field: "section name", value }.into());
        }
        last = Some(name);
        let length = bytes.varint("section length")?;
        let stored = bytes.u32("section checksum")?;
        checksum.update(&bytes.taken()[head..]);
        let contents = bytes.take(length, "section")?;
        head = bytes.taken().len();
        // The detail layer is no metadata; `Limits` has other bounds for it.
        total = total.saturating_add(if name == DETAIL { 0 } else { length });
        Limits::check(Limit::Metadata, total, limits.metadata)?;
        let computed = contents_checksum(header, name, contents);
        let known = match name {
            ICC => Some(&mut metadata.icc),
            EXIF => Some(&mut metadata.exif),
            THUMBNAIL => Some(&mut metadata.thumbnail),
            DETAIL if stored != computed => {
                return Err(FormatError::Checksum { what: "section of the detail layer", stored, computed }.into());
            }
            DETAIL => {
                layer = Some(detail_head::read(contents, bytes.offset() - length)?);
                None
            }
            EXACT if stored != computed => {
                return Err(FormatError::Checksum { what: "section of the exact layer", stored, computed }.into());
            }
            EXACT => {
                exact = Some(exact_head::read(contents, bytes.offset() - length)?);
                None
            }
            CICP if stored == computed => {
                metadata.cicp = Some(Cicp::from_bytes(contents)?);
                None
            }
            _ if name[0].is_ascii_uppercase() => return Err(FormatError::UnknownCriticalSection { name }.into()),
            _ => None,
        };
        let fate = match known {
            _ if stored != computed => {
                metadata.damaged.push(name);
                SectionFate::Damaged
            }
            None if [DETAIL, EXACT, CICP].contains(&name) => SectionFate::Kept,
            None => SectionFate::Skipped,
            Some(slot) => {
                *slot = Some(contents.to_vec());
                SectionFate::Kept
            }
        };
        infos.push(SectionInfo { name, bytes: (before - bytes.left()) as u64, fate });
    }
    checksum.update(&bytes.taken()[head..]);
    Ok(SectionsRead { metadata, detail: layer, exact, infos })
}

/// Appends the sections of the `layers` with the given contents, and those of `metadata`, and updates the checksum of
/// the file. The sections' checksums start from that of the `header`.
pub(crate) fn put_sections(
    metadata: &Metadata,
    layers: &[([u8; 4], Vec<u8>)],
    header: u32,
    out: &mut Vec<u8>,
    checksum: &mut Hasher,
) {
    let mut head = out.len();
    // Names with capital letters come first.
    let sections = || layers.iter().map(|(name, contents)| (*name, &contents[..])).chain(metadata.sections());
    put_varint(sections().count() as u64, out);
    for (name, contents) in sections() {
        out.extend_from_slice(&name);
        put_varint(contents.len() as u64, out);
        out.extend_from_slice(&contents_checksum(header, name, contents).to_le_bytes());
        checksum.update(&out[head..]);
        out.extend_from_slice(contents);
        head = out.len();
    }
    checksum.update(&out[head..]);
}

fn contents_checksum(header: u32, name: [u8; 4], contents: &[u8]) -> u32 {
    let mut hasher = Hasher::new();
    hasher.update(&header.to_le_bytes());
    hasher.update(&name);
    hasher.update(contents);
    hasher.finalize()
}
