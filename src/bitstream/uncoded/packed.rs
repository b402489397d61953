//! The packed layout: fixed-size records, tile by tile, which can be read in place (spec §6).

use super::bits::{BitReader, BitWriter, width_of};
use super::hilbert::hilbert;
use crate::bitstream::broken::Broken;
use crate::bitstream::bytes::{Bytes, put_varint};
use crate::bitstream::header::{Coloring, Header};
use crate::bitstream::palette::{
    index_of, put_codebook, put_color, read_codebook, read_color, sorted_codebook, to_i16,
};
use crate::bitstream::report::Tally;
use crate::bitstream::rules::Rules;
use crate::bitstream::splats::{PackedGaussian, PackedSplats};
use crate::error::Result;

/// Maximum number of bits of a position within a tile.
const MAX_TILE_BITS: u32 = 15;

/// Names of a record's fields.
const FIELDS: [&str; 9] = ["x", "y", "major scale", "aspect", "angle", "colour 0", "colour 1", "colour 2", "colour 3"];

/// Division of a record into fields.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Format {
    /// Bits of x, y, major, aspect, angle and of each colour field.
    widths: [u32; 9],
    /// Offset to add to each field when it is read.
    offsets: [i32; 9],
    /// Number of fields.
    fields: usize,
}

impl Format {
    fn bytes(&self) -> usize {
        self.widths[..self.fields].iter().sum::<u32>().div_ceil(8) as usize
    }

    /// Returns the number of tiles along each side.
    fn tiles(&self, grid: [u32; 2]) -> [u64; 2] {
        [0, 1].map(|k| u64::from(grid[k]).div_ceil(1 << self.widths[k]))
    }

    /// Returns the sort key of the records: by tile, then along the curve, then by the other fields.
    fn key(&self, p: &PackedGaussian, grid: [u32; 2]) -> Key {
        let [wx, wy] = [self.widths[0], self.widths[1]];
        let tile = u64::from(p.y >> wy) * self.tiles(grid)[0] + u64::from(p.x >> wx);
        let along = hilbert(wx.max(wy), p.x & ((1 << wx) - 1), p.y & ((1 << wy) - 1));
        (tile, along, p.major, p.minor, p.angle, p.color)
    }
}

type Key = (u64, u64, u8, u8, u16, [i16; 4]);

/// Returns the non-position fields of a Gaussian before offsets are subtracted.
fn values(p: &PackedGaussian, book: Option<&[[i16; 4]]>, channels: usize) -> Result<[i32; 9]> {
    let mut v = [0, 0, p.major.into(), i32::from(p.major - p.minor), p.angle.into(), 0, 0, 0, 0];
    match book {
        Some(book) => v[5] = index_of(book, p.color)? as i32,
        None => (0..channels).for_each(|k| v[5 + k] = p.color[k].into()),
    }
    Ok(v)
}

/// Returns the format with the fewest bytes of records and tile counts; ties are resolved by the smallest, then the
/// narrowest tiles.
fn choose(splats: &PackedSplats, book: Option<&[[i16; 4]]>, grid: [u32; 2]) -> Result<Format> {
    let channels = splats.channels.count();
    let fields = 5 + if book.is_some() { 1 } else { channels };
    let (mut low, mut high) = ([i32::MAX; 9], [i32::MIN; 9]);
    for p in &splats.gaussians {
        for (k, v) in values(p, book, channels)?.into_iter().enumerate() {
            (low[k], high[k]) = (low[k].min(v), high[k].max(v));
        }
    }
    let mut format = Format { widths: [0; 9], offsets: [0; 9], fields };
    for k in 2..fields {
        // Aspect, angle and index start at 0 and have no stored offset.
        format.offsets[k] = if k == 2 || k >= 5 && book.is_none() { low[k] } else { 0 };
        format.widths[k] = width_of((high[k] - format.offsets[k]) as u32);
    }
    let mut best = (u64::MAX, 0, format.clone());
    for wx in 0..=MAX_TILE_BITS {
        for wy in 0..=MAX_TILE_BITS {
            (format.widths[0], format.widths[1]) = (wx, wy);
            let [tx, ty] = format.tiles(grid);
            let bytes = splats.gaussians.len() as u64 * format.bytes() as u64 + tx.saturating_mul(ty);
            if (bytes, wx + wy) < (best.0, best.1) {
                best = (bytes, wx + wy, format.clone());
            }
        }
    }
    Ok(best.2)
}

/// Appends the payload.
pub(crate) fn put(splats: &PackedSplats, out: &mut Vec<u8>) -> Result<()> {
    let (rules, channels) = (Rules::of(splats), splats.channels.count());
    let book = sorted_codebook(splats);
    put_color(&splats.background[..channels], out);
    if let Some(book) = &book {
        put_codebook(book, channels, out);
    }
    if splats.gaussians.is_empty() {
        return Ok(());
    }
    let grid = rules.grid();
    let format = choose(splats, book.as_deref(), grid)?;
    out.extend(format.widths[..format.fields].iter().map(|&w| w as u8));
    out.push(format.offsets[2] as u8);
    if book.is_none() {
        put_color(&std::array::from_fn::<i16, 4, _>(|k| format.offsets[5 + k] as i16)[..channels], out);
    }
    let mut sorted = splats.gaussians.clone();
    sorted.sort_by_cached_key(|p| format.key(p, grid));
    let [tx, ty] = format.tiles(grid);
    let mut counts = vec![0u32; (tx * ty) as usize];
    for p in &sorted {
        counts[format.key(p, grid).0 as usize] += 1;
    }
    for count in counts {
        put_varint(count.into(), out);
    }
    let mut bits = BitWriter::default();
    for p in &sorted {
        let mut v = values(p, book.as_deref(), channels)?;
        v[0] = (p.x & ((1 << format.widths[0]) - 1)) as i32;
        v[1] = (p.y & ((1 << format.widths[1]) - 1)) as i32;
        for k in 0..format.fields {
            bits.put((v[k] - format.offsets[k]) as u32, format.widths[k], out);
        }
        bits.align(out);
    }
    Ok(())
}

/// Reads the payload into `splats`.
pub(crate) fn read(bytes: &mut Bytes<'_>, header: &Header, splats: &mut PackedSplats, tally: &mut Tally) -> Result<()> {
    let (rules, channels) = (Rules::of(splats), splats.channels.count());
    let start = bytes.left();
    splats.background = read_color(bytes, channels, "background")?;
    tally.part("background", start - bytes.left());
    let start = bytes.left();
    if header.coloring == Coloring::Codebook {
        splats.codebook = Some(read_codebook(bytes, channels)?);
        tally.part("codebook", start - bytes.left());
    }
    rules.palette(splats)?;
    let count = header.gaussians as usize;
    if count == 0 {
        return Ok(());
    }
    let start = bytes.left();
    let format = read_format(bytes, splats.codebook.is_some(), channels)?;
    tally.part("record format", start - bytes.left());
    let (grid, start) = (rules.grid(), bytes.left());
    let [tx, ty] = format.tiles(grid);
    let tiles = tx.saturating_mul(ty);
    // A tile's count takes at least one byte and a record all of its bytes, so that no memory is allocated without
    // bytes that back it.
    bytes.clone().take(tiles.saturating_add(count as u64 * format.bytes() as u64), "records")?;
    // The counts are read twice rather than stored, because there can be as many as the file has bytes.
    let mut counts = bytes.clone();
    let mut sum = 0u64;
    for _ in 0..tiles {
        sum = sum.saturating_add(bytes.varint("tile count")?);
    }
    if sum != count as u64 {
        return Err(Broken { field: "sum of tile counts", value: sum }.into());
    }
    tally.part("tile counts", start - bytes.left());
    let records = bytes.take(count as u64 * format.bytes() as u64, "records")?;
    tally.part("records", records.len());
    for k in 0..format.fields {
        tally.field(FIELDS[k], f64::from(format.widths[k]) * count as f64);
    }
    splats.gaussians.reserve_exact(count);
    let mut record = records.chunks(format.bytes().max(1));
    let mut last = None;
    for tile in 0..tiles {
        let n = counts.varint("tile count")?;
        let corner = [tile % tx << format.widths[0], tile / tx << format.widths[1]].map(|c| c as u32);
        for _ in 0..n {
            let p = read_record(record.next().unwrap_or(&[]), &format, splats, corner)?;
            rules.gaussian(&p)?;
            let key = format.key(&p, grid);
            if last > Some(key) {
                return Err(Broken { field: "order of records", value: splats.gaussians.len() as u64 }.into());
            }
            last = Some(key);
            splats.gaussians.push(p);
        }
    }
    if choose(splats, splats.codebook.as_deref(), grid)? != format {
        return Err(Broken { field: "record format", value: 0 }.into());
    }
    Ok(())
}

fn read_format(bytes: &mut Bytes<'_>, codebook: bool, channels: usize) -> Result<Format> {
    let fields = 5 + if codebook { 1 } else { channels };
    let mut format = Format { widths: [0; 9], offsets: [0; 9], fields };
    for (k, width) in format.widths.iter_mut().enumerate().take(fields) {
        *width = bytes.array::<1>("record format")?[0].into();
        if *width > if k < 2 { MAX_TILE_BITS } else { 16 } {
            return Err(Broken { field: "record field width", value: (*width).into() }.into());
        }
    }
    format.offsets[2] = bytes.array::<1>("record format")?[0].into();
    if !codebook {
        let color = read_color(bytes, channels, "record format")?;
        (0..channels).for_each(|k| format.offsets[5 + k] = color[k].into());
    }
    Ok(format)
}

fn read_record(record: &[u8], format: &Format, splats: &PackedSplats, corner: [u32; 2]) -> Result<PackedGaussian> {
    let mut bits = BitReader::new(record);
    let mut v = [0i64; 9];
    for k in 0..format.fields {
        v[k] = i64::from(bits.get(format.widths[k])) + i64::from(format.offsets[k]);
    }
    if bits.get(7) != 0 {
        return Err(Broken { field: "padding of a record", value: 1 }.into());
    }
    let major = u8::try_from(v[2]).map_err(|_| Broken { field: "major scale", value: v[2] as u64 })?;
    let minor = i64::from(major) - v[3];
    let minor = u8::try_from(minor).map_err(|_| Broken { field: "minor scale", value: minor as u64 })?;
    let color = match &splats.codebook {
        Some(book) => *book.get(v[5] as usize).ok_or(Broken { field: "codebook index", value: v[5] as u64 })?,
        None => [to_i16("colour", v[5])?, to_i16("colour", v[6])?, to_i16("colour", v[7])?, to_i16("colour", v[8])?],
    };
    let [x, y] = [0, 1].map(|k| corner[k] + v[k] as u32);
    Ok(PackedGaussian { x, y, major, minor, angle: v[4] as u16, color })
}
