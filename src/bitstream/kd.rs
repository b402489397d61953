//! Positions: how many centres fall into each half of a cell (spec §8.4).
//!
//! The grid is embedded in a rectangle of powers of two whose longer side is halved until the sides are equal, then x
//! and y in turn. Few centres split as evenly as by chance, whatever lies beside them, so that fixed chances do.

use super::model::Field;
use super::range::{Coder, Cumulative};
use super::rules::Broken;
use super::spread::{Bounded, FINE, Gains, Near, log16};

/// Counts up to this many split by a table; larger ones are coded as a distance from the even split.
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

/// How many primitives a square has, as the chance to stay depends on it: one, two, or more.
const CROWDS: usize = 3;

/// Logarithm of the most values that a distance from the even split is told apart by.
const SPLIT_BITS: u32 = 11;

/// Spread of a large count over its root before anything is learnt: more than by chance.
const CLUMPS: i32 = 120;

/// The models of the counts.
#[derive(Debug)]
pub(crate) struct Counts {
    stay: Field,
    /// Spread of large counts, by their logarithm.
    large: Gains<1>,
    /// How counts split evenly, for each up to [`SMALL`].
    even: [Binomial; SMALL as usize + 1],
}

/// Chances that `0..=count` of `count` fall into the lower half, added up.
#[derive(Debug, Clone, Copy, Default)]
struct Binomial {
    below: [u32; SMALL as usize + 2],
    count: u32,
}

impl Binomial {
    /// Each goes to the lower half with a chance of `lower / 2¹⁶`.
    fn new(count: u32, lower: u32) -> Self {
        let mut chances = [0u32; SMALL as usize + 1];
        chances[0] = 65536;
        for n in 1..=count as usize {
            for k in (0..=n).rev() {
                let more = if k > 0 { chances[k - 1] } else { 0 };
                chances[k] = (u64::from(chances[k]) * u64::from(65536 - lower) + u64::from(more) * u64::from(lower)
                    >> 16) as u32;
            }
        }
        let mut below = [0; SMALL as usize + 2];
        for k in 0..=count as usize {
            below[k + 1] = below[k] + chances[k] + 1;
        }
        Binomial { below, count }
    }
}

impl Cumulative for Binomial {
    fn below(&self, value: i32) -> u32 {
        self.below[value as usize]
    }

    fn total(&self) -> u32 {
        self.below[self.count as usize + 1]
    }

    fn find(&self, target: u32) -> (i32, u32, u32) {
        let k = self.below[1..=self.count as usize].iter().take_while(|&&end| end <= target).count();
        (k as i32, self.below[k], self.below[k + 1])
    }
}

impl Counts {
    pub fn new() -> Self {
        let mut stay = Field::new(1, STAY.len() * CROWDS, 250);
        for (size, &chance) in STAY.iter().enumerate() {
            for crowd in 0..CROWDS {
                // One of so many.
                let none = (0..=crowd).fold(65536, |none, _| none * (256 - chance) >> 8);
                stay.set(size * CROWDS + crowd, 0, (65536 - none).clamp(256, 65280), 6);
            }
        }
        let even = std::array::from_fn(|n| Binomial::new(n as u32, 1 << 15));
        Counts { stay, large: Gains::new([32]), even }
    }

    /// Codes how many of `n` lie in the lower half; `inside` are the cells of the halves.
    fn split<C: Coder>(&mut self, coder: &mut C, n: u32, inside: [u32; 2], lower: u32) -> u32 {
        if n <= SMALL && inside[0] == inside[1] {
            return coder.choose(&self.even[n as usize], lower as i32) as u32;
        }
        let share = (u64::from(inside[0]) << 16) / (u64::from(inside[0]) + u64::from(inside[1]));
        if n <= SMALL {
            return coder.choose(&Binomial::new(n, share as u32), lower as i32) as u32;
        }
        // The distance from the even split grows with the root of the count, and more where they crowd.
        let fine = (n.ilog2() + 1).saturating_sub(SPLIT_BITS);
        let (log, count) = (log16(n.into()), (n >> fine) as i32 + 1);
        let expected = (u64::from(n) * share * FINE as u64 >> 16 >> fine) as i64;
        let class = [n.ilog2() as usize];
        let spread = (log / 2 - 16 * fine as i32).max(0) + CLUMPS + self.large.log(&class);
        let near = Near::new(expected, spread);
        let coarse = coder.choose(&Bounded::new(near, 0, count, 64), (lower >> fine) as i32);
        self.large.learn(&class, near.distance(coarse.into()));
        (coarse as u32) << fine | coder.raw(fine, lower & ((1 << fine) - 1))
    }
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

/// Codes where `count` primitives sit; they come back coarse squares first and by key within a size.
///
/// The writer passes the places sorted as [`by_key`] has it; the reader passes none.
pub(crate) fn places<C: Coder>(
    coder: &mut C,
    counts: &mut Counts,
    extent: &Extent,
    sorted: Option<&[Place]>,
    count: u32,
) -> Result<Vec<Place>, Broken> {
    let sizes = vec![Vec::new(); extent.coarsest as usize + 1];
    let mut walk = Walk { coder, counts, extent, sizes };
    if count > 0 {
        walk.node(Node { region: extent.region, key: 0, count, sorted })?;
    }
    let mut out = Vec::with_capacity(count as usize);
    walk.sizes.iter().rev().for_each(|places| out.extend_from_slice(places));
    Ok(out)
}

/// The order in which a writer passes places: what stays in a square comes before what is in its halves.
pub(crate) fn by_key(place: &Place, region: &Region) -> (u64, std::cmp::Reverse<u32>) {
    let below = 2 * place.log.0;
    debug_assert!(below <= region.key_bits());
    (place.key << below, place.log)
}

/// A part of the region, what it holds, and the writer's places in it.
#[derive(Debug, Clone, Copy)]
struct Node<'a> {
    region: Region,
    key: u64,
    count: u32,
    sorted: Option<&'a [Place]>,
}

struct Walk<'a, C> {
    coder: &'a mut C,
    counts: &'a mut Counts,
    extent: &'a Extent,
    /// The places so far, by the logarithm of their squares.
    sizes: Vec<Vec<Place>>,
}

impl<C: Coder> Walk<'_, C> {
    /// Codes what a region holds. Each call halves it, so that calls nest no deeper than the key has bits.
    fn node(&mut self, mut node: Node<'_>) -> Result<(), Broken> {
        if node.count == 1 {
            return self.lone(&node);
        }
        let [x, y] = node.region.log;
        if x == y && x <= self.extent.coarsest {
            let stay = self.stay(&node);
            let place = Place { log: std::cmp::Reverse(x), key: node.key, corner: node.region.corner };
            self.sizes[x as usize].extend((0..stay).map(|_| place));
            node.count -= stay;
            node.sorted = node.sorted.map(|s| &s[stay as usize..]);
        }
        let Some(axis) = node.region.axis().filter(|_| node.count > 0) else { return Ok(()) };
        let halves = node.region.halves(axis);
        let inside = node.region.inside(axis, self.extent.grid);
        let mut lower = node.count;
        if inside[1] > 0 {
            let wanted = node.sorted.map_or(0, |s| s.partition_point(|p| p.corner[axis] < halves[1].corner[axis]));
            lower = self.counts.split(self.coder, node.count, inside, wanted as u32);
            if lower > node.count {
                return Err(Broken { field: "count of a half", value: lower.into() });
            }
        }
        let sorted = [node.sorted.map(|s| &s[..lower as usize]), node.sorted.map(|s| &s[lower as usize..])];
        for (half, count) in [(0, lower), (1, node.count - lower)] {
            if count > 0 {
                let key = node.key << 1 | half as u64;
                self.node(Node { region: halves[half], key, count, sorted: sorted[half] })?;
            }
        }
        Ok(())
    }

    /// The context of a square's decisions.
    fn context(&self, log: u32, count: u32) -> usize {
        // The square's side over the spacing, in half octaves.
        let size = ((16 * i64::from(log) - self.extent.spacing) / 8 + 12).clamp(0, 23) as usize;
        size * CROWDS + (count as usize - 1).min(CROWDS - 1)
    }

    /// Codes how many primitives of a square stay in it.
    fn stay(&mut self, node: &Node<'_>) -> u32 {
        let log = node.region.log[0];
        if log == 0 {
            return node.count;
        }
        let wanted = node.sorted.map_or(0, |s| s.iter().take_while(|p| p.log.0 == log).count()) as u32;
        let mut stay = 0;
        while stay < node.count {
            let context = self.context(log, node.count - stay);
            if self.counts.stay.bit(self.coder, context, 0, u32::from(wanted > stay)) == 0 {
                break;
            }
            stay += 1;
        }
        stay
    }

    /// Codes the place of one primitive that has a region for itself: how small its square is, then which.
    fn lone(&mut self, node: &Node<'_>) -> Result<(), Broken> {
        let given = node.sorted.map(|s| s[0]);
        let [x, y] = node.region.log;
        let mut log = x.min(y).min(self.extent.coarsest);
        while log > 0 {
            let context = self.context(log, 1);
            if self.counts.stay.bit(self.coder, context, 0, u32::from(given.is_some_and(|p| p.log.0 == log))) != 0 {
                break;
            }
            log -= 1;
        }
        let mut corner = node.region.corner;
        let wanted = given.map_or([0; 2], |p| [0, 1].map(|k| (p.corner[k] - corner[k]) >> log));
        let square = self.coder.pair([x - log, y - log], wanted);
        for k in 0..2 {
            corner[k] += square[k] << log;
            if corner[k] >= self.extent.grid[k] {
                return Err(Broken { field: ["x", "y"][k], value: corner[k].into() });
            }
        }
        let key = node.key << (x + y - 2 * log) | interleaved(square, [x - log, y - log]);
        self.sizes[log as usize].push(Place { log: std::cmp::Reverse(log), key, corner });
        Ok(())
    }
}

/// The halves that lead to a square, of so many along each axis.
fn interleaved(square: [u32; 2], mut bits: [u32; 2]) -> u64 {
    let mut key = 0;
    while bits != [0, 0] {
        let axis = usize::from(bits[0] < bits[1]);
        bits[axis] -= 1;
        key = key << 1 | u64::from(square[axis] >> bits[axis] & 1);
    }
    key
}
