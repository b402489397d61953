//! Sums over the already coded neighbours of a position, kept in buckets of a group (spec §8.5).

use crate::bitstream::region::Square;

/// Number of sums in a bucket: fourteen, and two that stay 0 and fill the vector registers.
pub(crate) const LANES: usize = 16;

/// Position in [`LANES`] of the number of Gaussians.
pub(crate) const COUNT: usize = LANES - 1;

/// Number of Gaussians at which the sums of a bucket are halved, so that later Gaussians have more weight and sums
/// fit into 32 bits.
const MAX_BUCKET_COUNT: i32 = 16;

/// `⌊log₂(5792/(d² + 10))⌋`, a weight as a shift, of the 3 × 3 surrounding buckets, indexed by the eighths along y and
/// x of a position in its bucket; `d` is the distance to the centre of a bucket in eighths.
static SHIFTS: [[[[u8; 3]; 3]; 8]; 8] = {
    let mut shifts = [[[[0; 3]; 3]; 8]; 8];
    let mut i = 0;
    while i < 8 * 8 * 3 * 3 {
        let (y, x, down, across) = (i / 72, i / 9 % 8, i / 3 % 3, i % 3);
        let away = [8 * down as i32 - 4 - y as i32, 8 * across as i32 - 4 - x as i32];
        shifts[y][x][down][across] = (5792 / (away[0] * away[0] + away[1] * away[1] + 10)).ilog2() as u8;
        i += 1;
    }
    shifts
};

/// Buckets of three to five Gaussians on average, over a region of cells.
#[derive(Debug)]
pub(crate) struct Buckets {
    /// Binary logarithms of the sides of a bucket, in cells.
    log: [u32; 2],
    corner: [u32; 2],
    shape: [usize; 2],
    /// Buckets row by row, with an empty bucket before each row and after the last one, and an empty row above and
    /// below.
    sums: Vec<[i32; LANES]>,
}

/// Position of the middle of a square: a bucket along each axis, and eighths of the bucket's sides.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Spot {
    bucket: [usize; 2],
    eighths: [usize; 2],
}

impl Buckets {
    /// Returns empty buckets for `count` Gaussians in the `extent` cells from `corner` on.
    pub(crate) fn new(count: u32, corner: [u32; 2], extent: [u32; 2]) -> Self {
        let shape_of = |log: [u32; 2]| [0, 1].map(|k| u64::from(extent[k].div_ceil(1 << log[k])).max(1));
        let mut log = [0; 2];
        while log[1] < 30 && shape_of(log)[0] * shape_of(log)[1] > (3 * u64::from(count) / 8).max(1) {
            log[usize::from(log[0] > log[1])] += 1;
        }
        let shape = shape_of(log).map(|s| s as usize);
        Buckets { log, corner, shape, sums: vec![[0; LANES]; (shape[0] + 1) * (shape[1] + 2) + 1] }
    }

    /// Returns the position of the middle of a square.
    #[inline]
    pub(crate) fn spot(&self, square: &Square) -> Spot {
        let half = 1 << square.log >> 1;
        let eighths = [0, 1].map(|k| {
            let eighths = u64::from(square.corner[k] - self.corner[k] + half) << 3 >> self.log[k];
            // The middle of a square that extends beyond the edge may lie outside.
            eighths.min(8 * self.shape[k] as u64 - 1) as usize
        });
        Spot { bucket: eighths.map(|e| e >> 3), eighths: eighths.map(|e| e & 7) }
    }

    /// Adds a Gaussian whose lanes are within ±2¹⁶; the last lane is 1.
    #[inline]
    pub(crate) fn add(&mut self, spot: &Spot, lanes: &[i32; LANES]) {
        let [x, y] = spot.bucket;
        let sums = &mut self.sums[(y + 1) * (self.shape[0] + 1) + x + 1];
        sums.iter_mut().zip(lanes).for_each(|(sum, lane)| *sum += lane);
        if sums[COUNT] >= MAX_BUCKET_COUNT {
            sums.iter_mut().for_each(|sum| *sum >>= 1);
        }
    }

    /// Returns weighted sums over the 3 × 3 surrounding buckets, with larger weights for near ones. Nine weights add
    /// up to less than 2¹⁰ and the sums of a bucket stay below 2²⁰, so that the results stay below 2³⁰.
    #[inline(always)]
    pub(crate) fn around(&self, spot: &Spot) -> [i32; LANES] {
        let [x, y] = spot.bucket;
        let shifts = &SHIFTS[spot.eighths[1]][spot.eighths[0]];
        let mut out = [0; LANES];
        for (down, shifts) in shifts.iter().enumerate() {
            let three = &self.sums[(y + down) * (self.shape[0] + 1) + x..][..3];
            for (sums, shift) in three.iter().zip(shifts) {
                out.iter_mut().zip(sums).for_each(|(out, sum)| *out += sum << shift);
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nine_weights_add_up_to_less_than_1024() {
        for shifts in SHIFTS.as_flattened() {
            assert!(shifts.as_flattened().iter().map(|shift| 1 << shift).sum::<u32>() < 1 << 10, "{shifts:?}");
        }
    }

    #[test]
    fn sums_of_the_largest_values_fit() {
        let mut buckets = Buckets::new(1 << 12, [0, 0], [1 << 10, 1 << 10]);
        let spots: Vec<Spot> = (0..1 << 10)
            .flat_map(|y| (0..1 << 10).map(move |x| Square { log: 0, corner: [x, y] }))
            .map(|square| buckets.spot(&square))
            .collect();
        for spot in &spots {
            let mut lanes = [i32::from(i16::MIN); LANES];
            lanes[0] = 1 << 16;
            lanes[COUNT] = 1;
            buckets.add(spot, &lanes);
        }
        for spot in &spots {
            let sums = buckets.around(spot);
            assert!(sums[0] > 0 && sums[1] < 0 && sums[COUNT] > 0);
        }
    }
}
