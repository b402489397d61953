//! Converts the levels of a tile to additions to the samples of its pixels (spec §11.5).

use super::lap::{self, Edges};
use super::steps::PlaneSteps;
use super::supers::Supers;
use super::transform::{self, Coefficient};
use crate::bitstream::detail::head::DetailHead;
use crate::bitstream::detail::levels::{CELL, SUPER, SUPERS, TILE, TileLevels};
use crate::bitstream::detail::model::PLANES;
use crate::gaussian::Channels;
use crate::simd::{self, Simd, Task};

/// Unit of additions, as a part of an 8-bit code value.
pub(crate) const UNIT: f32 = 1.0 / 32.0;

/// Additions of a tile by channel, in 1/32 of an 8-bit code value. Rows are [`TILE`] apart.
#[derive(Debug, Clone, Default)]
pub(crate) struct TilePlanes {
    pub channels: Vec<Vec<i16>>,
    /// The superblocks that have additions.
    filled: Supers,
}

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

    /// Allocates the channels and records the superblocks that the caller is about to write.
    fn begin(&mut self, filled: Supers, channels: Channels) {
        self.channels.resize_with(channels.count(), Vec::new);
        for channel in &mut self.channels {
            make(channel, TILE * TILE);
            // Clear the superblocks that had additions before and have none now.
            for y in 0..SUPERS {
                self.filled.without(filled).row(y).for_each(|x| clear(&mut channel[(y * TILE + x) * SUPER..]));
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
                    for x in filled.row(row) {
                        make(&mut strips[row % 2], SUPER * TILE);
                        clear(&mut strips[row % 2][x * SUPER..]);
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
            transform::inverse(side, coefficients, &mut strip[y % STEP * CELL * TILE + x * CELL..], TILE);
        }
    }
}

/// Filters across the horizontal edges in a row of superblocks and at its top.
#[inline(always)]
fn join_rows(row: usize, edges: &Edges, [even, odd]: &mut [Vec<i32>; 2]) {
    let (above, strip) = if row.is_multiple_of(2) { (odd, even) } else { (even, odd) };
    if row > 0 && edges.has(row * STEP) {
        edges.between_rows(row * STEP, &mut above[(SUPER - lap::REACH) * TILE..], strip);
    }
    for cy in 1..STEP {
        let (above, below) = strip.split_at_mut(cy * CELL * TILE);
        edges.between_rows(row * STEP + cy, &mut above[(cy * CELL - lap::REACH) * TILE..], below);
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
        for (cy, rows) in scratch.strips[plane][row % 2].chunks_exact_mut(CELL * TILE).enumerate() {
            edges[plane].between_columns(row * STEP + cy, rows, sizes, across * STEP);
        }
    }
    for x in out.filled.row(row) {
        let mut from = [&[] as &[i32]; PLANES];
        for plane in 0..PLANES {
            if filled[plane].has([x, row]) {
                from[plane] = &scratch.strips[plane][row % 2][x * SUPER..];
            }
        }
        for i in 0..SUPER {
            let line = |plane: usize| from[plane].get(i * TILE..).and_then(|line| line.first_chunk()).unwrap_or(&NOTHING);
            mix([line(0), line(1), line(2), line(3)], &mut out.channels, (row * SUPER + i) * TILE + x * SUPER);
        }
    }
}

/// Allocates a plane if it does not exist. The system provides zeroed memory, and maps only the pages that are
/// written.
fn make<T: Copy + Default>(plane: &mut Vec<T>, length: usize) {
    if plane.is_empty() {
        *plane = vec![T::default(); length];
    }
}

/// Clears the superblock at the start of a part of a plane.
#[inline(always)]
fn clear<T: Copy + Default>(plane: &mut [T]) {
    for row in plane.chunks_mut(TILE).take(SUPER) {
        if let Some(row) = row.first_chunk_mut::<SUPER>() {
            *row = [T::default(); SUPER];
        }
    }
}

/// Converts a row of a superblock from planes to channels; `at` is its first index in `channels`.
///
/// The length of a row is known to the compiler, which makes vector instructions of it.
#[cfg_attr(target_family = "wasm", inline(never))]
#[cfg_attr(not(target_family = "wasm"), inline(always))]
fn mix([y, orange, green, alpha]: [&[i32; SUPER]; PLANES], channels: &mut [Vec<i16>], at: usize) {
    let rest = match channels {
        [r, g, b, rest @ ..] => {
            let (r, g, b) = (row_at(r, at), row_at(g, at), row_at(b, at));
            for i in 0..SUPER {
                let (y, o, n) = (y[i].wrapping_mul(2), orange[i], green[i]);
                let low = y.wrapping_sub(n);
                r[i] = narrow(low.wrapping_add(o));
                g[i] = narrow(y.wrapping_add(n));
                b[i] = narrow(low.wrapping_sub(o));
            }
            rest
        }
        [grey, rest @ ..] => {
            double(row_at(grey, at), y);
            rest
        }
        [] => return,
    };
    if let [out] = rest {
        double(row_at(out, at), alpha);
    }
}

/// Returns the row of a superblock that starts at `at`.
#[inline(always)]
fn row_at(channel: &mut [i16], at: usize) -> &mut [i16; SUPER] {
    channel[at..].first_chunk_mut().expect("a tile has whole superblocks")
}

#[inline(always)]
fn double(out: &mut [i16; SUPER], plane: &[i32; SUPER]) {
    for i in 0..SUPER {
        out[i] = narrow(plane[i].wrapping_mul(2));
    }
}

#[inline(always)]
fn narrow(v: i32) -> i16 {
    v.clamp(i16::MIN.into(), i16::MAX.into()) as i16
}
