//! Reads a file to integers, completely or in part. Every length is checked against limits and the bytes available
//! (spec §2, §9).

use std::io::Read;
use std::sync::Arc;

use super::broken::Broken;
use super::bytes::Bytes;
use super::checksum::Hasher;
use super::coder::coded;
use super::detail::head::{DetailHead, Spans, check_alpha};
use super::detail::index::{self, Wanted};
use super::exact::head::ExactHead;
use super::exact::index as exact_index;
use super::groups::MissingParts;
use super::header::{Grouping, Header, Sections};
#[cfg(any(test, feature = "unstable"))]
use super::report::Report;
use super::report::{Detail, EXACT_INDEX, EXACT_STREAMS, INDEX, STREAMS, Tally};
use super::rules::most_gaussians;
use super::sections::{SectionInfo, SectionsRead, read_sections};
use super::splats::{Layout, Metadata, PackedGaussian, PackedSplats};
use super::uncoded::{packed, planes};
use super::write::base_checksum;
use super::{CHECKSUM, groups};
use crate::budget::{Budget, Reservation};
use crate::error::{Error, FormatError, Result};
use crate::limits::Limits;
use crate::options::{Damage, Layers};
use crate::parameter::Limit;
use crate::rect::Rect;

/// Number of times that the bytes of a file are counted against the memory limit: the read buffer grows to twice its
/// size while the old one exists; later, metadata are copied out of it.
const FILE_COPIES: u64 = 3;

/// Maximum number of bytes for recording the bits of a Gaussian: two lists that grow to twice their size while the
/// old ones exist.
const ACCOUNT: u64 = 2 * 3 * size_of::<f32>() as u64;

/// Returns the maximum number of bytes that reading a Gaussian of a layout takes at any time.
fn working_bytes(layout: Layout) -> u64 {
    let extra = match layout {
        Layout::Packed => 0,
        // A row of ten fields, a plane that is being distributed to rows, and the window of its frame.
        Layout::Planes => 100,
        // Growing lists of positions by size, then in order; later positions and buckets.
        Layout::Coded => 240,
    };
    size_of::<PackedGaussian>() as u64 + extra
}

/// Reads a file. Every length is checked against `limits` and the bytes available before memory is allocated.
///
/// A damaged optional section is not an error: it is left out and named in [`Metadata::damaged`].
///
/// # Errors
/// [`Error::Format`](crate::Error::Format) if the file breaks the specification,
/// [`Error::UnsupportedVersion`](crate::Error::UnsupportedVersion) if it has another version,
/// [`Error::LimitExceeded`](crate::Error::LimitExceeded) if it exceeds `limits`, [`Error::Io`](crate::Error::Io) from
/// the reader.
pub fn read<R: Read>(mut reader: R, limits: &Limits) -> Result<PackedSplats> {
    let header = Header::read(&mut reader, limits)?;
    let rest = read_rest(reader, limits)?;
    Reading::all(limits, &Budget::of(limits))
        .whole(&header, &rest, None, &mut Tally::default())
        .map(|(splats, _)| splats)
}

/// Reads the Gaussians that are visible in `area`, and possibly others: groups that cannot reach into it are not
/// decoded. For the whole picture, the result is the same as that of [`read`].
///
/// # Errors
/// As [`read`], but errors in a group that is left out are detected only if its checksum does not match.
#[cfg(any(test, feature = "unstable"))]
pub fn read_area(bytes: &[u8], area: &Rect, limits: &Limits) -> Result<PackedSplats> {
    let mut rest = bytes;
    let header = Header::read(&mut rest, limits)?;
    let budget = Budget::of(limits);
    Reading::all(limits, &budget).whole(&header, rest, Some(area), &mut Tally::default()).map(|(splats, _)| splats)
}

/// Reads a file and reports where its bytes go.
///
/// # Errors
/// As [`read`].
#[cfg(any(test, feature = "unstable"))]
pub fn inspect(bytes: &[u8], limits: &Limits) -> Result<(PackedSplats, Report)> {
    let mut rest = bytes;
    let header = Header::read(&mut rest, limits)?;
    let mut tally = Tally { detail: Detail::Fields, ..Tally::default() };
    tally.part("header", header.bytes().len());
    let budget = Budget::of(limits);
    let reading = Reading::all(limits, &budget);
    let (splats, sections) = reading
        .whole(&header, rest, None, &mut tally)
        .map_err(|error| reading.explained(&header, rest, Damage::Refuse, error))?;
    tally.part("checksum", CHECKSUM);
    let levels = splats.levels.clone();
    let Tally { parts, fields, each, groups, layer_bits, .. } = tally;
    let groups = groups.max(1);
    let report =
        Report { header, bytes: bytes.len() as u64, parts, sections, fields, each, levels, groups, layer_bits };
    Ok((splats, report))
}

/// Reads the intact parts of a damaged or truncated file, and returns counts of the missing parts.
///
/// Only files in groups have parts that can be decoded separately. Any other file is read as a whole or not at all.
///
/// # Errors
/// As [`read`] if header, sections or the directory of the groups are damaged, or if there are no groups.
#[cfg(any(test, feature = "unstable"))]
pub fn read_partial(bytes: &[u8], limits: &Limits) -> Result<(PackedSplats, MissingParts)> {
    let mut rest = bytes;
    let header = Header::read(&mut rest, limits)?;
    Reading::all(limits, &Budget::of(limits)).intact(&header, rest)
}

/// Returns whether the last bytes are the checksum of those before them.
fn has_own_checksum(header: &Header, rest: &[u8]) -> bool {
    rest.split_last_chunk()
        .is_some_and(|(contents, stored)| base_checksum(header.bytes(), contents) == u32::from_le_bytes(*stored))
}

/// Returns all remaining bytes of `reader`. It reads at most one byte more than `limits` allow.
///
/// # Errors
/// [`Error::Io`](crate::Error::Io) from the reader, and [`Error::LimitExceeded`](crate::Error::LimitExceeded) if there
/// are more bytes than may be read into memory.
pub(crate) fn read_rest<R: Read>(reader: R, limits: &Limits) -> Result<Vec<u8>> {
    let mut rest = Vec::new();
    // Memory grows only with the bytes that arrive; the limit stops endless streams.
    reader.take(limits.alloc / FILE_COPIES + 1).read_to_end(&mut rest)?;
    Limits::check(Limit::Alloc, FILE_COPIES * rest.len() as u64, limits.alloc)?;
    Ok(rest)
}

/// Limits on the reading of one file.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Reading<'a> {
    pub limits: &'a Limits,
    pub budget: &'a Budget,
    /// The layers to read. Checksums are verified for all layers.
    pub layers: Layers,
}

impl<'a> Reading<'a> {
    /// Settings that read everything.
    fn all(limits: &'a Limits, budget: &'a Budget) -> Self {
        Reading { limits, budget, layers: Layers::Both }
    }
}

impl Reading<'_> {
    /// Parses the bytes after the header. With an `area`, groups that cannot reach into it are left out.
    pub(crate) fn whole(
        self,
        header: &Header,
        rest: &[u8],
        area: Option<&Rect>,
        tally: &mut Tally,
    ) -> Result<(PackedSplats, Vec<SectionInfo>)> {
        let mut working = self.reserve(header, rest)?;
        if tally.detail == Detail::Fields {
            working.grow(u64::from(header.gaussians) * ACCOUNT)?;
        }
        let base = header.bytes().len() as u64;
        let end = rest
            .len()
            .checked_sub(CHECKSUM)
            .ok_or(FormatError::Truncated { what: "checksum", offset: base + rest.len() as u64 })?;
        let mut bytes = Bytes::new(&rest[..end], base);
        let mut checksum = Hasher::new();
        checksum.update(header.bytes());
        let SectionsRead { metadata, detail, exact, infos } =
            self.sections(header, &mut bytes, &mut checksum, tally)?;
        let behind = &rest[bytes.taken().len()..end];
        checksum.update(behind);
        let computed = checksum.finalize();
        let stored = Bytes::new(&rest[end..], 0).u32("checksum")?;
        if stored != computed {
            return Err(FormatError::Checksum { what: "file", stored, computed }.into());
        }
        let spans = spans(detail.as_ref(), exact.as_ref())?;
        let mut payload = payload(header, &mut bytes, (spans, detail.is_some()))?;
        if u64::from(header.gaussians) > most_gaussians(payload.left() as u64) {
            return Err(FormatError::BadValue { field: "number of Gaussians", value: header.gaussians.into() }.into());
        }
        let mut splats = header.empty(metadata);
        match (header.layout, header.grouping) {
            (Layout::Packed, _) => packed::read(&mut payload, header, &mut splats, tally)?,
            (Layout::Planes, _) => planes::read(&mut payload, header, &mut splats, tally)?,
            (Layout::Coded, Grouping::Single) => coded::read(&mut payload, header, &mut splats, tally)?,
            (Layout::Coded, Grouping::Groups) => groups::read(&mut payload, header, area, &mut splats, tally)?,
        }
        payload.finish()?;
        if self.layers == Layers::Gaussians {
            if spans.is_some() {
                bytes.rest();
            }
            bytes.finish()?;
            return Ok((splats, infos));
        }
        let length = exact.as_ref().map_or(bytes.left() as u64, |head| head.detail);
        let mut layer = bytes.part(length, "detail layer")?;
        if let Some((head, _)) = detail {
            let start = layer.left();
            let wanted = self.wanted(header, area, tally.detail == Detail::Fields);
            let found = index::read(&mut layer, head, &wanted, &mut working)?;
            tally.part(INDEX, found.index);
            tally.part(STREAMS, start - layer.left() - found.index);
            tally.layer_bits = found.bits;
            splats.detail = found.layer.map(Arc::new);
        }
        layer.finish()?;
        if let Some(head) = exact {
            if self.layers == Layers::Detail {
                bytes.rest();
                return Ok((splats, infos));
            }
            let start = bytes.left();
            let wanted = self.wanted_exactly(header, area);
            let found = exact_index::read(&mut bytes, &head, &wanted, &mut working)?;
            tally.part(EXACT_INDEX, found.index);
            tally.part(EXACT_STREAMS, start - bytes.left() - found.index);
            splats.exact = found.layer.map(Arc::new);
        }
        bytes.finish()?;
        Ok((splats, infos))
    }

    /// Returns the part of a detail layer to read, with its limits.
    fn wanted<'w>(&'w self, header: &Header, area: Option<&Rect>, counts: bool) -> Wanted<'w> {
        let size = [header.width, header.height];
        Wanted { size, channels: header.channels, area: area.copied(), limits: self.limits, passes_over: false, counts }
    }

    /// Returns the part of an exact layer to read, with its limits.
    fn wanted_exactly<'w>(&'w self, header: &Header, area: Option<&Rect>) -> exact_index::Wanted<'w> {
        exact_index::Wanted {
            size: [header.width, header.height],
            channels: header.channels,
            depth: header.depth,
            area: area.copied(),
            limits: self.limits,
            passes_over: false,
        }
    }

    /// Parses the intact parts of the bytes after the header, and returns counts of the missing parts.
    pub(crate) fn intact(self, header: &Header, rest: &[u8]) -> Result<(PackedSplats, MissingParts)> {
        let mut working = self.reserve(header, rest)?;
        // Parts are verified by the checksums of the directory and of each group, or by that of the Gaussians' bytes.
        // The checksum of the file may be cut off, or may be inside the last group of a truncated file. It only tells
        // whether the whole file is intact.
        let mut bytes = Bytes::new(rest, header.bytes().len() as u64);
        let mut checksum = Hasher::new();
        checksum.update(header.bytes());
        let SectionsRead { metadata, detail, exact, .. } =
            self.sections(header, &mut bytes, &mut checksum, &mut Tally::default())?;
        let spans = spans(detail.as_ref(), exact.as_ref())?;
        if header.grouping == Grouping::Single && spans.is_none() {
            let (splats, _) = self.whole(header, rest, None, &mut Tally::default())?;
            return Ok((splats, MissingParts::default()));
        }
        let behind = bytes.taken().len();
        let mut splats = header.empty(metadata);
        let mut missing = MissingParts::default();
        match (header.grouping, spans) {
            (Grouping::Groups, None) => missing = groups::read_intact(&mut bytes, header, &mut splats)?,
            (Grouping::Groups, Some(spans)) => {
                let mut payload = bytes.part(spans.payload.min(bytes.left() as u64), "payload")?;
                missing = groups::read_intact(&mut payload, header, &mut splats)?;
            }
            (Grouping::Single, _) => {
                let mut payload = payload(header, &mut bytes, (spans, detail.is_some()))?;
                if u64::from(header.gaussians) > most_gaussians(payload.left() as u64) {
                    let value = header.gaussians.into();
                    return Err(FormatError::BadValue { field: "number of Gaussians", value }.into());
                }
                coded::read(&mut payload, header, &mut splats, &mut Tally::default())?;
                payload.finish()?;
            }
        }
        // The checksum at the end may be cut off. If it is read as a part of a stream, that stream fails its own check.
        if self.layers != Layers::Gaussians {
            let length = exact.as_ref().map_or(bytes.left() as u64, |head| head.detail.min(bytes.left() as u64));
            if let Some((head, _)) = detail {
                let mut layer = bytes.clone().part(length, "detail layer")?;
                let wanted = Wanted { passes_over: true, ..self.wanted(header, None, false) };
                let found = index::read(&mut layer, head, &wanted, &mut working)?;
                missing.tiles = found.missing;
                missing.of_tiles = found.of;
                splats.detail = found.layer.map(Arc::new);
                // Without an exact layer, the detail layer says where it ends.
                bytes.take(if exact.is_some() { length } else { length - layer.left() as u64 }, "detail layer")?;
            }
        }
        if let Some(head) = exact.filter(|_| self.layers == Layers::Both) {
            let wanted = exact_index::Wanted { passes_over: true, ..self.wanted_exactly(header, None) };
            let found = exact_index::read(&mut bytes, &head, &wanted, &mut working)?;
            missing.tiles += found.missing;
            missing.of_tiles += found.of;
            (missing.exact_tiles, missing.of_exact_tiles) = (found.missing, found.of);
            splats.exact = found.layer.map(Arc::new);
        } else if spans.is_some() && (exact.is_some() || self.layers == Layers::Gaussians) {
            // The layers are skipped; only the checksum of the file covers their bytes.
            bytes.take(bytes.left().saturating_sub(CHECKSUM) as u64, "layers")?;
        }
        checksum.update(&bytes.taken()[behind..]);
        let computed = checksum.finalize();
        let is_sealed = bytes.u32("checksum").is_ok_and(|stored| stored == computed);
        missing.damaged = !(is_sealed && bytes.left() == 0);
        let is_whole = !missing.damaged && missing.groups == 0 && missing.tiles == 0;
        Ok((splats, if is_whole { MissingParts::default() } else { missing }))
    }

    /// Parses the sections, and nothing after them.
    pub(crate) fn described(self, header: &Header, rest: &[u8]) -> Result<Metadata> {
        let _working = self.budget.reserve(FILE_COPIES * rest.len() as u64)?;
        let mut bytes = Bytes::new(rest, header.bytes().len() as u64);
        let read = self.sections(header, &mut bytes, &mut Hasher::new(), &mut Tally::default())?;
        Ok(read.metadata)
    }

    /// Returns `error`, or the error of a truncated file if `error` comes from the end of the file being missing. The
    /// error has the length of the whole file if that can be found.
    ///
    /// The checksum is the last part of a file. In a truncated file, other bytes are in its place, so that the error of
    /// [`whole`](Reading::whole) is a wrong checksum.
    pub(crate) fn explained(self, header: &Header, rest: &[u8], damage: Damage, error: Error) -> Error {
        let is_short = match error {
            Error::Format(FormatError::Truncated { .. }) => true,
            Error::Format(FormatError::Checksum { what: "file", .. }) => false,
            error => return error,
        };
        // A file with its checksum is whole, whatever lengths it states.
        if has_own_checksum(header, rest) {
            return error;
        }
        let bytes = header.bytes().len() as u64 + rest.len() as u64;
        let End { end, has_parts } = self.end(header, rest);
        let partial = has_parts && damage == Damage::Refuse;
        match (end, error) {
            (Ok(Some(end)), _) if end > bytes => FormatError::CutOff { bytes, of: Some(end), partial }.into(),
            (Err(Error::Format(FormatError::Truncated { .. })), _) => {
                FormatError::CutOff { bytes, of: None, partial }.into()
            }
            _ if is_short => FormatError::CutOff { bytes, of: None, partial }.into(),
            (Ok(None), Error::Format(FormatError::Checksum { stored, computed, .. })) => {
                FormatError::Checksum { what: "file, which is damaged or cut off,", stored, computed }.into()
            }
            (_, error) => error,
        }
    }

    /// Finds where the file ends, from lengths that it states.
    fn end(self, header: &Header, rest: &[u8]) -> End {
        let mut found = End { end: Ok(None), has_parts: false };
        found.end = self.find_end(header, rest, &mut found.has_parts);
        found
    }

    fn find_end(self, header: &Header, rest: &[u8], has_parts: &mut bool) -> Result<Option<u64>> {
        let mut bytes = Bytes::new(rest, header.bytes().len() as u64);
        let mut working = self.reserve(header, rest)?;
        let SectionsRead { detail, exact, .. } =
            self.sections(header, &mut bytes, &mut Hasher::new(), &mut Tally::default())?;
        let spans = spans(detail.as_ref(), exact.as_ref())?;
        let (mut splats, tally) = (header.empty(Metadata::default()), &mut Tally::default());
        let Some(spans) = spans else {
            match (header.layout, header.grouping) {
                (Layout::Packed, _) => packed::read(&mut bytes, header, &mut splats, tally)?,
                (Layout::Planes, _) => planes::read(&mut bytes, header, &mut splats, tally)?,
                // The stream does not state its length.
                (Layout::Coded, Grouping::Single) => return Ok(None),
                (Layout::Coded, Grouping::Groups) => {
                    let groups = groups::length(&mut bytes, header, &mut splats)?;
                    *has_parts = true;
                    return Ok(Some(bytes.offset().saturating_add(groups).saturating_add(CHECKSUM as u64)));
                }
            }
            return Ok(Some(bytes.offset() + CHECKSUM as u64));
        };
        *has_parts = header.grouping == Grouping::Groups
            && groups::length(&mut bytes.clone(), header, &mut splats).is_ok()
            || bytes.left() as u64 >= spans.payload;
        bytes.take(spans.payload, "Gaussians")?;
        let mut end = None;
        if detail.is_some() {
            let mut layer = bytes.clone();
            let streams = index::streams_length(&mut layer, [header.width, header.height], &mut working)?;
            end = Some(layer.offset().saturating_add(streams));
        }
        if let Some(head) = &exact {
            bytes.take(head.detail, "detail layer")?;
            let streams = exact_index::streams_length(&mut bytes, head, [header.width, header.height], &mut working)?;
            end = Some(bytes.offset().saturating_add(streams));
        }
        Ok(end.map(|end| end.saturating_add(CHECKSUM as u64)))
    }

    /// Reserves the maximum memory that parsing `rest` can take.
    fn reserve(self, header: &Header, rest: &[u8]) -> Result<Reservation> {
        let gaussians = u64::from(header.gaussians) * working_bytes(header.layout);
        self.budget.reserve(FILE_COPIES * rest.len() as u64 + gaussians)
    }

    /// Reads the sections, if there are any.
    fn sections(
        self,
        header: &Header,
        bytes: &mut Bytes<'_>,
        checksum: &mut Hasher,
        tally: &mut Tally,
    ) -> Result<SectionsRead> {
        if header.sections == Sections::Absent {
            return Ok(Default::default());
        }
        let read = read_sections(bytes, self.limits, header.checksum(), checksum)?;
        if let Some((head, _)) = &read.detail {
            check_alpha(head, header.channels)?;
        }
        tally.part("sections", bytes.taken().len());
        Ok(read)
    }
}

/// Where a file ends.
struct End {
    /// Length of the whole file, if the bytes that are present state it.
    end: Result<Option<u64>>,
    /// Whether parts of the picture can be decoded without the rest.
    has_parts: bool,
}

/// Returns the length and the checksum of the Gaussians' bytes if layers follow them.
fn spans(detail: Option<&(DetailHead, Spans)>, exact: Option<&ExactHead>) -> Result<Option<Spans>> {
    match (detail, exact) {
        (Some((_, spans)), Some(exact)) if *spans != exact.spans => {
            Err(Broken { field: "payload length of the exact layer's section", value: exact.spans.payload }.into())
        }
        (None, Some(exact)) if exact.detail > 0 => {
            Err(Broken { field: "detail layer length without a detail layer", value: exact.detail }.into())
        }
        (Some((_, spans)), _) => Ok(Some(*spans)),
        (None, exact) => Ok(exact.map(|exact| exact.spans)),
    }
}

/// Returns the Gaussians' bytes: all that remain, or those before the layers, which then have a checksum of their own.
fn payload<'a>(
    header: &Header,
    bytes: &mut Bytes<'a>,
    (spans, has_detail): (Option<Spans>, bool),
) -> Result<Bytes<'a>> {
    let Some(spans) = spans else {
        return bytes.part(bytes.left() as u64, "payload");
    };
    if header.layout != Layout::Coded {
        let field =
            if has_detail { "layout of a file with a detail layer" } else { "layout of a file with an exact layer" };
        return Err(Broken { field, value: header.layout as u64 }.into());
    }
    let payload = bytes.part(spans.payload, "payload")?;
    let (stored, computed) = (spans.checksum, base_checksum(header.bytes(), payload.clone().rest()));
    if stored != computed {
        return Err(FormatError::Checksum { what: "payload", stored, computed }.into());
    }
    Ok(payload)
}
