//! The planes layout: each field of all Gaussians as byte streams, compressed with zstd (spec §7).

use super::frame;
use super::hilbert::{hilbert, hilbert_point};
use crate::bitstream::broken::Broken;
use crate::bitstream::bytes::{Bytes, put_varint, unzigzag, zigzag};
use crate::bitstream::checksum::Hasher;
use crate::bitstream::header::{Coloring, Header};
use crate::bitstream::palette::{
    index_of, put_codebook, put_color, read_codebook, read_color, sorted_codebook, to_i16,
};
use crate::bitstream::report::Tally;
use crate::bitstream::rules::Rules;
use crate::bitstream::splats::{PackedGaussian, PackedSplats};
use crate::error::{Error, FormatError, Result};

/// Streams in the order of the file, with the number of bytes per Gaussian in each.
const FIELDS: [(&str, usize); 10] = [
    ("position", 8),
    ("x refinement", 2),
    ("y refinement", 2),
    ("major scale", 1),
    ("aspect", 1),
    ("angle", 1),
    ("colour 0", 3),
    ("colour 1", 3),
    ("colour 2", 3),
    ("colour 3", 3),
];

/// Position of a Gaussian: the index of its cell of the coarsest step along the curve, and the finer bits.
struct Curve {
    order: u32,
    grid: [u32; 2],
}

impl Curve {
    fn new(rules: &Rules) -> Self {
        let grid = rules.grid().map(|g| (g - 1 >> rules.range()) + 1);
        Curve { order: u32::BITS - (grid[0].max(grid[1]) - 1).leading_zeros(), grid }
    }
}

/// Returns the number of bits of x and y below the coarsest step.
fn refinement(rules: &Rules, p: &PackedGaussian) -> [u32; 2] {
    rules.logs(p.major, p.minor, p.angle).map(|l| rules.range() - l)
}

/// Returns the values of a Gaussian in the order of [`FIELDS`], with the absolute position.
fn values(p: &PackedGaussian, rules: &Rules, curve: &Curve, book: Option<&[[i16; 4]]>) -> Result<[u64; 10]> {
    let [fx, fy] = refinement(rules, p);
    let mut v = [0; 10];
    v[0] = hilbert(curve.order, p.x >> fx, p.y >> fy);
    v[1] = u64::from(p.x & ((1 << fx) - 1));
    v[2] = u64::from(p.y & ((1 << fy) - 1));
    (v[3], v[4], v[5]) = (p.major.into(), (p.major - p.minor).into(), p.angle.into());
    match book {
        Some(book) => v[6] = index_of(book, p.color)?.into(),
        None => (0..4).for_each(|k| v[6 + k] = zigzag(p.color[k].into())),
    }
    Ok(v)
}

/// Returns the number of colour streams.
fn colors(header_book: bool, channels: usize) -> usize {
    if header_book { 1 } else { channels }
}

/// Appends the payload.
pub(crate) fn put(splats: &PackedSplats, out: &mut Vec<u8>) -> Result<()> {
    let (rules, channels) = (Rules::of(splats), splats.channels.count());
    let book = sorted_codebook(splats);
    put_color(&splats.background[..channels], out);
    if let Some(book) = &book {
        put_codebook(book, channels, out);
    }
    let curve = Curve::new(&rules);
    let mut rows =
        splats.gaussians.iter().map(|p| values(p, &rules, &curve, book.as_deref())).collect::<Result<Vec<_>>>()?;
    rows.sort_unstable();
    let mut last = 0;
    for row in &mut rows {
        (row[0], last) = (row[0] - last, row[0]);
    }
    let count = 6 + colors(book.is_some(), channels);
    let mut checksum = Hasher::new();
    for (k, &(_, most)) in FIELDS.iter().enumerate().take(count) {
        let widest = rows.iter().map(|r| r[k]).max().unwrap_or(0);
        let bytes = (64 - widest.leading_zeros()).div_ceil(8) as usize;
        debug_assert!(bytes <= most);
        out.push(bytes as u8);
        for byte in 0..bytes {
            let plane: Vec<u8> = rows.iter().map(|r| (r[k] >> (8 * byte)) as u8).collect();
            checksum.update(&plane);
            put_plane(&plane, out)?;
        }
    }
    out.extend_from_slice(&checksum.finalize().to_le_bytes());
    Ok(())
}

/// Appends a plane: uncompressed after a 0, or the length of its zstd frame and the frame if that is shorter.
fn put_plane(plane: &[u8], out: &mut Vec<u8>) -> Result<()> {
    if let Some(frame) = frame::compress(plane)? {
        let mut packed = Vec::new();
        put_varint(frame.len() as u64, &mut packed);
        packed.extend_from_slice(&frame);
        if packed.len() <= plane.len() {
            out.extend_from_slice(&packed);
            return Ok(());
        }
    }
    out.push(0);
    out.extend_from_slice(plane);
    Ok(())
}

/// Reads a plane of `count` bytes. Decompression also allocates a window, which is at most twice as large.
fn read_plane(bytes: &mut Bytes<'_>, count: usize, what: &'static str) -> Result<Vec<u8>> {
    let length = bytes.varint(what)?;
    if length == 0 {
        return bytes.take(count as u64, what).map(<[u8]>::to_vec);
    }
    let frame = bytes.take(length, what)?;
    let broken = || Error::from(FormatError::Compression { what });
    frame::outline(frame, count).ok_or_else(broken)?;
    let mut plane = Vec::new();
    plane.try_reserve_exact(count).map_err(|_| broken())?;
    plane.resize(count, 0);
    frame::decompress(frame, &mut plane).ok_or_else(broken)?;
    Ok(plane)
}

/// Reads the payload into `splats`.
pub(crate) fn read(bytes: &mut Bytes<'_>, header: &Header, splats: &mut PackedSplats, tally: &mut Tally) -> Result<()> {
    let (rules, channels) = (Rules::of(splats), splats.channels.count());
    let start = bytes.left();
    splats.background = read_color(bytes, channels, "background")?;
    if header.coloring == Coloring::Codebook {
        splats.codebook = Some(read_codebook(bytes, channels)?);
    }
    tally.part("palette", start - bytes.left());
    rules.palette(splats)?;
    let count = header.gaussians as usize;
    let mut checksum = Hasher::new();
    let mut rows = vec![[0u64; 10]; count];
    let streams = 6 + colors(splats.codebook.is_some(), channels);
    for (k, &(name, most)) in FIELDS.iter().enumerate().take(streams) {
        let start = bytes.left();
        let width = usize::from(bytes.array::<1>(name)?[0]);
        if width > most {
            return Err(Broken { field: "bytes of a field", value: width as u64 }.into());
        }
        let mut widest = 0;
        for byte in 0..width {
            let plane = read_plane(bytes, count, name)?;
            checksum.update(&plane);
            for (row, value) in rows.iter_mut().zip(plane) {
                row[k] |= u64::from(value) << (8 * byte);
                widest |= row[k];
            }
        }
        if width > 0 && widest >> (8 * (width - 1)) == 0 {
            return Err(Broken { field: "bytes of a field", value: width as u64 }.into());
        }
        tally.part(name, start - bytes.left());
        tally.field(name, 8.0 * (start - bytes.left()) as f64);
    }
    // Libraries may decode a broken frame differently, so the checksum covers the uncompressed planes.
    let computed = checksum.finalize();
    let stored = bytes.u32("checksum of the planes")?;
    if stored != computed {
        return Err(FormatError::Checksum { what: "planes", stored, computed }.into());
    }
    tally.part("checksum of the planes", size_of_val(&stored));
    let curve = Curve::new(&rules);
    splats.gaussians.reserve_exact(count);
    let mut last: Option<[u64; 10]> = None;
    for mut row in rows {
        row[0] = row[0].checked_add(last.map_or(0, |l| l[0])).ok_or(Broken { field: "position", value: row[0] })?;
        if last.is_some_and(|l| l > row) {
            return Err(Broken { field: "order of Gaussians", value: splats.gaussians.len() as u64 }.into());
        }
        last = Some(row);
        splats.gaussians.push(gaussian(&row, &rules, &curve, splats.codebook.as_deref())?);
    }
    Ok(())
}

fn gaussian(v: &[u64; 10], rules: &Rules, curve: &Curve, book: Option<&[[i16; 4]]>) -> Result<PackedGaussian> {
    if v[0] >> (2 * curve.order) != 0 {
        return Err(Broken { field: "position", value: v[0] }.into());
    }
    let (cx, cy) = hilbert_point(curve.order, v[0]);
    if cx >= curve.grid[0] || cy >= curve.grid[1] {
        return Err(Broken { field: "position", value: v[0] }.into());
    }
    let (major, angle) = (v[3] as u8, v[5] as u16);
    let minor = major.checked_sub(v[4] as u8).ok_or(Broken { field: "aspect", value: v[4] })?;
    rules.shape(major, minor, angle)?;
    let color = match book {
        Some(book) => *book.get(v[6] as usize).ok_or(Broken { field: "codebook index", value: v[6] })?,
        None => {
            let mut color = [0; 4];
            for (k, c) in color.iter_mut().enumerate() {
                *c = to_i16("colour", unzigzag(v[6 + k]))?;
            }
            color
        }
    };
    let mut p = PackedGaussian { x: 0, y: 0, major, minor, angle, color };
    let [fx, fy] = refinement(rules, &p);
    if v[1] >> fx != 0 || v[2] >> fy != 0 {
        return Err(Broken { field: "refinement", value: v[1] | v[2] }.into());
    }
    (p.x, p.y) = (cx << fx | v[1] as u32, cy << fy | v[2] as u32);
    rules.gaussian(&p)?;
    Ok(p)
}
