//! The coded layout in groups: parts that can be decoded separately, listed in a directory (spec §8.7).

use std::ops::Range;

use super::broken::Broken;
use super::bytes::{Bytes, put_varint};
use super::checksum::{Hasher, hash};
use super::coder::coded::{Group, metered, sort};
use super::coder::range::ONE_READER;
use super::coder::range::{Decoder, Encoder};
use super::header::{Coloring, Grouping, Header};
use super::palette::{put_codebook, put_color, read_codebook, read_color, sorted_codebook};
use super::region::Region;
use super::report::{Detail, Tally};
use super::rules::{MAX_LEVELS, Rules, most_gaussians};
use super::splats::{Layout, PackedGaussian, PackedSplats};
use crate::error::{FormatError, Result};
use crate::parallel;
use crate::rect::Rect;

/// Number of Gaussians above which a file is divided into groups.
const MAX_UNGROUPED: u32 = 1 << 15;

/// Number of Gaussians above which a region is halved. Smaller groups cost bytes, since each has an entry and adapts
/// from the start (512 instead of 2048: 1.5 %), but save work if only a part of the picture is read (a third to a
/// half).
const MAX_GROUP: u32 = 1 << 9;

/// Maximum reach of a Gaussian relative to its region. The writer does not pass wider Gaussians down to the halves
/// of the region, because a few of them would make every group reach into every area.
const MAX_REACH: f64 = 0.25;

/// Minimum number of wide Gaussians for a group of their own.
const MIN_WIDE_GROUP: usize = 16;

/// Returns how the writer divides the Gaussians: not at all, unless there are many.
pub(crate) fn grouping(splats: &PackedSplats) -> Grouping {
    let many = splats.levels.len() > 1 || splats.gaussians.len() > MAX_UNGROUPED as usize;
    if splats.layout == Layout::Coded && many { Grouping::Groups } else { Grouping::Single }
}

/// A part that can be decoded separately.
#[derive(Debug, Clone)]
struct Entry {
    level: usize,
    region: Region,
    count: u32,
    /// Range of its bytes, relative to the end of the directory.
    bytes: Range<u64>,
    /// Its largest major scale.
    largest: u8,
    checksum: u32,
}

impl Entry {
    /// Returns whether a Gaussian of this group can reach into `area`.
    fn reaches(&self, rules: &Rules, area: &Rect) -> bool {
        let reach = rules.reach(self.largest);
        let pixels = |cells: u64| (cells as f64) * f64::from(rules.finest()).exp2();
        (0..2).all(|k| {
            let start = u64::from(self.region.corner[k]);
            let end = start + (1u64 << self.region.log[k]);
            let low = f64::from(area.corner()[k]);
            let high = low + f64::from(area.size()[k]);
            pixels(start) - reach < high && pixels(end) + reach > low
        })
    }
}

/// Counts of the parts of a file that could not be read. All are 0 for an intact file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
#[doc(alias("damage", "partial", "truncated"))]
pub struct MissingParts {
    /// Number of missing Gaussians.
    pub gaussians: u32,
    /// Number of missing groups.
    pub groups: u32,
    /// Number of groups in the whole file.
    pub of_groups: u32,
    /// Number of missing tiles of the detail layer and the exact layer.
    pub tiles: u32,
    /// Number of tiles of both layers in the whole file.
    pub of_tiles: u32,
    /// Number of missing tiles of the exact layer, which [`tiles`](Self::tiles) includes.
    pub exact_tiles: u32,
    /// Number of tiles of the exact layer in the whole file, which [`of_tiles`](Self::of_tiles) includes.
    pub of_exact_tiles: u32,
    /// Whether the file is truncated or its checksum does not match, even if the whole picture could be read.
    pub damaged: bool,
}

/// Appends the payload. `header` is the checksum of the header.
pub(crate) fn put(splats: &PackedSplats, header: u32, out: &mut Vec<u8>) -> Result<()> {
    let channels = splats.channels.count();
    let start = out.len();
    let book = sorted_codebook(splats);
    let group = Group::new(splats, book.as_deref())?;
    put_color(&splats.background[..channels], out);
    if let Some(book) = &book {
        put_codebook(book, channels, out);
    }
    let levels = levels(splats);
    put_varint(levels.len() as u64, out);
    levels.iter().for_each(|&n| put_varint(n.into(), out));
    let mut sorted = splats.gaussians.clone();
    let parts = parts(&mut sorted, &levels, &group.rules, out);
    let streams = parallel::map(parts.len(), |i| {
        let (region, part) = parts[i];
        let mut encoder = Encoder::default();
        group.code(&mut encoder, region, Some(part), part.len() as u32).map(|_| encoder.finish())
    });
    let streams = streams.into_iter().collect::<Result<Vec<_>, Broken>>()?;
    for (stream, (_, part)) in streams.iter().zip(&parts) {
        put_varint(stream.len() as u64, out);
        out.push(largest(part));
        out.extend_from_slice(&hash(stream).to_le_bytes());
    }
    let directory = directory_checksum(header, &out[start..]);
    out.extend_from_slice(&directory.to_le_bytes());
    streams.iter().for_each(|s| out.extend_from_slice(s));
    Ok(())
}

/// Returns the number of Gaussians of each level.
pub(super) fn levels(splats: &PackedSplats) -> Vec<u32> {
    if splats.levels.is_empty() { vec![splats.gaussians.len() as u32] } else { splats.levels.clone() }
}

/// Sorts the Gaussians of `levels` into the order of the file and returns its groups. Appends the divisions.
pub(super) fn parts<'a>(
    gaussians: &'a mut [PackedGaussian],
    levels: &[u32],
    rules: &Rules,
    out: &mut Vec<u8>,
) -> Vec<(Region, &'a [PackedGaussian])> {
    let mut parts = Vec::new();
    let mut rest = gaussians;
    for &n in levels {
        let (level, tail) = rest.split_at_mut(n as usize);
        rest = tail;
        divide(level, rules, rules.region(), out, &mut parts);
    }
    parts
}

/// Returns the axis along which a region of `count` Gaussians is divided, if it is. Halves stay large enough for the
/// coarsest squares.
fn divided(rules: &Rules, region: &Region, count: u32) -> Option<usize> {
    region.axis().filter(|&axis| count > MAX_GROUP && region.log[axis] > rules.range())
}

/// Divides the Gaussians of a region, records how many stay undivided and how many fall into the lower halves, and
/// sorts the undivided ones.
fn divide<'a>(
    gaussians: &'a mut [PackedGaussian],
    rules: &Rules,
    region: Region,
    out: &mut Vec<u8>,
    parts: &mut Vec<(Region, &'a [PackedGaussian])>,
) {
    if gaussians.is_empty() {
        return;
    }
    let Some(axis) = divided(rules, &region, gaussians.len() as u32) else {
        sort(gaussians, rules, region);
        parts.push((region, gaussians));
        return;
    };
    let narrow = narrow(rules, &region);
    let mut wide = gaussians.iter().filter(|p| p.major > narrow).count();
    if wide < MIN_WIDE_GROUP || region.log[0] != region.log[1] {
        wide = 0;
    }
    let halves = region.halves(axis);
    let upper = |p: &PackedGaussian| rules.place(p, region).corner[axis] >= halves[1].corner[axis];
    gaussians.sort_by_cached_key(|p| (wide == 0 || p.major <= narrow, upper(p)));
    let (wide, rest) = gaussians.split_at_mut(wide);
    let (low, high) = rest.split_at_mut(rest.partition_point(|p| !upper(p)));
    put_varint(wide.len() as u64, out);
    if halves[1].corner[axis] < rules.grid()[axis] {
        put_varint(low.len() as u64, out);
    }
    if !wide.is_empty() {
        sort(wide, rules, region);
        parts.push((region, wide));
    }
    divide(low, rules, halves[0], out, parts);
    divide(high, rules, halves[1], out, parts);
}

/// Returns the largest major scale whose reach is within the limit for the halves of a square region.
fn narrow(rules: &Rules, region: &Region) -> u8 {
    let side = f64::from(rules.finest()).exp2() * (1u64 << region.log[0]) as f64;
    (0..rules.top).take_while(|&major| rules.reach(major + 1) <= MAX_REACH * side).count() as u8
}

fn largest(part: &[PackedGaussian]) -> u8 {
    part.iter().map(|p| p.major).max().unwrap_or(0)
}

/// Reads the divisions of a region of `count` Gaussians.
fn read_divisions(
    bytes: &mut Bytes<'_>,
    rules: &Rules,
    region: Region,
    (level, count): (usize, u32),
    entries: &mut Vec<Entry>,
) -> Result<()> {
    if count == 0 {
        return Ok(());
    }
    let Some(axis) = divided(rules, &region, count) else {
        entries.push(Entry { level, region, count, bytes: 0..0, largest: 0, checksum: 0 });
        return Ok(());
    };
    let halves = region.halves(axis);
    let mut at_most = |most: u32| -> Result<u32> {
        let value = bytes.varint("group size")?;
        Ok(u32::try_from(value).ok().filter(|&n| n <= most).ok_or(Broken { field: "group size", value })?)
    };
    let wide = at_most(count)?;
    let count = count - wide;
    let lower = if halves[1].corner[axis] < rules.grid()[axis] { at_most(count)? } else { count };
    if wide > 0 {
        entries.push(Entry { level, region, count: wide, bytes: 0..0, largest: 0, checksum: 0 });
    }
    read_divisions(bytes, rules, halves[0], (level, lower), entries)?;
    read_divisions(bytes, rules, halves[1], (level, count - lower), entries)
}

/// Reads everything before the groups into `splats` and checks it.
fn read_directory(
    bytes: &mut Bytes<'_>,
    header: &Header,
    checksum: u32,
    splats: &mut PackedSplats,
) -> Result<Vec<Entry>> {
    let (rules, channels, start) = (Rules::of(splats), splats.channels.count(), bytes.taken().len());
    splats.background = read_color(bytes, channels, "background")?;
    if header.coloring == Coloring::Codebook {
        splats.codebook = Some(read_codebook(bytes, channels)?);
    }
    rules.palette(splats)?;
    let count = bytes.varint("level count")?;
    if !(1..=MAX_LEVELS as u64).contains(&count) {
        return Err(Broken { field: "level count", value: count }.into());
    }
    let mut left = header.gaussians;
    for _ in 0..count {
        let value = bytes.varint("level")?;
        let n = u32::try_from(value).ok().filter(|&n| 0 < n && n <= left).ok_or(Broken { field: "level", value })?;
        left -= n;
        splats.levels.push(n);
    }
    if left > 0 || count == 1 && header.gaussians <= MAX_UNGROUPED {
        return Err(Broken { field: "level", value: left.into() }.into());
    }
    let mut entries = Vec::new();
    for (level, &n) in splats.levels.iter().enumerate() {
        read_divisions(bytes, &rules, rules.region(), (level, n), &mut entries)?;
    }
    let mut at = 0;
    for entry in &mut entries {
        let length = bytes.varint("group length")?;
        entry.bytes = at..at.saturating_add(length);
        at = entry.bytes.end;
        entry.largest = bytes.take(1, "largest scale of a group")?[0];
        entry.checksum = bytes.u32("group checksum")?;
        if u64::from(entry.count) > most_gaussians(length) {
            return Err(Broken { field: "Gaussians of a group", value: entry.count.into() }.into());
        }
    }
    let computed = directory_checksum(checksum, &bytes.taken()[start..]);
    let stored = bytes.u32("directory checksum")?;
    if stored != computed {
        return Err(FormatError::Checksum { what: "directory", stored, computed }.into());
    }
    Ok(entries)
}

/// Reads everything before the groups, and returns the bytes of all groups.
pub(crate) fn length(bytes: &mut Bytes<'_>, header: &Header, splats: &mut PackedSplats) -> Result<u64> {
    let entries = read_directory(bytes, header, header.checksum(), splats)?;
    Ok(entries.last().map_or(0, |entry| entry.bytes.end))
}

/// Returns the CRC-32 of the directory, continued from that of the header.
fn directory_checksum(header: u32, directory: &[u8]) -> u32 {
    let mut hasher = Hasher::new();
    hasher.update(&header.to_le_bytes());
    hasher.update(directory);
    hasher.finalize()
}

/// Decodes one group.
fn read_group(stream: &[u8], entry: &Entry, group: &Group<'_>, detail: Detail) -> Result<(Vec<PackedGaussian>, Tally)> {
    let computed = hash(stream);
    if computed != entry.checksum {
        return Err(FormatError::Checksum { what: "group", stored: entry.checksum, computed }.into());
    }
    let mut tally = Tally { detail, ..Tally::default() };
    let gaussians;
    if detail == Detail::Parts && !ONE_READER {
        let mut decoder = Decoder::new(stream)?;
        gaussians = group.code(&mut decoder, entry.region, None, entry.count)?;
        decoder.finish()?;
    } else {
        let mut meter = metered(Decoder::new(stream)?, detail);
        gaussians = group.code(&mut meter, entry.region, None, entry.count)?;
        meter.coder.finish()?;
        tally.add(meter);
    }
    if largest(&gaussians) != entry.largest {
        return Err(Broken { field: "largest scale of a group", value: entry.largest.into() }.into());
    }
    Ok((gaussians, tally))
}

/// Reads the payload into `splats`, or the groups of it that reach into `area`; groups in parallel.
pub(crate) fn read(
    bytes: &mut Bytes<'_>,
    header: &Header,
    area: Option<&Rect>,
    splats: &mut PackedSplats,
    tally: &mut Tally,
) -> Result<()> {
    let start = bytes.left();
    let entries = read_directory(bytes, header, header.checksum(), splats)?;
    tally.part("directory", start - bytes.left());
    let total = entries.last().map_or(0, |e| e.bytes.end);
    let streams = bytes.take(total, "groups")?;
    tally.part("groups", streams.len());
    tally.groups = entries.len() as u32;
    let group = Group::new(splats, splats.codebook.as_deref())?;
    let parts = parallel::map(entries.len(), |i| {
        let e = &entries[i];
        let wanted = area.is_none_or(|area| e.reaches(&group.rules, area));
        let stream = &streams[e.bytes.start as usize..e.bytes.end as usize];
        wanted.then(|| read_group(stream, e, &group, tally.detail)).transpose()
    });
    let parts = parts.into_iter().collect::<Result<Vec<_>>>()?;
    for (_, found) in parts.iter().flatten() {
        found.fields.iter().for_each(|f| tally.field(f.name, f.bits));
        tally.each.extend_from_slice(&found.each);
    }
    gather(&entries, parts.into_iter().map(|part| part.map(|(gaussians, _)| gaussians)), splats);
    Ok(())
}

/// Reads the groups whose bytes are present and intact, and leaves `bytes` after the last group or at the end.
pub(crate) fn read_intact(bytes: &mut Bytes<'_>, header: &Header, splats: &mut PackedSplats) -> Result<MissingParts> {
    let start = bytes.left();
    let entries = read_directory(bytes, header, header.checksum(), splats)?;
    let total = entries.last().map_or(0, |e| e.bytes.end);
    let streams = bytes.take(total.min(bytes.left() as u64), "groups")?;
    let stream = |e: &Entry| {
        let range = usize::try_from(e.bytes.start).ok()?..usize::try_from(e.bytes.end).ok()?;
        streams.get(range)
    };
    // The bound on Gaussians per payload, applied to the bytes that are present, so that many tiny groups cannot
    // claim more in total.
    let there: u64 = entries.iter().filter(|e| stream(e).is_some()).map(|e| u64::from(e.count)).sum();
    if there > most_gaussians((start - bytes.left()) as u64) {
        return Err(Broken { field: "number of Gaussians", value: there }.into());
    }
    let group = Group::new(splats, splats.codebook.as_deref())?;
    let parts = parallel::map(entries.len(), |i| {
        read_group(stream(&entries[i])?, &entries[i], &group, Detail::Parts).ok().map(|(part, _)| part)
    });
    let mut missing = MissingParts { of_groups: entries.len() as u32, ..MissingParts::default() };
    for (entry, _) in entries.iter().zip(&parts).filter(|(_, part)| part.is_none()) {
        missing.groups += 1;
        missing.gaussians += entry.count;
    }
    gather(&entries, parts.into_iter(), splats);
    Ok(missing)
}

/// Collects the Gaussians of the groups that were read in `splats`.
fn gather(entries: &[Entry], parts: impl Iterator<Item = Option<Vec<PackedGaussian>>>, splats: &mut PackedSplats) {
    let mut levels = vec![0u32; MAX_LEVELS];
    let mut gaussians = Vec::new();
    for (entry, part) in entries.iter().zip(parts) {
        if let Some(part) = part {
            levels[entry.level] += entry.count;
            gaussians.extend(part);
        }
    }
    levels.retain(|&n| n > 0);
    splats.levels = if levels.len() > 1 { levels } else { Vec::new() };
    splats.gaussians = gaussians;
}
