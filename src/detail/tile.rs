//! Converts the levels of a tile to additions to the samples of its pixels (spec §11.5).

use super::lap::{self, Edges, PITCH};
use super::steps::PlaneSteps;
use super::supers::Supers;
use super::transform::{self, Coefficient};
use crate::bitstream::detail::head::DetailHead;
use crate::bitstream::detail::levels::{CELL, SUPER, SUPERS, TILE, TileLevels};
use crate::bitstream::detail::model::PLANES;
use crate::gaussian::Channels;
use crate::simd::{self, LANES, Simd, Task};

/// Unit of additions, as a part of an 8-bit code value.
pub(crate) const UNIT: f32 = 1.0 / 32.0;

/// Additions of a tile by channel, in 1/32 of an 8-bit code value.
#[derive(Debug, Clone, Default)]
pub(crate) struct TilePlanes {
    /// The samples of each channel in strips of [`LANES`] columns, from left to right, of [`ROOM`] rows each. A
    /// renderer reads a strip at a time, whose rows are adjacent in memory.
    channels: Vec<Vec<StripRow>>,
    /// The superblocks that have additions.
    filled: Supers,
}

/// A row of a strip.
pub(crate) type StripRow = [i16; LANES];

/// Rows of a strip in memory. The unused ones prevent that the same row of all strips lies in the same set of the
/// processor's cache.
const ROOM: usize = TILE + 4;

/// Bytes of the additions of one channel.
pub(crate) const CHANNEL_BYTES: usize = TILE / LANES * ROOM * size_of::<StripRow>();

/// Strips of a superblock.
const STRIPS: usize = SUPER / LANES;

/// Reusable working memory of [`reconstruct`].
#[derive(Debug, Default)]
pub(crate) struct Scratch {
    /// Two rows of superblocks of each plane. Nothing more is needed at a time, so the strips stay in the cache.
    strips: [[Vec<i32>; 2]; PLANES],
    coefficients: Vec<Coefficient>,
}

impl TilePlanes {
    /// Tells whether the superblock that contains the pixel at column `x` and row `y` has additions.
    #[inline(always)]
    pub(crate) fn has(&self, x: usize, y: usize) -> bool {
        self.filled.has([x / SUPER, y / SUPER])
    }

    /// Returns the number of channels; 0 if no tile has been reconstructed.
    pub(crate) fn channels(&self) -> usize {
        self.channels.len()
    }

    /// Returns the addition to channel `c` of the pixel at column `x` and row `y`.
    #[inline(always)]
    pub(crate) fn value(&self, c: usize, [x, y]: [usize; 2]) -> i16 {
        self.channels[c][x / LANES * ROOM + y][x % LANES]
    }

    /// Returns the additions to channel `c` of the pixels in row `y` from column `x` on.
    #[inline(always)]
    pub(crate) fn row(&self, c: usize, [x, y]: [usize; 2]) -> impl Iterator<Item = i16> {
        let channel = &self.channels[c];
        (x..TILE).map(move |x| channel[x / LANES * ROOM + y][x % LANES])
    }

    /// Returns `count` rows of the strip that contains column `x`, from row `y` on, in channel `c`.
    #[inline(always)]
    pub(crate) fn strip(&self, c: usize, [x, y]: [usize; 2], count: usize) -> &[StripRow] {
        &self.channels[c][x / LANES * ROOM + y..][..count]
    }

    /// Allocates the channels and records the superblocks that the caller is about to write.
    fn begin(&mut self, filled: Supers, channels: Channels) {
        self.channels.resize_with(channels.count(), Vec::new);
        for channel in &mut self.channels {
            make(channel, TILE / LANES * ROOM);
            // Clear the superblocks that had additions before and have none now.
            for y in 0..SUPERS {
                for x in self.filled.without(filled).row(y) {
                    for strip in x * STRIPS..(x + 1) * STRIPS {
                        channel[strip * ROOM + y * SUPER..][..SUPER].fill([0; LANES]);
                    }
                }
            }
        }
        self.filled = filled;
    }
}

struct Reconstruct<'a> {
    tile: &'a TileLevels,
    head: &'a DetailHead,
    channels: Channels,
    /// Width and height, pixels.
    size: [usize; 2],
    wanted: Supers,
    scratch: &'a mut Scratch,
    out: &'a mut TilePlanes,
}

/// Computes the additions of a tile of this size.
pub(crate) fn reconstruct(
    tile: &TileLevels,
    layer: (&DetailHead, Channels, [usize; 2]),
    scratch: &mut Scratch,
    out: &mut TilePlanes,
) {
    reconstruct_some(tile, layer, Supers::ALL, scratch, out);
}

/// Reconstructs the superblocks in `wanted`; the others hold arbitrary values.
pub(crate) fn reconstruct_some(
    tile: &TileLevels,
    (head, channels, size): (&DetailHead, Channels, [usize; 2]),
    wanted: Supers,
    scratch: &mut Scratch,
    out: &mut TilePlanes,
) {
    simd::dispatch(Reconstruct { tile, head, channels, size, wanted, scratch, out });
}

/// Cells along the side of a superblock.
const STEP: usize = SUPER / CELL;

/// Row of a superblock in which a plane is zero.
const NOTHING: [i32; SUPER] = [0; SUPER];

impl Task for Reconstruct<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, _: S) {
        let Reconstruct { tile, head, channels, size, wanted, scratch, out } = self;
        let [across, down] = size.map(|side| side.div_ceil(SUPER));
        // Only blocks that reach into the wanted superblocks are transformed.
        let mut filled = [Supers::NONE; PLANES];
        for block in &tile.blocks {
            let reached = Supers::reached(block);
            if reached.meets(wanted) {
                let filled = &mut filled[usize::from(block.plane) % PLANES];
                *filled = filled.with(reached);
            }
        }
        let all = filled.iter().fold(Supers::NONE, |all, &filled| all.with(filled));
        out.begin(all, channels);
        let mut edges = [Edges::NONE; PLANES];
        let mut blocks = Blocks { head, tile, wanted, next: 0, start: 0 };
        for row in 0..=down {
            if row < down {
                for (strips, filled) in scratch.strips.iter_mut().zip(filled) {
                    if filled.row(row).next().is_some() {
                        make(&mut strips[row % 2], SUPER * PITCH);
                    }
                }
                blocks.transform(row, &mut edges, scratch);
                for plane in 0..PLANES {
                    if filled[plane].row(row).next().is_some() {
                        join_rows(row, &edges[plane], &mut scratch.strips[plane]);
                    }
                }
            }
            // A row of superblocks is complete once it has been joined to the one below.
            if let Some(row) = row.checked_sub(1) {
                finish(row, across, (tile, &filled, &edges), scratch, out);
            }
        }
    }
}

/// The blocks of a tile, row by row of superblocks.
struct Blocks<'a> {
    head: &'a DetailHead,
    tile: &'a TileLevels,
    wanted: Supers,
    /// Index of the next block, and of its first level.
    next: usize,
    start: usize,
}

impl Blocks<'_> {
    /// Transforms the blocks of a row of superblocks into its strip.
    #[inline(always)]
    fn transform(&mut self, row: usize, edges: &mut [Edges; PLANES], Scratch { strips, coefficients }: &mut Scratch) {
        let tile = self.tile;
        while let Some(block) = tile.blocks.get(self.next)
            && usize::from(block.cell[1]) / STEP == row
        {
            let levels = &tile.levels[self.start..block.end as usize];
            (self.next, self.start) = (self.next + 1, block.end as usize);
            if !Supers::reached(block).meets(self.wanted) {
                continue;
            }
            let [x, y] = block.cell.map(usize::from);
            let class = tile.classes.get(row * SUPERS + x / STEP).copied().unwrap_or(0);
            let (plane, side) = (usize::from(block.plane) % PLANES, usize::from(block.size));
            let steps = PlaneSteps::new(self.head, plane, class);
            coefficients.clear();
            for level in levels {
                let value = steps.value(side, level.u.into(), level.v.into(), level.value);
                coefficients.push(Coefficient { u: level.u, v: level.v, value });
            }
            edges[plane].note([x, y], block.size);
            let strip = &mut strips[plane][row % 2];
            transform::inverse(side, coefficients, &mut strip[y % STEP * CELL * PITCH + x * CELL..], PITCH);
        }
    }
}

/// Filters across the horizontal edges in a row of superblocks and at its top.
#[inline(always)]
fn join_rows(row: usize, edges: &Edges, [even, odd]: &mut [Vec<i32>; 2]) {
    let (above, strip) = if row.is_multiple_of(2) { (odd, even) } else { (even, odd) };
    if row > 0 && edges.has(row * STEP) {
        edges.between_rows(row * STEP, &mut above[(SUPER - lap::REACH) * PITCH..], strip);
    }
    for cy in 1..STEP {
        let (above, below) = strip.split_at_mut(cy * CELL * PITCH);
        edges.between_rows(row * STEP + cy, &mut above[(cy * CELL - lap::REACH) * PITCH..], below);
    }
}

/// Filters a row of superblocks across the vertical edges, and converts its planes to channels.
#[inline(always)]
fn finish(
    row: usize,
    across: usize,
    (tile, filled, edges): (&TileLevels, &[Supers; PLANES], &[Edges; PLANES]),
    scratch: &mut Scratch,
    out: &mut TilePlanes,
) {
    for plane in 0..PLANES {
        if filled[plane].row(row).next().is_none() {
            continue;
        }
        let sizes = &tile.sizes[[0, 1, 1, 2][plane]];
        for (cy, rows) in scratch.strips[plane][row % 2].chunks_exact_mut(CELL * PITCH).enumerate() {
            edges[plane].between_columns(row * STEP + cy, rows, sizes, across * STEP);
        }
    }
    for x in out.filled.row(row) {
        // A plane without levels has one row of zeros.
        let mut from: [(&[i32], usize); PLANES] = [(&NOTHING, 0); PLANES];
        for (plane, strips) in scratch.strips.iter().enumerate() {
            if filled[plane].has([x, row]) {
                from[plane] = (&strips[row % 2][x * SUPER..], PITCH);
            }
        }
        for k in 0..STRIPS {
            let from = from.map(|(samples, pitch)| (&samples[k * LANES..], pitch));
            mix(from, &mut out.channels, (x * STRIPS + k) * ROOM + row * SUPER);
        }
        // The superblock is in the cache now.
        for (strips, filled) in scratch.strips.iter_mut().zip(filled) {
            if filled.has([x, row]) {
                clear(&mut strips[row % 2][x * SUPER..]);
            }
        }
    }
}

/// Allocates a plane if it does not exist. The system provides zeroed memory, and maps only the pages that are
/// written.
#[inline(never)]
fn make<T: Copy + Default>(plane: &mut Vec<T>, length: usize) {
    if plane.is_empty() {
        *plane = vec![T::default(); length];
    }
}

/// Clears the superblock at the start of a part of a strip.
#[inline(always)]
fn clear(plane: &mut [i32]) {
    for row in plane.chunks_mut(PITCH).take(SUPER) {
        if let Some(row) = row.first_chunk_mut::<SUPER>() {
            *row = NOTHING;
        }
    }
}

/// Converts the strip of a superblock from planes, whose rows are the given distance apart, to channels; `at` is the
/// first row in `channels`.
#[cfg_attr(target_family = "wasm", inline(never))]
#[cfg_attr(not(target_family = "wasm"), inline(always))]
fn mix([y, orange, green, alpha]: [(&[i32], usize); PLANES], channels: &mut [Vec<StripRow>], at: usize) {
    let rest = match channels {
        [r, g, b, rest @ ..] => {
            let (r, g, b) = (&mut r[at..][..SUPER], &mut g[at..][..SUPER], &mut b[at..][..SUPER]);
            for i in 0..SUPER {
                let (y, o, n) = (part(y, i), part(orange, i), part(green, i));
                let y = sum(y, y);
                let low = difference(y, n);
                (r[i], g[i], b[i]) = (narrow(sum(low, o)), narrow(sum(y, n)), narrow(difference(low, o)));
            }
            rest
        }
        [grey, rest @ ..] => {
            double(&mut grey[at..][..SUPER], y);
            rest
        }
        [] => return,
    };
    if let [out] = rest {
        double(&mut out[at..][..SUPER], alpha);
    }
}

/// Returns the first samples of row `i`.
#[inline(always)]
fn part((plane, pitch): (&[i32], usize), i: usize) -> [i32; LANES] {
    *plane[i * pitch..].first_chunk().expect("a row has whole strips")
}

#[inline(always)]
fn double(out: &mut [StripRow], plane: (&[i32], usize)) {
    for (i, out) in out.iter_mut().enumerate() {
        let v = part(plane, i);
        *out = narrow(sum(v, v));
    }
}

// Arrays are passed by value: the compiler knows that values do not overlap, and makes vector instructions of the
// loops.

#[inline(always)]
fn sum(mut a: [i32; LANES], b: [i32; LANES]) -> [i32; LANES] {
    for i in 0..LANES {
        a[i] = a[i].wrapping_add(b[i]);
    }
    a
}

#[inline(always)]
fn difference(mut a: [i32; LANES], b: [i32; LANES]) -> [i32; LANES] {
    for i in 0..LANES {
        a[i] = a[i].wrapping_sub(b[i]);
    }
    a
}

#[inline(always)]
fn narrow(v: [i32; LANES]) -> StripRow {
    let mut out = [0; LANES];
    for i in 0..LANES {
        out[i] = v[i].clamp(i16::MIN.into(), i16::MAX.into()) as i16;
    }
    out
}
