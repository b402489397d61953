//! Finds the Gaussians that touch each tile, by a counting sort of (Gaussian, tile) pairs. Pairs are counted before
//! memory is allocated for them.

use super::project::{Splat, Splats};
use super::view::View;
use crate::budget::{Budget, Reservation};
use crate::error::Result;
use crate::limits::Limits;
use crate::parallel;
use crate::parameter::Limit;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU32, Ordering};

/// Columns of a tile.
pub(super) const TILE_WIDTH: usize = 128;

/// Rows of a tile. The recurrence restarts in each tile, which bounds its drift.
pub(super) const TILE_HEIGHT: usize = 128;

/// Pixels of a tile.
const TILE_PIXELS: u64 = (TILE_WIDTH * TILE_HEIGHT) as u64;

/// Work of cutting a Gaussian into the strips of a tile, in pixels.
const PAIR_WORK: u64 = 1024;

/// Maximum number of groups of consecutive Gaussians that are counted and sorted in parallel.
const MAX_GROUPS: usize = 16;

/// Number of pairs after which a group reports its cost to the others.
const REPORT_INTERVAL: u64 = 1 << 16;

/// The tiles that a view touches.
#[derive(Debug, Clone, Copy)]
pub(super) struct Tiles {
    /// Column and row of the first tile on the grid.
    pub first: [u32; 2],
    /// Tiles along x and y.
    pub count: [u32; 2],
}

/// The Gaussians that touch each tile of a view, in the picture's order. Tiles are in rows from the top left.
#[derive(Debug)]
pub(super) struct Bins {
    pub tiles: Tiles,
    /// Start of each tile's list in `members`; one entry more than there are tiles.
    starts: Vec<u32>,
    members: Vec<u32>,
    /// Work of rendering them, in the units of [`Limits::work`].
    pub work: u64,
    #[expect(dead_code, reason = "held until the lists are gone")]
    memory: Reservation,
}

/// Pairs and work of a view: the current count, or the maximum.
#[derive(Debug, Clone, Copy)]
struct Cost {
    pairs: u64,
    work: u64,
}

impl Cost {
    /// Adds `more` to the cost of all groups, checks the total and returns the number of pairs that are left.
    fn spend(self, more: &mut Cost, spent: &Mutex<Cost>) -> Result<u64> {
        let mut spent = spent.lock().expect("no group panics");
        spent.pairs += more.pairs;
        spent.work += more.work;
        *more = Cost { pairs: 0, work: 0 };
        Limits::check(Limit::TilePairs, spent.pairs, self.pairs)?;
        Limits::check(Limit::Work, spent.work, self.work)?;
        Ok(self.pairs - spent.pairs)
    }
}

impl Bins {
    pub(super) fn new(splats: &Splats, view: &View, limits: &Limits, budget: &Budget) -> Result<Self> {
        let tiles = Tiles::of(view);
        let number = u64::from(tiles.count[0]) * u64::from(tiles.count[1]);
        let runs: Vec<(u32, &[Splat])> = splats.runs().collect();
        // The counts of all groups take no more memory than the counts of one group or the Gaussians, whichever is
        // larger.
        let groups = (splats.len() as u64 / number).clamp(1, MAX_GROUPS.min(runs.len()).max(1) as u64);
        let fixed = (groups + 1) * (number + 1) * 4;
        let mut memory = budget.reserve(fixed)?;
        let most = Cost {
            pairs: limits.tile_pairs.min(u64::from(u32::MAX)),
            work: limits.max_work(u64::from(view.width) * u64::from(view.height), splats.len() as u64),
        };
        let nothing = || Mutex::new(Cost { pairs: 0, work: 0 });
        let spent = nothing();
        let groups: Vec<&[(u32, &[Splat])]> = runs.chunks(runs.len().div_ceil(groups as usize).max(1)).collect();
        let counts: Result<Vec<Vec<u32>>> =
            parallel::map(groups.len(), |i| tiles.counts(groups[i], view, most, &spent, REPORT_INTERVAL))
                .into_iter()
                .collect();
        let mut slots = match counts {
            Ok(counts) => counts,
            // The total at which the groups stop depends on their timing. The error must not, so count again
            // sequentially.
            Err(error) => return Err(tiles.counts(&runs, view, most, &nothing(), 0).err().unwrap_or(error)),
        };
        let Cost { pairs, work } = spent.into_inner().expect("no group panics");
        memory.grow(pairs * 4)?;
        let mut starts = Vec::with_capacity(number as usize + 1);
        let mut next = 0;
        for tile in 0..number as usize {
            starts.push(next);
            for slots in &mut slots {
                next += std::mem::replace(&mut slots[tile], next);
            }
        }
        starts.push(next);
        // Each slot is written once. The slots are atomic only so that threads can write in parallel.
        let members: Vec<AtomicU32> = (0..pairs).map(|_| AtomicU32::new(0)).collect();
        parallel::map_chunks(&mut slots, 1, |group, slots| {
            for (first, run) in groups[group] {
                for (id, splat) in (*first..).zip(*run) {
                    tiles.rows(splat, |row, columns| {
                        for slot in &mut slots[0][row + columns.start..row + columns.end] {
                            members[*slot as usize].store(id, Ordering::Relaxed);
                            *slot += 1;
                        }
                        true
                    });
                }
            }
        });
        let members: Vec<u32> = members.into_iter().map(AtomicU32::into_inner).collect();
        drop(slots);
        memory.shrink(((starts.len() + members.len()) * size_of::<u32>()) as u64);
        Ok(Bins { tiles, starts, members, work, memory })
    }

    /// Returns the Gaussians that touch the tile `(column, row)`, counted from the view's first tile.
    pub(super) fn members(&self, column: u32, row: u32) -> &[u32] {
        let tile = row as usize * self.tiles.count[0] as usize + column as usize;
        &self.members[self.starts[tile] as usize..self.starts[tile + 1] as usize]
    }
}

impl Tiles {
    fn of(view: &View) -> Self {
        let (size, side) = ([TILE_WIDTH as u32, TILE_HEIGHT as u32], [view.width, view.height]);
        let first: [u32; 2] = std::array::from_fn(|k| view.offset[k] / size[k]);
        let count = std::array::from_fn(|k| (view.offset[k] + side[k] - 1) / size[k] - first[k] + 1);
        Tiles { first, count }
    }

    /// Counts the Gaussians of `runs` that touch each tile. After each run and every `report_interval` pairs, the cost
    /// is added to what all groups have `spent`. Fails if the total exceeds `most`.
    fn counts(
        &self,
        runs: &[(u32, &[Splat])],
        view: &View,
        most: Cost,
        spent: &Mutex<Cost>,
        report_interval: u64,
    ) -> Result<Vec<u32>> {
        let mut counts = vec![0u32; self.count[0] as usize * self.count[1] as usize];
        let mut new = Cost { pairs: 0, work: 0 };
        let mut left = most.pairs;
        for (_, run) in runs {
            for splat in *run {
                let before = new.pairs;
                self.rows(splat, |row, columns| {
                    new.pairs += columns.len() as u64;
                    for count in &mut counts[row + columns.start..row + columns.end] {
                        *count += 1;
                    }
                    new.pairs <= left
                });
                let pairs = new.pairs - before;
                new.work += pairs * PAIR_WORK + splat.covered(view).min(pairs * TILE_PIXELS) * splat.cost();
                if new.pairs > report_interval {
                    left = most.spend(&mut new, spent)?;
                }
            }
            left = most.spend(&mut new, spent)?;
        }
        Ok(counts)
    }

    /// Calls `f` with the index of the first tile of each tile row that `splat` touches and the columns that it
    /// touches there, until `f` returns that it is done.
    fn rows(&self, splat: &Splat, mut f: impl FnMut(usize, std::ops::Range<usize>) -> bool) {
        let size = [TILE_WIDTH as f64, TILE_HEIGHT as f64];
        let corner: [f64; 2] = std::array::from_fn(|k| f64::from(self.first[k]) * size[k]);
        let mean: [f64; 2] = std::array::from_fn(|k| splat.mean[k] - corner[k]);
        // Casts saturate and round towards zero, which is down for the values that matter.
        let tiles = |k: usize, low: f64, high: f64| {
            let start = (low * (1.0 / size[k])) as u32;
            let end = if high < 0.0 { 0 } else { ((high * (1.0 / size[k])) as u32).saturating_add(1) };
            let end = end.min(self.count[k]);
            start.min(end) as usize..end as usize
        };
        let [ex, ey] = splat.extent();
        let columns = tiles(0, mean[0] - ex, mean[0] + ex);
        let rows = tiles(1, mean[1] - ey, mean[1] + ey);
        // An extent beyond the range of f32 is infinite; every tile within the box is kept.
        if columns.len() <= 1 || rows.len() <= 1 || (ex + ey).is_infinite() {
            for row in rows {
                if !f(row * self.count[0] as usize, columns.clone()) {
                    return;
                }
            }
            return;
        }
        // In a row, the support reaches from `lean·dy − half` to `lean·dy + half`, half = width·√(1 − dy²/extent²).
        let deepest = splat.tip;
        let lean = deepest / ey;
        let width = (ex * ex - deepest * deepest).max(0.0).sqrt();
        // The rightmost point is at `x = ex`; by symmetry of the covariance, its dy is `tip·ey/ex`.
        let level = deepest * ey / ex;
        let inverse = ey.recip();
        let half = |dy: f64| width * (1.0 - (dy * inverse).powi(2)).max(0.0).sqrt();
        for row in rows {
            let (top, bottom) = (row as f64 * size[1] - mean[1], (row + 1) as f64 * size[1] - mean[1]);
            let (right, left) = (level.clamp(top, bottom), (-level).clamp(top, bottom));
            // One pixel of margin: rounding must not lose a tile in which the kernel would draw.
            let reach = tiles(0, mean[0] + lean * left - half(left) - 1.0, mean[0] + lean * right + half(right) + 1.0);
            if !f(row * self.count[0] as usize, reach) {
                return;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::project::project;
    use super::*;
    use crate::error::Error;
    use crate::gaussian::Gaussian;
    use crate::rect::Rect;

    /// Sorts within the given `limits`, without other accounting.
    fn bins(splats: &Splats, view: &View, limits: &Limits) -> Result<Bins> {
        Bins::new(splats, view, limits, &Budget::of(limits))
    }

    fn splats(count: usize, view: &View) -> Splats {
        let gaussian = |i: usize| {
            let f = |k: u32| (i as f64 * f64::from(k).sqrt()).fract() as f32;
            Gaussian {
                mean: [2500.0 * f(2) - 200.0, 1700.0 * f(3) - 200.0],
                scale: [0.25 + 900.0 * f(5).powi(9), 0.25 + 40.0 * f(7) * f(11).powi(3)],
                rotation: 3.2 * f(13),
                color: [0.0; 4],
            }
        };
        project((count, gaussian), view, [0.0; 2], &Budget::of(&Limits::default())).unwrap()
    }

    #[test]
    fn members_stand_in_the_order_of_the_picture() {
        let full = View::new(2100, 1300);
        for view in
            [full, full.crop(Rect::new(130, 700, 1500, 333)).unwrap(), full.crop(Rect::new(1000, 500, 20, 20)).unwrap()]
        {
            for count in [0, 1, 5000, 30_000] {
                let splats = splats(count, &view);
                let bins = bins(&splats, &view, &Limits::default()).unwrap();
                let tiles = bins.tiles;
                let mut want = vec![Vec::new(); (tiles.count[0] * tiles.count[1]) as usize];
                for (first, run) in splats.runs() {
                    for (id, splat) in (first..).zip(run) {
                        tiles.rows(splat, |row, columns| {
                            columns.for_each(|column| want[row + column].push(id));
                            true
                        });
                    }
                }
                let mut total = 0;
                for (i, want) in want.iter().enumerate() {
                    let i = i as u32;
                    assert_eq!(bins.members(i % tiles.count[0], i / tiles.count[0]), want);
                    total += want.len();
                }
                assert!(total >= splats.len() && (count < 5000 || total > 100), "{total}");
            }
        }
    }

    #[test]
    fn refusals_do_not_depend_on_how_threads_take_turns() {
        let view = View::new(2100, 1300);
        let splats = splats(60_000, &view);
        let pairs = bins(&splats, &view, &Limits::default()).unwrap().members.len() as u64;
        assert!(pairs > 2 * REPORT_INTERVAL, "{pairs}");
        let mut limits = Limits::default();
        for _ in 0..20 {
            limits.tile_pairs = pairs;
            assert!(bins(&splats, &view, &limits).is_ok());
            for allowed in [pairs - 1, pairs / 2, 0] {
                limits.tile_pairs = allowed;
                let refusal = |limits| match bins(&splats, &view, limits) {
                    Err(Error::LimitExceeded { limit: Limit::TilePairs, requested, .. }) => requested,
                    other => panic!("{other:?}"),
                };
                let requested = refusal(&limits);
                assert!(requested > allowed && requested <= allowed + 17, "{requested} {allowed}");
                assert_eq!(refusal(&limits), requested);
            }
        }
        limits = Limits::default();
        limits.work = pairs * PAIR_WORK;
        assert!(matches!(bins(&splats, &view, &limits), Err(Error::LimitExceeded { limit: Limit::Work, .. })));
        limits = Limits::default();
        limits.alloc = pairs * 4;
        assert!(matches!(bins(&splats, &view, &limits), Err(Error::LimitExceeded { limit: Limit::Alloc, .. })));
    }
}
