//! What lies around: sums over the coded primitives of a group, by buckets (spec §8.5).

use super::kd::Place;

/// What is summed over the primitives of a bucket.
pub(crate) const LANES: usize = 16;

/// Where [`LANES`] count primitives.
pub(crate) const COUNT: usize = LANES - 1;

/// From this many primitives on a bucket's sums are halved: later ones count more, and sums stay in 32 bits.
const MANY: i32 = 16;

/// `⌊log₂(5792/(d² + 10))⌋`, a weight as a shift, for the square of a distance in eighths of a bucket, at most 12 along each axis.
const SHIFTS: [u32; 289] = {
    let mut shifts = [0; 289];
    let mut square = 0;
    while square < 289 {
        shifts[square] = (5792 / (square as u32 + 10)).ilog2();
        square += 1;
    }
    shifts
};

/// Buckets of three to five primitives, on average, over a region of cells.
#[derive(Debug)]
pub(crate) struct Buckets {
    /// Logarithms of a bucket's sides, cells.
    log: [u32; 2],
    corner: [u32; 2],
    shape: [usize; 2],
    sums: Vec<[i32; LANES]>,
}

impl Buckets {
    /// Empty buckets for `count` primitives in the `extent` cells from `corner` on.
    pub fn new(count: u32, corner: [u32; 2], extent: [u32; 2]) -> Self {
        let shape_of = |log: [u32; 2]| [0, 1].map(|k| u64::from(extent[k].div_ceil(1 << log[k])).max(1));
        let mut log = [0; 2];
        while log[1] < 30 && shape_of(log)[0] * shape_of(log)[1] > (3 * u64::from(count) / 8).max(1) {
            log[usize::from(log[0] > log[1])] += 1;
        }
        let shape = shape_of(log).map(|s| s as usize);
        Buckets { log, corner, shape, sums: vec![[0; LANES]; shape[0] * shape[1]] }
    }

    /// The bucket of a place along each axis, and where in it the place's middle lies, eighths of its sides.
    fn at(&self, place: &Place) -> [(usize, i32); 2] {
        let half = 1 << place.log.0 >> 1;
        [0, 1].map(|k| {
            let eighths = u64::from(place.corner[k] - self.corner[k] + half) << 3 >> self.log[k];
            // The middle of a square that reaches over the edge may lie outside.
            match (eighths >> 3) as usize {
                bucket if bucket < self.shape[k] => (bucket, (eighths & 7) as i32),
                _ => (self.shape[k] - 1, 7),
            }
        })
    }

    /// Adds a primitive whose lanes are within ±2¹⁶; the last lane is 1.
    pub fn add(&mut self, place: &Place, lanes: &[i32; LANES]) {
        let [(x, _), (y, _)] = self.at(place);
        let sums = &mut self.sums[y * self.shape[0] + x];
        sums.iter_mut().zip(lanes).for_each(|(sum, lane)| *sum += lane);
        if sums[COUNT] >= MANY {
            sums.iter_mut().for_each(|sum| *sum >>= 1);
        }
    }

    /// Sums over the 3 × 3 buckets around `place`, the near ones with larger weights. Nine weights add up to less than
    /// 2¹⁰ and no bucket keeps a sum beyond 2²⁰, so that all stay within 2³⁰.
    pub fn around(&self, place: &Place) -> [i32; LANES] {
        let at = self.at(place);
        // The buckets along each axis and the squares of their distances, eighths.
        let [(left, across), (top, down)] = [0, 1].map(|k| {
            let (bucket, eighths) = at[k];
            let first = bucket.saturating_sub(1);
            let count = (bucket + 2).min(self.shape[k]) - first;
            let squares: [usize; 3] = std::array::from_fn(|i| {
                let away = 8 * ((first + i) as i32 - bucket as i32) + 4 - eighths;
                (away * away) as usize
            });
            (first, (count, squares))
        });
        let mut out = [0; LANES];
        for (y, down) in down.1[..down.0].iter().enumerate() {
            let row = &self.sums[(top + y) * self.shape[0] + left..][..across.0];
            for (sums, across) in row.iter().zip(across.1) {
                let shift = SHIFTS[across + down];
                out.iter_mut().zip(sums).for_each(|(out, sum)| *out += sum << shift);
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use std::cmp::Reverse;

    use super::*;

    #[test]
    fn sums_of_the_largest_values_fit() {
        let mut buckets = Buckets::new(1 << 12, [0, 0], [1 << 10, 1 << 10]);
        let places: Vec<Place> = (0..1 << 10)
            .flat_map(|y| (0..1 << 10).map(move |x| Place { log: Reverse(0), key: 0, corner: [x, y] }))
            .collect();
        for place in &places {
            let mut lanes = [i32::from(i16::MIN); LANES];
            lanes[0] = 1 << 16;
            lanes[COUNT] = 1;
            buckets.add(place, &lanes);
        }
        for place in &places {
            let sums = buckets.around(place);
            assert!(sums[0] > 0 && sums[1] < 0 && sums[COUNT] > 0);
        }
    }
}
