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
    /// The rectangle of powers of two around the whole grid.
    pub fn whole(grid: [u32; 2]) -> Self {
        Region { corner: [0, 0], log: grid.map(|g| u32::BITS - (g - 1).leading_zeros()) }
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

    /// The halves that lead to a cell, the first one in the highest bit.
    pub fn key(&self, cell: [u32; 2]) -> u64 {
        let (mut region, mut key) = (*self, 0);
        while let Some(axis) = region.axis() {
            region.log[axis] -= 1;
            key = key << 1 | u64::from((cell[axis] - self.corner[axis]) >> region.log[axis] & 1);
        }
        key
    }

    /// Cells of the grid in each half along `axis`.
    fn inside(&self, axis: usize, grid: [u32; 2]) -> [u32; 2] {
        self.halves(axis).map(|h| grid[axis].saturating_sub(h.corner[axis]).min(1 << h.log[axis]))
    }
}

/// The models of the counts.
#[derive(Debug)]
pub(crate) struct Counts {
    small: Field<3>,
    large: Field<2>,
}

/// A cell of some level and what it holds.
#[derive(Debug, Clone, Copy)]
struct Node {
    region: Region,
    count: u32,
}

/// What is known around a cell: classes of the counts beside it.
#[derive(Debug, Clone, Copy, Default)]
struct Around {
    /// `0..=6`: which side along the halved axis is fuller; 3 when even.
    slope: usize,
    /// `0..=3`: how full the four neighbours are.
    density: usize,
}

impl Counts {
    pub fn new() -> Self {
        let small = (SMALL as usize + 1) * 16;
        let mut counts = Counts {
            small: Field::new(1, [small * 2, small * 8 * 4, small * 8], 250),
            large: Field::new(SIGNED_NODES, [16, 7], 250),
        };
        // Centres that keep their distance split more evenly than by chance; chance is where to start.
        for n in 1..=SMALL {
            for node in 1..16 {
                if let Some((one, _)) = even_chance(n, node) {
                    for (k, contexts) in [2, 32, 8].into_iter().enumerate() {
                        for context in 0..contexts {
                            let at = small_context(n, node, context, contexts);
                            counts.small.set(k, at, 0, one, if k == 0 { 6 } else { 1 });
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
                small_context(n, node, slope, 8),
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

/// Codes the cells of `count` primitives in `region` of the grid, in the order of their keys.
///
/// The writer passes the cells sorted by key; the reader passes none and gets them.
pub(crate) fn cells<C: Coder>(
    coder: &mut C,
    counts: &mut Counts,
    grid: [u32; 2],
    region: Region,
    sorted: Option<&[[u32; 2]]>,
    count: u32,
) -> Result<Vec<[u32; 2]>, Broken> {
    let mut walk = Walk { coder, counts, grid, sorted, out: Vec::new() };
    walk.out.reserve_exact(count as usize);
    let mut level = vec![Node { region, count }];
    if count == 0 {
        return Ok(walk.out);
    }
    // While the cells are not many more than the primitives, whole levels at a time, with the neighbours in sight.
    let mut log = region.log;
    loop {
        let here = Region { corner: region.corner, log };
        let Some(axis) = here.axis() else { break };
        let shape =
            [0, 1].map(|k| u64::from((grid[k] - region.corner[k]).min(1 << region.log[k])).div_ceil(1 << log[k]));
        if shape[0] * shape[1] > 4 * u64::from(count) + 64 {
            break;
        }
        level = walk.level(&level, region.corner, shape.map(|s| s as usize), axis)?;
        log[axis] -= 1;
    }
    for node in level {
        walk.descend(node)?;
    }
    Ok(walk.out)
}

struct Walk<'a, C> {
    coder: &'a mut C,
    counts: &'a mut Counts,
    grid: [u32; 2],
    sorted: Option<&'a [[u32; 2]]>,
    out: Vec<[u32; 2]>,
}

impl<C: Coder> Walk<'_, C> {
    /// How many of the writer's `cells` lie in the lower half.
    fn lower(cells: Option<&[[u32; 2]]>, axis: usize, upper: Region) -> u32 {
        cells.map_or(0, |c| c.partition_point(|p| p[axis] < upper.corner[axis]) as u32)
    }

    fn split(&mut self, node: Node, axis: usize, around: Around, start: usize) -> Result<[Node; 2], Broken> {
        let [low, high] = node.region.halves(axis);
        let inside = node.region.inside(axis, self.grid);
        let n = node.count;
        let mut lower = n;
        if inside[1] > 0 {
            let cells = self.sorted.map(|s| &s[start..start + n as usize]);
            let count = Self::lower(cells, axis, high);
            let coded = self.counts.split(self.coder, n, inside, around, count);
            lower = u32::try_from(coded)
                .ok()
                .filter(|&l| l <= n)
                .ok_or(Broken { field: "count of a cell", value: coded as u64 })?;
        }
        Ok([Node { region: low, count: lower }, Node { region: high, count: n - lower }])
    }

    fn level(&mut self, nodes: &[Node], corner: [u32; 2], shape: [usize; 2], axis: usize) -> Result<Vec<Node>, Broken> {
        let mut table = vec![0u32; shape[0] * shape[1]];
        let place = |r: Region| [0, 1].map(|k| ((r.corner[k] - corner[k]) >> r.log[k]) as usize);
        for node in nodes {
            let [x, y] = place(node.region);
            table[y * shape[0] + x] = node.count;
        }
        let mut next = Vec::with_capacity(2 * nodes.len());
        let mut start = 0;
        for &node in nodes {
            let at = place(node.region);
            let beside = |k: usize, step: isize| -> u32 {
                let mut other = at;
                match other[k].checked_add_signed(step) {
                    Some(v) if v < shape[k] => other[k] = v,
                    _ => return node.count,
                }
                table[other[1] * shape[0] + other[0]]
            };
            let (before, behind) = (beside(axis, -1), beside(axis, 1));
            let sides = beside(1 - axis, -1) + beside(1 - axis, 1);
            let halves = self.split(node, axis, around(node.count, before, behind, sides), start)?;
            start += node.count as usize;
            next.extend(halves.into_iter().filter(|h| h.count > 0));
        }
        Ok(next)
    }

    /// The rest of a node's levels, depth first.
    fn descend(&mut self, node: Node) -> Result<(), Broken> {
        let Some(axis) = node.region.axis() else {
            self.out.extend((0..node.count).map(|_| node.region.corner));
            return Ok(());
        };
        let start = self.out.len();
        if node.count == 1 {
            let cell = self.alone(node.region, self.sorted.map(|s| s[start]));
            self.out.push(cell);
            return Ok(());
        }
        let around = Around { slope: 3, density: 0 };
        for half in self.split(node, axis, around, start)? {
            if half.count > 0 {
                self.descend(half)?;
            }
        }
        Ok(())
    }

    /// One primitive's way down: bits as they are, but for halves outside the grid.
    fn alone(&mut self, mut region: Region, cell: Option<[u32; 2]>) -> [u32; 2] {
        while let Some(axis) = region.axis() {
            let halves = region.halves(axis);
            let upper = cell.is_some_and(|c| c[axis] >= halves[1].corner[axis]);
            let inside = region.inside(axis, self.grid)[1] > 0;
            let bit = if inside { self.coder.raw(1, upper.into()) } else { 0 };
            region = halves[bit as usize];
        }
        region.corner
    }
}

fn around(n: u32, before: u32, behind: u32, sides: u32) -> Around {
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
    let density = match (a + b + i64::from(sides)) / n {
        0..=1 => 0,
        2 => 1,
        3..=4 => 2,
        _ => 3,
    };
    Around { slope, density }
}
