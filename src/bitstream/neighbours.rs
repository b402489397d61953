//! Who is near: the primitives of a group sorted into buckets (spec §8.4).

use super::kd::Place;

/// How many coded primitives of a bucket are looked at: bounds the work where all centres coincide.
const DEPTH: usize = 8;

/// Buckets of one to four primitives, on average, over a region of cells.
#[derive(Debug)]
pub(crate) struct Buckets {
    /// Logarithm of a bucket's side, cells.
    pub log: u32,
    corner: [u32; 2],
    shape: [usize; 2],
    /// Where each bucket starts in a list of the primitives by bucket.
    starts: Vec<u32>,
    /// How many primitives of each bucket have been coded.
    coded: Vec<u32>,
    /// The primitives, bucket by bucket, in order.
    list: Vec<u32>,
}

impl Buckets {
    /// Buckets for all of `places`, of which none is coded yet.
    pub fn new(places: &[Place], corner: [u32; 2], extent: [u32; 2]) -> Self {
        let shape_of = |log: u32| extent.map(|e| u64::from(e.div_ceil(1 << log)).max(1));
        let mut log = 0;
        while log < 30 && shape_of(log)[0] * shape_of(log)[1] > places.len().max(1) as u64 {
            log += 1;
        }
        let shape = shape_of(log).map(|s| s as usize);
        let buckets = shape[0] * shape[1];
        let mut grid = Buckets {
            log,
            corner,
            shape,
            starts: vec![0; buckets + 1],
            coded: vec![0; buckets],
            list: vec![0; places.len()],
        };
        for place in places {
            let bucket = grid.bucket(place);
            grid.starts[bucket + 1] += 1;
        }
        for i in 0..buckets {
            grid.starts[i + 1] += grid.starts[i];
        }
        for (i, place) in (0..).zip(places) {
            let bucket = grid.bucket(place);
            grid.list[(grid.starts[bucket] + grid.coded[bucket]) as usize] = i;
            grid.coded[bucket] += 1;
        }
        grid.coded.fill(0);
        grid
    }

    fn at(&self, place: &Place) -> [usize; 2] {
        // The middle of a square that reaches over the edge may lie outside.
        let half = 1 << place.log.0 >> 1;
        [0, 1].map(|k| (((place.corner[k] - self.corner[k] + half) >> self.log) as usize).min(self.shape[k] - 1))
    }

    fn bucket(&self, place: &Place) -> usize {
        let [x, y] = self.at(place);
        y * self.shape[0] + x
    }

    /// The primitive that follows the last one has been coded.
    pub fn add(&mut self, place: &Place) {
        let bucket = self.bucket(place);
        self.coded[bucket] += 1;
    }

    /// Calls `visit` with coded primitives in the 3 × 3 buckets around `place`, and returns how many primitives these
    /// buckets will hold and how many buckets there are.
    pub fn around(&self, place: &Place, mut visit: impl FnMut(usize)) -> [u32; 2] {
        let [cx, cy] = self.at(place);
        let (mut total, mut buckets) = (0u32, 0);
        for y in cy.saturating_sub(1)..=(cy + 1).min(self.shape[1] - 1) {
            for x in cx.saturating_sub(1)..=(cx + 1).min(self.shape[0] - 1) {
                let bucket = y * self.shape[0] + x;
                let (start, end) = (self.starts[bucket] as usize, self.starts[bucket + 1]);
                total += end - start as u32;
                buckets += 1;
                let coded = start + self.coded[bucket] as usize;
                for &i in &self.list[start.max(coded.saturating_sub(DEPTH))..coded] {
                    visit(i as usize);
                }
            }
        }
        [total, buckets]
    }
}
