//! Who is near: primitives already coded, found through a grid of buckets (spec §8.4).

/// How many of the latest primitives of a bucket are looked at: bounds the work where all centres coincide.
const DEPTH: usize = 6;

const NONE: u32 = u32::MAX;

/// Buckets of about two primitives over a region of cells.
#[derive(Debug)]
pub(crate) struct Buckets {
    /// Logarithm of a bucket's side, cells.
    log: u32,
    corner: [u32; 2],
    shape: [usize; 2],
    /// Latest primitive of each bucket.
    heads: Vec<u32>,
    /// The one before in the same bucket.
    next: Vec<u32>,
    /// How many primitives each bucket will hold in the end.
    totals: Vec<u32>,
}

impl Buckets {
    /// Buckets for all of `cells`, of which none is coded yet.
    pub fn new(cells: &[[u32; 2]], corner: [u32; 2], extent: [u32; 2]) -> Self {
        let area = u64::from(extent[0]) * u64::from(extent[1]);
        let mut log = 0;
        while log < 30 && area >> (2 * log) > (cells.len() as u64 / 2).max(1) {
            log += 1;
        }
        let shape = extent.map(|e| e.div_ceil(1 << log).max(1) as usize);
        let buckets = shape[0] * shape[1];
        let mut grid =
            Buckets { log, corner, shape, heads: vec![NONE; buckets], next: Vec::new(), totals: vec![0; buckets] };
        for &cell in cells {
            let bucket = grid.bucket(cell);
            grid.totals[bucket] += 1;
        }
        grid.next.reserve_exact(cells.len());
        grid
    }

    fn place(&self, cell: [u32; 2]) -> [usize; 2] {
        [0, 1].map(|k| ((cell[k] - self.corner[k]) >> self.log) as usize)
    }

    fn bucket(&self, cell: [u32; 2]) -> usize {
        let [x, y] = self.place(cell);
        y * self.shape[0] + x
    }

    /// The primitive that follows the last one has been coded.
    pub fn add(&mut self, cell: [u32; 2]) {
        let bucket = self.bucket(cell);
        self.next.push(self.heads[bucket]);
        self.heads[bucket] = self.next.len() as u32 - 1;
    }

    /// Calls `visit` with coded primitives in the 3 × 3 buckets around `cell`, and returns how many primitives these
    /// buckets will hold and how many buckets there are.
    pub fn around(&self, cell: [u32; 2], mut visit: impl FnMut(usize)) -> [u32; 2] {
        let [cx, cy] = self.place(cell);
        let (mut total, mut buckets) = (0u32, 0);
        for y in cy.saturating_sub(1)..=(cy + 1).min(self.shape[1] - 1) {
            for x in cx.saturating_sub(1)..=(cx + 1).min(self.shape[0] - 1) {
                let bucket = y * self.shape[0] + x;
                total = total.saturating_add(self.totals[bucket]);
                buckets += 1;
                let mut at = self.heads[bucket];
                for _ in 0..DEPTH {
                    if at == NONE {
                        break;
                    }
                    visit(at as usize);
                    at = self.next[at as usize];
                }
            }
        }
        [total, buckets]
    }
}
