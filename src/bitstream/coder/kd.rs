//! Codes positions as the number of centres in each half of a cell (spec §8.4).
//!
//! The grid is embedded in a rectangle whose sides are powers of two. Its longer side is halved until the sides are
//! equal; then x and y alternate. Small numbers of centres split as evenly as at random, whatever their surroundings,
//! so fixed probabilities suffice for them.

use super::model::Slot;
use super::range::{Coder, Cumulative};
use super::spread::{Bounded, FINE, Gains, Near, log16};
use crate::bitstream::broken::Broken;
use crate::bitstream::region::{Place, Region, Square};

/// Largest count whose split is coded with a table; the split of larger counts is coded as a distance from the even
/// split.
const MAX_TABLE_COUNT: u32 = 12;

// `STAY_CHANCES` and `INITIAL_SPREAD` were learnt on the odd-numbered Kodak pictures by a study before the first
// release, which is not in the repository. They are part of the format (spec §8.4) and can only change with its
// version.

/// Initial probability, in 1/256, that a Gaussian that has not stayed in a larger square stays in this one, by the
/// side of the square: entry 12 is the spacing of Gaussians, and a step is half an octave.
const STAY_CHANCES: [u32; 24] =
    [251, 251, 249, 243, 222, 195, 164, 137, 102, 71, 46, 25, 13, 8, 4, 2, 2, 2, 2, 2, 2, 2, 2, 2];

/// Classes of the number of Gaussians in a square, as contexts of whether one stays: one, two, or more.
const COUNT_CLASSES: usize = 3;

/// Binary logarithm of the number of distinct distances from the even split.
const SPLIT_BITS: u32 = 11;

/// Initial spread of a large count relative to its square root; larger than at random.
const INITIAL_SPREAD: i32 = 120;

/// The models of the counts.
#[derive(Debug)]
pub(crate) struct Counts {
    stay: [Slot; STAY_CHANCES.len() * COUNT_CLASSES],
    /// Spreads of large counts, by their logarithm.
    large: Gains<1>,
    /// Distributions of the splits of counts up to [`MAX_TABLE_COUNT`].
    even: [Binomial; MAX_TABLE_COUNT as usize + 1],
}

/// Cumulative distribution of the number of `count` Gaussians in the lower half.
#[derive(Debug, Clone, Copy, Default)]
struct Binomial {
    below: [u32; MAX_TABLE_COUNT as usize + 2],
    total: u32,
}

impl Binomial {
    /// Each Gaussian falls into the lower half with a probability of `lower / 2¹⁶`.
    fn new(count: u32, lower: u32) -> Self {
        let mut chances = [0u32; MAX_TABLE_COUNT as usize + 1];
        chances[0] = 65536;
        for n in 1..=count as usize {
            for k in (0..=n).rev() {
                let more = if k > 0 { chances[k - 1] } else { 0 };
                chances[k] = (u64::from(chances[k]) * u64::from(65536 - lower) + u64::from(more) * u64::from(lower)
                    >> 16) as u32;
            }
        }
        let mut below = [0; MAX_TABLE_COUNT as usize + 2];
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
        while k < MAX_TABLE_COUNT as usize && self.below[k + 1] <= target {
            k += 1;
        }
        (k as i32, [self.below[k], self.below[k + 1]])
    }
}

impl Counts {
    pub(crate) fn new() -> Self {
        let stay = std::array::from_fn(|context| {
            // The probability that one of several Gaussians stays.
            let (chance, class) = (STAY_CHANCES[context / COUNT_CLASSES], context % COUNT_CLASSES);
            let none = (0..=class).fold(65536, |none, _| none * (256 - chance) >> 8);
            Slot::new((65536 - none).clamp(256, 65280), 6)
        });
        let even = std::array::from_fn(|n| Binomial::new(n as u32, 1 << 15));
        Counts { stay, large: Gains::new(), even }
    }

    /// Codes whether a Gaussian stays in a square.
    #[inline]
    fn stays<C: Coder>(&mut self, coder: &mut C, context: usize, stays: bool) -> u32 {
        self.stay[context].code(coder, 250, stays.into())
    }

    /// Codes how many of `n` Gaussians lie in the lower half. `inside` has the number of cells of each half.
    fn split<C: Coder>(&mut self, coder: &mut C, n: u32, inside: [u32; 2], lower: u32) -> u32 {
        if n <= MAX_TABLE_COUNT && inside[0] == inside[1] {
            return coder.choose(&self.even[n as usize], lower as i32) as u32;
        }
        let share = (u64::from(inside[0]) << 16) / (u64::from(inside[0]) + u64::from(inside[1]));
        if n <= MAX_TABLE_COUNT {
            return coder.choose(&Binomial::new(n, share as u32), lower as i32) as u32;
        }
        // The distance from the even split grows with the square root of the count, and more where Gaussians cluster.
        let fine = (n.ilog2() + 1).saturating_sub(SPLIT_BITS);
        let (log, count) = (log16(n.into()), (n >> fine) as i32 + 1);
        let expected = (u64::from(n) * share * FINE as u64 >> 16 >> fine) as i64;
        let class = [n.ilog2() as usize];
        let spread = (log / 2 - 16 * fine as i32).max(0) + INITIAL_SPREAD + self.large.log(&class);
        let near = Near::new(expected, spread);
        let coarse = coder.choose(&Bounded::new(near, 0, count, 64), (lower >> fine) as i32);
        self.large.learn(&class, near.distance(coarse.into()));
        (coarse as u32) << fine | coder.raw(fine, lower & ((1 << fine) - 1))
    }
}

/// Parameters of a group on which the coding of counts depends.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Extent {
    /// Cells of the finest position step in the picture.
    pub grid: [u32; 2],
    /// The group's region of the grid.
    pub region: Region,
    /// Binary logarithm of the largest square in which a Gaussian can stay, in finest cells.
    pub coarsest: u32,
    /// Binary logarithm of the spacing of Gaussians in finest cells, in 1/16.
    pub spacing: i64,
}

/// Codes the positions of `count` Gaussians. They are returned with coarse squares first, and in the order of the
/// halves within a size.
///
/// When writing, the positions must be sorted by [`by_key`]; when reading, there are none.
pub(crate) fn squares<C: Coder>(
    coder: &mut C,
    counts: &mut Counts,
    extent: &Extent,
    given: &[Place],
    count: u32,
) -> Result<Vec<Square>, Broken> {
    let sizes = vec![Vec::new(); extent.coarsest as usize + 1];
    // The side of the square relative to the spacing, in half octaves.
    let size = |log: usize| ((16 * log as i64 - extent.spacing) / 8 + 12).clamp(0, 23) as usize;
    let mut walk =
        Walk { coder, counts, extent, contexts: std::array::from_fn(|log| size(log) * COUNT_CLASSES), sizes };
    if count > 0 {
        walk.node(extent.region, count, given)?;
    }
    let mut out = Vec::with_capacity(count as usize);
    walk.sizes.iter().rev().for_each(|squares| out.extend_from_slice(squares));
    Ok(out)
}

/// The order in which positions are written: Gaussians that stay in a square come before those in its halves.
pub(crate) fn by_key(place: &Place, region: &Region) -> (u64, std::cmp::Reverse<u32>) {
    let below = 2 * place.log.0;
    debug_assert!(below <= region.key_bits());
    (place.key << below, place.log)
}

struct Walk<'a, C> {
    coder: &'a mut C,
    counts: &'a mut Counts,
    extent: &'a Extent,
    /// The first context of the decisions, by the size of the square.
    contexts: [usize; 32],
    /// The squares found so far, by their binary logarithm.
    sizes: Vec<Vec<Square>>,
}

impl<C: Coder> Walk<'_, C> {
    /// Codes the contents of a region. Each call halves the region, which bounds the depth of the recursion.
    fn node(&mut self, mut region: Region, mut count: u32, mut given: &[Place]) -> Result<(), Broken> {
        while count > 1 {
            let stay = self.stay(&region, count, given);
            (count, given) = (count - stay, split_places(given, stay).1);
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
                let (of_lower, of_upper) = split_places(given, lower);
                if lower > 0 {
                    self.node(region, lower, of_lower)?;
                }
                region.corner[axis] = middle;
                (count, given) = (count - lower, of_upper);
            }
        }
        self.single(&region, given.first())
    }

    /// Codes how many Gaussians of a region stay in it, if it is a square in which they can stay.
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
                let context = self.contexts[log as usize] + (count - stay - 1).min(COUNT_CLASSES as u32 - 1) as usize;
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

    /// Codes the position of a Gaussian that is alone in its region: the size of its square, then which square.
    fn single(&mut self, region: &Region, given: Option<&Place>) -> Result<(), Broken> {
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

/// Splits off the first `count` positions when writing; there are none when reading.
fn split_places(given: &[Place], count: u32) -> (&[Place], &[Place]) {
    given.split_at(given.len().min(count as usize))
}
