//! Positions: how many centres fall into each half of a cell (spec §8.4).
//!
//! The grid is embedded in a rectangle of powers of two whose longer side is halved until the sides are equal, then x
//! and y in turn. Few centres split as evenly as by chance, whatever lies beside them, so that fixed chances do.

use super::model::Slot;
use super::range::{Coder, Cumulative};
use super::spread::{Bounded, FINE, Gains, Near, log16};
use crate::bitstream::broken::Broken;
use crate::bitstream::region::{Place, Region, Square};

/// Counts up to this many split by a table; larger ones are coded as a distance from the even split.
const SMALL: u32 = 12;

// `STAY` and `CLUMPS` were learnt on the Kodak pictures of odd number by a study before the first release, which is not in the
// repository: they are a part of the format (spec §8.4) and can only change with its version.

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
    stay: [Slot; STAY.len() * CROWDS],
    /// Spread of large counts, by their logarithm.
    large: Gains<1>,
    /// How counts split evenly, for each up to [`SMALL`].
    even: [Binomial; SMALL as usize + 1],
}

/// Chances that `0..=count` of `count` fall into the lower half, added up.
#[derive(Debug, Clone, Copy, Default)]
struct Binomial {
    below: [u32; SMALL as usize + 2],
    total: u32,
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
        Binomial { below, total: below[count as usize + 1] }
    }
}

impl Cumulative for Binomial {
    fn below(&self, value: i32) -> u32 {
        self.below[value as usize]
    }

    fn total(&self) -> u32 {
        self.total
    }

    #[inline]
    fn find(&self, target: u32) -> (i32, [u32; 2]) {
        let mut k = 0;
        while k < SMALL as usize && self.below[k + 1] <= target {
            k += 1;
        }
        (k as i32, [self.below[k], self.below[k + 1]])
    }
}

impl Counts {
    pub fn new() -> Self {
        let stay = std::array::from_fn(|context| {
            // One of so many.
            let (chance, crowd) = (STAY[context / CROWDS], context % CROWDS);
            let none = (0..=crowd).fold(65536, |none, _| none * (256 - chance) >> 8);
            Slot::new((65536 - none).clamp(256, 65280), 6)
        });
        let even = std::array::from_fn(|n| Binomial::new(n as u32, 1 << 15));
        Counts { stay, large: Gains::new(), even }
    }

    /// Codes whether a primitive stays in a square.
    #[inline]
    fn stays<C: Coder>(&mut self, coder: &mut C, context: usize, stays: bool) -> u32 {
        self.stay[context].code(coder, 250, stays.into())
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

/// Parameters that the counts of a group depend on.
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

/// Codes where `count` primitives sit; they come back coarse squares first and along the halves within a size.
///
/// The writer passes the places sorted as [`by_key`] has it; the reader passes none.
pub(crate) fn squares<C: Coder>(
    coder: &mut C,
    counts: &mut Counts,
    extent: &Extent,
    given: &[Place],
    count: u32,
) -> Result<Vec<Square>, Broken> {
    let sizes = vec![Vec::new(); extent.coarsest as usize + 1];
    // The square's side over the spacing, in half octaves.
    let size = |log: usize| ((16 * log as i64 - extent.spacing) / 8 + 12).clamp(0, 23) as usize;
    let mut walk = Walk { coder, counts, extent, contexts: std::array::from_fn(|log| size(log) * CROWDS), sizes };
    if count > 0 {
        walk.node(extent.region, count, given)?;
    }
    let mut out = Vec::with_capacity(count as usize);
    walk.sizes.iter().rev().for_each(|squares| out.extend_from_slice(squares));
    Ok(out)
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
    /// The first context of the decisions in squares of each size.
    contexts: [usize; 32],
    /// The squares so far, by their logarithm.
    sizes: Vec<Vec<Square>>,
}

impl<C: Coder> Walk<'_, C> {
    /// Codes what a region holds. Each call halves it, so that calls nest no deeper than the region has halves.
    fn node(&mut self, mut region: Region, mut count: u32, mut given: &[Place]) -> Result<(), Broken> {
        while count > 1 {
            let stay = self.stay(&region, count, given);
            (count, given) = (count - stay, parted(given, stay).1);
            let Some(axis) = region.axis().filter(|_| count > 0) else { return Ok(()) };
            let inside = region.inside(axis, self.extent.grid);
            region.log[axis] -= 1;
            let middle = region.corner[axis] + (1 << region.log[axis]);
            let mut lower = count;
            if inside[1] > 0 {
                let wanted = given.partition_point(|p| p.corner[axis] < middle);
                lower = self.counts.split(self.coder, count, inside, wanted as u32);
                if lower > count {
                    return Err(Broken { field: "count of a half", value: lower.into() });
                }
            }
            if lower < count {
                let (of_lower, of_upper) = parted(given, lower);
                if lower > 0 {
                    self.node(region, lower, of_lower)?;
                }
                region.corner[axis] = middle;
                (count, given) = (count - lower, of_upper);
            }
        }
        self.lone(&region, given.first())
    }

    /// Codes how many of the primitives of a region stay in it, if it is a square in which they can.
    fn stay(&mut self, region: &Region, count: u32, given: &[Place]) -> u32 {
        let [log, y] = region.log;
        if log != y || log > self.extent.coarsest {
            return 0;
        }
        let mut stay = 0;
        if log == 0 {
            stay = count;
        } else {
            let wanted = given.iter().take_while(|p| p.log.0 == log).count() as u32;
            while stay < count {
                let context = self.contexts[log as usize] + (count - stay - 1).min(CROWDS as u32 - 1) as usize;
                if self.counts.stays(self.coder, context, wanted > stay) == 0 {
                    break;
                }
                stay += 1;
            }
        }
        let square = Square { log, corner: region.corner };
        self.sizes[log as usize].extend(std::iter::repeat_n(square, stay as usize));
        stay
    }

    /// Codes the place of one primitive that has a region for itself: how small its square is, then which.
    fn lone(&mut self, region: &Region, given: Option<&Place>) -> Result<(), Broken> {
        let Region { mut corner, log: [x, y] } = *region;
        let mut log = x.min(y).min(self.extent.coarsest);
        while log > 0 {
            let stays = given.is_some_and(|p| p.log.0 == log);
            if self.counts.stays(self.coder, self.contexts[log as usize], stays) != 0 {
                break;
            }
            log -= 1;
        }
        let wanted = given.map_or([0; 2], |p| [0, 1].map(|k| (p.corner[k] - corner[k]) >> log));
        let square = self.coder.pair([x - log, y - log], wanted);
        for k in 0..2 {
            corner[k] += square[k] << log;
            if corner[k] >= self.extent.grid[k] {
                return Err(Broken { field: ["x", "y"][k], value: corner[k].into() });
            }
        }
        self.sizes[log as usize].push(Square { log, corner });
        Ok(())
    }
}

/// The writer's first `count` places and the rest; a reader has none.
fn parted(given: &[Place], count: u32) -> (&[Place], &[Place]) {
    given.split_at(given.len().min(count as usize))
}
