//! Which Gaussians touch which tile: a counting sort of (Gaussian, tile) pairs, counted before it is done.

use super::kernel::{TILE_HEIGHT, TILE_WIDTH};
use super::project::{Splat, Splats};
use super::view::View;
use crate::error::Result;
use crate::limits::Limits;

/// Pixels of a tile.
const TILE: u64 = (TILE_WIDTH * TILE_HEIGHT) as u64;

/// Pixels that take as long as cutting a Gaussian into the strips of a tile.
const PAIR_WORK: u64 = 1024;

/// For each tile of a view, in rows from its top left, the Gaussians that touch it, in the picture's order.
#[derive(Debug)]
pub(super) struct Bins {
    /// Column and row of the first tile on the grid.
    pub first: [u32; 2],
    /// Tiles along x and y.
    pub count: [u32; 2],
    /// Where each tile's list starts in `members`; one more than there are tiles.
    starts: Vec<u32>,
    members: Vec<u32>,
}

impl Bins {
    pub fn new(splats: &Splats, view: &View, limits: &Limits) -> Result<Self> {
        let size = [TILE_WIDTH as u32, TILE_HEIGHT as u32];
        let side = [view.width, view.height];
        let first: [u32; 2] = std::array::from_fn(|k| view.offset[k] / size[k]);
        let count: [u32; 2] = std::array::from_fn(|k| (view.offset[k] + side[k] - 1) / size[k] - first[k] + 1);
        let tiles = u64::from(count[0]) * u64::from(count[1]);
        // Where the tiles' lists start, once more while they are filled.
        let fixed = 2 * (tiles + 1) * 4;
        limits.check_alloc(fixed)?;
        let allowed = limits.tile_pairs.min(u64::from(u32::MAX));
        let most_work = limits.most_work(u64::from(view.width) * u64::from(view.height), splats.len() as u64);
        let mut bins = Bins { first, count, starts: vec![0; tiles as usize + 1], members: Vec::new() };
        let (mut pairs, mut work) = (0u64, 0u64);
        for (_, run) in splats.runs() {
            for splat in run {
                let mut starts = std::mem::take(&mut bins.starts);
                let before = pairs;
                bins.rows(splat, |row, columns| {
                    pairs += columns.len() as u64;
                    for tile in columns {
                        starts[row + tile + 1] += 1;
                    }
                    pairs <= allowed
                });
                bins.starts = starts;
                Limits::check("tile_pairs", pairs, allowed)?;
                work += (pairs - before) * PAIR_WORK + splat.covered(view).min((pairs - before) * TILE);
                Limits::check("work", work, most_work)?;
            }
        }
        limits.check_alloc(fixed + pairs * 4)?;
        for i in 1..bins.starts.len() {
            bins.starts[i] += bins.starts[i - 1];
        }
        let mut next = bins.starts.clone();
        let mut members = vec![0u32; pairs as usize];
        for (first, run) in splats.runs() {
            for (id, splat) in (first..).zip(run) {
                bins.rows(splat, |row, columns| {
                    for tile in columns {
                        let slot = &mut next[row + tile];
                        members[*slot as usize] = id;
                        *slot += 1;
                    }
                    true
                });
            }
        }
        bins.members = members;
        Ok(bins)
    }

    /// What the lists take, bytes.
    pub fn bytes(&self) -> u64 {
        ((self.starts.len() + self.members.len()) * size_of::<u32>()) as u64
    }

    /// The Gaussians that touch the tile `(column, row)`, counted from the view's first.
    pub fn members(&self, column: u32, row: u32) -> &[u32] {
        let tile = row as usize * self.count[0] as usize + column as usize;
        &self.members[self.starts[tile] as usize..self.starts[tile + 1] as usize]
    }

    /// Calls `f` with the index of the first tile of each tile row that `splat` touches and the columns that it
    /// touches there, until `f` has had enough.
    fn rows(&self, splat: &Splat, mut f: impl FnMut(usize, std::ops::Range<usize>) -> bool) {
        let size = [TILE_WIDTH as f64, TILE_HEIGHT as f64];
        let corner: [f64; 2] = std::array::from_fn(|k| f64::from(self.first[k]) * size[k]);
        let mean: [f64; 2] = std::array::from_fn(|k| splat.mean[k] - corner[k]);
        // Casts saturate and round towards zero, which is down where it matters.
        let tiles = |k: usize, low: f64, high: f64| {
            let start = (low * (1.0 / size[k])) as u32;
            let end = if high < 0.0 { 0 } else { ((high * (1.0 / size[k])) as u32).saturating_add(1) };
            let end = end.min(self.count[k]);
            start as usize..end.max(start) as usize
        };
        let [ex, ey] = splat.extent();
        let columns = tiles(0, mean[0] - ex, mean[0] + ex);
        let rows = tiles(1, mean[1] - ey, mean[1] + ey);
        // An extent beyond f32 is infinite: no tile within the box is ruled out.
        if columns.len() <= 1 || rows.len() <= 1 || (ex + ey).is_infinite() {
            for row in rows {
                if !f(row * self.count[0] as usize, columns.clone()) {
                    return;
                }
            }
            return;
        }
        // In rows the support reaches from `lean·dy − half` to `lean·dy + half`, half = width·√(1 − dy²/extent²).
        let deepest = splat.tip;
        let lean = deepest / ey;
        let width = (ex * ex - deepest * deepest).max(0.0).sqrt();
        // The rightmost point lies where `x = ex`; by symmetry of the covariance its dy is `tip·ey/ex`.
        let level = deepest * ey / ex;
        let inverse = ey.recip();
        let half = |dy: f64| width * (1.0 - (dy * inverse).powi(2)).max(0.0).sqrt();
        for row in rows {
            let (top, bottom) = (row as f64 * size[1] - mean[1], (row + 1) as f64 * size[1] - mean[1]);
            let (right, left) = (level.clamp(top, bottom), (-level).clamp(top, bottom));
            // One pixel of slack: rounding here must never lose a tile that the kernel would draw in.
            let reach = tiles(0, mean[0] + lean * left - half(left) - 1.0, mean[0] + lean * right + half(right) + 1.0);
            if !f(row * self.count[0] as usize, reach) {
                return;
            }
        }
    }
}
