//! Positions: how many centres fall into each half of a cell, level by level (spec §8.3).
//!
//! The grid is embedded in a rectangle of powers of two whose longer side is halved until the sides are equal, then x
//! and y in turn. A level is coded before the next, so that the counts on both sides of a cell tell where its own lie.

use super::model::{Field, SIGNED_NODES};
use super::range::Coder;
use super::rules::Broken;

/// Counts up to this many have a tree of their own; larger ones are coded as a distance from the even split.
const SMALL: u32 = 12;

/// A part of the grid: corner and the logarithms of the sides, in cells.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Region {
    pub corner: [u32; 2],
    pub log: [u32; 2],
}

impl Region {
    /// The rectangle of powers of two around the whole grid, no side below `2^least`.
    pub fn whole(grid: [u32; 2], least: u32) -> Self {
        Region { corner: [0, 0], log: grid.map(|g| (u32::BITS - (g - 1).leading_zeros()).max(least)) }
    }

    /// The axis that is halved next, or `None` for a single cell.
    pub fn axis(&self) -> Option<usize> {
        match self.log {
            [0, 0] => None,
            [x, y] => Some(usize::from(x < y)),
        }
    }

    /// The lower and the upper half.
    pub fn halves(&self, axis: usize) -> [Region; 2] {
        let (mut low, mut high) = (*self, *self);
        low.log[axis] -= 1;
        high.log[axis] -= 1;
        high.corner[axis] += 1 << high.log[axis];
        [low, high]
    }

    /// Bits that [`Region::key`] has.
    pub fn key_bits(&self) -> u32 {
        self.log[0] + self.log[1]
    }

    /// The place of a primitive in the square of `2^log` cells that holds `cell`.
    pub fn place(&self, cell: [u32; 2], log: u32) -> Place {
        let (mut region, mut key) = (*self, 0);
        while region.log != [log; 2] {
            let Some(axis) = region.axis() else { break };
            let upper = (cell[axis] - region.corner[axis]) >> (region.log[axis] - 1) & 1;
            region = region.halves(axis)[upper as usize];
            key = key << 1 | u64::from(upper);
        }
        Place { log: std::cmp::Reverse(log), key, corner: region.corner }
    }

    /// Cells of the grid in each half along `axis`.
    fn inside(&self, axis: usize, grid: [u32; 2]) -> [u32; 2] {
        self.halves(axis).map(|h| grid[axis].saturating_sub(h.corner[axis]).min(1 << h.log[axis]))
    }
}

/// First opinion, in 1/256, that a primitive which has not stayed in a larger square stays in this one, by the square's
/// side: 12 is the primitives' spacing, a step is half an octave.
const STAY: [u32; 24] = [251, 251, 249, 243, 222, 195, 164, 137, 102, 71, 46, 25, 13, 8, 4, 2, 2, 2, 2, 2, 2, 2, 2, 2];

/// The chance, in 1/65536, that one of `tries` succeeds where each has `chance / 256`.
fn some(chance: u32, tries: u32) -> u32 {
    65536 - (0..tries.max(1)).fold(65536, |none, _| (none * (256 - chance) >> 8).max(256))
}

/// The models of the counts.
#[derive(Debug)]
pub(crate) struct Counts {
    small: Field<2>,
    large: Field<2>,
    pub stay: Field<2>,
}

/// A cell of some level and what it holds.
#[derive(Debug, Clone, Copy)]
struct Node {
    region: Region,
    key: u64,
    /// Place of its first primitive in the writer's list.
    start: u32,
    count: u32,
    around: Around,
}

/// What is known around a cell: classes of the counts beside it.
#[derive(Debug, Clone, Copy)]
struct Around {
    /// `0..=6`: which side along the halved axis is fuller; 3 when even.
    slope: usize,
    /// `0..=3`: how full the four neighbours are.
    density: usize,
    /// `0..=7`: how many primitives there are here and beside, as a number of bits.
    crowd: usize,
}

impl Default for Around {
    fn default() -> Self {
        Around { slope: 3, density: 0, crowd: 7 }
    }
}

impl Counts {
    pub fn new() -> Self {
        let small = (SMALL as usize + 1) * 16;
        let mut counts = Counts {
            small: Field::new(1, [small * 2, small * 8 * 4], 250),
            large: Field::new(SIGNED_NODES, [16, 7], 250),
            stay: Field::new(1, [24 * 24, 24 * 16], 250),
        };
        for (size, &chance) in STAY.iter().enumerate() {
            for full in 0..8u32 {
                for stay in 0..3u32 {
                    let context = (size * 8 + full as usize) * 3 + stay as usize;
                    counts.stay.set(0, context, 0, some(chance, full.saturating_sub(stay) / (stay + 1)), 6);
                }
                for crowd in 0..2 {
                    counts.stay.set(1, (size * 8 + full as usize) * 2 + crowd, 0, some(chance, 1 + crowd as u32), 4);
                }
            }
        }
        // Centres that keep their distance split more evenly than by chance; chance is where to start.
        for n in 1..=SMALL {
            for node in 1..16 {
                if let Some((one, _)) = even_chance(n, node) {
                    for (k, contexts) in [2, 32].into_iter().enumerate() {
                        for context in 0..contexts {
                            let at = small_context(n, node, context, contexts);
                            counts.small.set(k, at, 0, one, 30);
                        }
                    }
                }
            }
        }
        counts
    }

    /// Codes how many of `n` lie in the lower half.
    fn split<C: Coder>(&mut self, coder: &mut C, n: u32, inside: [u32; 2], around: Around, lower: u32) -> i64 {
        let partial = inside[1] < inside[0];
        if n > SMALL {
            let expected = (u64::from(n) * u64::from(inside[0]) / u64::from(inside[0] + inside[1])) as u32;
            let fine = (n.ilog2() / 2).saturating_sub(1);
            let distance = lower as i32 - expected as i32;
            let context = [n.ilog2().min(15) as usize, around.slope];
            let coarse = self.large.signed(coder, &context, distance >> fine);
            let rest = coder.raw(fine, distance as u32 & ((1 << fine) - 1));
            return i64::from(expected) + (i64::from(coarse) << fine) + i64::from(rest);
        }
        let part = if partial { 7 } else { 0 };
        let slope = if partial { 7 } else { around.slope };
        let (mut low, mut high, mut node) = (0, n + 1, 1);
        while high - low > 1 {
            let middle = low + (high - low) / 2;
            let contexts = [
                small_context(n, node, usize::from(part > 0), 2),
                small_context(n, node, slope * 4 + around.density, 32),
            ];
            let bit = self.small.bit(coder, &contexts, 0, u32::from(lower >= middle));
            if bit != 0 {
                low = middle;
            } else {
                high = middle;
            }
            node = node << 1 | bit;
        }
        low.into()
    }
}

fn small_context(n: u32, node: u32, context: usize, contexts: usize) -> usize {
    (n as usize * 16 + node as usize) * contexts + context
}

/// The chance of a 1 at `node` of the tree over `0..=n` when each of `n` goes either way alone, and the node's middle.
fn even_chance(n: u32, node: u32) -> Option<(u32, u32)> {
    let (mut low, mut high) = (0, n + 1);
    let depth = node.ilog2();
    for i in (0..depth).rev() {
        if high - low <= 1 {
            return None;
        }
        let middle = low + (high - low) / 2;
        if node >> i & 1 != 0 { low = middle } else { high = middle }
    }
    if high - low <= 1 {
        return None;
    }
    let middle = low + (high - low) / 2;
    let ways = |from: u32, to: u32| (from..to).map(|k| (0..k).fold(1u32, |c, i| c * (n - i) / (i + 1))).sum::<u32>();
    Some((65536 * ways(middle, high) / ways(low, high), middle))
}

/// Where a primitive sits: the square of `2^log` finest cells a side that is as coarse as its position step.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Place {
    /// Coarse squares first.
    pub log: std::cmp::Reverse<u32>,
    /// The halves that lead there.
    pub key: u64,
    pub corner: [u32; 2],
}

/// What the counts of a group depend on.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Extent {
    /// Cells of the finest position step in the picture.
    pub grid: [u32; 2],
    /// The group's part of it.
    pub region: Region,
    /// Logarithm of the largest square in which a primitive can stay, finest cells.
    pub coarsest: u32,
    /// Logarithm of the primitives' spacing, finest cells, in 1/16.
    pub spacing: i64,
}

/// Codes where `count` primitives sit, coarse squares first and by key within a size.
///
/// The writer passes the places sorted by `(key, log)` as [`by_key`] has it; the reader passes none.
pub(crate) fn places<C: Coder>(
    coder: &mut C,
    counts: &mut Counts,
    extent: &Extent,
    sorted: Option<&[Place]>,
    count: u32,
) -> Result<Vec<Place>, Broken> {
    let mut out = Vec::with_capacity(count as usize);
    let mut region = extent.region;
    let mut level = vec![Node { region, key: 0, start: 0, count, around: Around::default() }];
    if count == 0 {
        return Ok(out);
    }
    let corner = region.corner;
    let shape = [0, 1].map(|k| u64::from((extent.grid[k] - corner[k]).min(1 << region.log[k])));
    loop {
        // While squares are not many more than primitives, their neighbours are looked up; later they keep what was seen.
        let shape = [0, 1].map(|k| shape[k].div_ceil(1 << region.log[k]) as usize);
        let axis = region.axis();
        if shape[0] as u64 * shape[1] as u64 <= 4 * u64::from(count) + 64 {
            look_around(&mut level, corner, shape, axis.unwrap_or(0));
        }
        let mut walk = Walk { coder, counts, extent, sorted };
        if region.log[0] == region.log[1] && region.log[0] <= extent.coarsest {
            for node in &mut level {
                let stay = if axis.is_none() { node.count } else { walk.stay(node) };
                let place = Place { log: std::cmp::Reverse(region.log[0]), key: node.key, corner: node.region.corner };
                out.extend((0..stay).map(|_| place));
                node.count -= stay;
                node.start += stay;
            }
        }
        let Some(axis) = axis else { return Ok(out) };
        let mut next = Vec::with_capacity(2 * level.len());
        for node in level.iter().filter(|n| n.count > 0) {
            next.extend(walk.split(node, axis)?.into_iter().filter(|h| h.count > 0));
        }
        level = next;
        region.log[axis] -= 1;
    }
}

/// The order in which a writer passes places: what stays in a square comes before what is in its halves.
pub(crate) fn by_key(place: &Place, region: &Region) -> (u64, std::cmp::Reverse<u32>) {
    let below = 2 * place.log.0;
    debug_assert!(below <= region.key_bits());
    (place.key << below, place.log)
}

struct Walk<'a, C> {
    coder: &'a mut C,
    counts: &'a mut Counts,
    extent: &'a Extent,
    sorted: Option<&'a [Place]>,
}

impl<C: Coder> Walk<'_, C> {
    /// The writer's places in a node.
    fn inside(&self, node: &Node) -> Option<&[Place]> {
        self.sorted.map(|s| &s[node.start as usize..(node.start + node.count) as usize])
    }

    /// Codes how many primitives of a square stay in it.
    fn stay(&mut self, node: &Node) -> u32 {
        let log = node.region.log[0];
        let wanted = self.inside(node).map_or(0, |p| p.iter().take_while(|p| p.log.0 == log).count()) as u32;
        // The square's side over the spacing, in half octaves.
        let size = ((16 * i64::from(log) - self.extent.spacing) / 8 + 12).clamp(0, 23) as usize;
        let full = node.count.min(7) as usize;
        let mut stay = 0;
        while stay < node.count {
            let contexts = [
                (size * 8 + full) * 3 + stay.min(2) as usize,
                (size * 8 + node.around.crowd) * 2 + usize::from(node.count > 1),
            ];
            if self.counts.stay.bit(self.coder, &contexts, 0, u32::from(wanted > stay)) == 0 {
                break;
            }
            stay += 1;
        }
        stay
    }

    fn split(&mut self, node: &Node, axis: usize) -> Result<[Node; 2], Broken> {
        let [low, high] = node.region.halves(axis);
        let inside = node.region.inside(axis, self.extent.grid);
        let n = node.count;
        let mut lower = n;
        if inside[1] > 0 {
            let wanted = self.inside(node).map_or(0, |p| p.partition_point(|p| p.corner[axis] < high.corner[axis]));
            let coded = self.counts.split(self.coder, n, inside, node.around, wanted as u32);
            lower = u32::try_from(coded)
                .ok()
                .filter(|&l| l <= n)
                .ok_or(Broken { field: "count of a half", value: coded as u64 })?;
        }
        let (key, around) = (node.key << 1, node.around);
        Ok([
            Node { region: low, key, start: node.start, count: lower, around },
            Node { region: high, key: key | 1, start: node.start + lower, count: n - lower, around },
        ])
    }
}

/// Sets what each node of a level sees around it; `axis` is the one that is halved next.
fn look_around(level: &mut [Node], corner: [u32; 2], shape: [usize; 2], axis: usize) {
    let mut table = vec![0u32; shape[0] * shape[1]];
    let place = |r: Region| [0, 1].map(|k| ((r.corner[k] - corner[k]) >> r.log[k]) as usize);
    for node in level.iter() {
        let [x, y] = place(node.region);
        table[y * shape[0] + x] = node.count;
    }
    for node in level {
        let at = place(node.region);
        let beside = |k: usize, step: isize| -> u32 {
            let mut other = at;
            match other[k].checked_add_signed(step) {
                Some(v) if v < shape[k] => other[k] = v,
                _ => return node.count,
            }
            table[other[1] * shape[0] + other[0]]
        };
        let sides = u64::from(beside(1 - axis, -1)) + u64::from(beside(1 - axis, 1));
        node.around = around(node.count, beside(axis, -1), beside(axis, 1), sides);
    }
}

fn around(n: u32, before: u32, behind: u32, sides: u64) -> Around {
    let (n, a, b) = (i64::from(n), i64::from(before), i64::from(behind));
    let slope = match 8 * (b - a) / (a + b + n) {
        i64::MIN..=-4 => 0,
        -3..=-2 => 1,
        -1 => 2,
        0 => 3,
        1 => 4,
        2..=3 => 5,
        _ => 6,
    };
    let around = a + b + sides as i64;
    let density = match around / n {
        0..=1 => 0,
        2 => 1,
        3..=4 => 2,
        _ => 3,
    };
    let crowd = (64 - (around as u64 * 2 + n as u64).leading_zeros()).min(7) as usize;
    Around { slope, density, crowd }
}
