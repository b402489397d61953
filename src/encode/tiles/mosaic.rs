//! Primitives of a whole picture, indexed by position for fast access to the primitives of a part.

use super::grid::{Area, Grid};
use crate::gaussian::Gaussian;

/// A primitive and its cost: the increase of the squared error if it were removed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Placed<T> {
    pub primitive: T,
    pub cost: f32,
}

/// Primitives of a tile, and other primitives that reach into the tile's window.
pub(super) struct WindowPrimitives<T> {
    pub own: Vec<T>,
    pub neighbours: Vec<T>,
}

/// Result of the work on a tile.
pub(super) struct TileResult<T> {
    /// Primitives of the tile, in the picture's coordinates.
    pub own: Vec<Placed<T>>,
    /// Candidate primitives. Their cost is the estimated decrease of the squared error if they were added.
    pub candidates: Vec<Placed<T>>,
    /// Squared error of the tile.
    pub error: f64,
}

impl<T> TileResult<T> {
    /// Returns the result for a tile whose error was only measured.
    pub(super) fn measured(error: f64) -> Self {
        TileResult { own: Vec::new(), candidates: Vec::new(), error }
    }
}

/// Primitives, grouped into squares with half the side of a tile. Every tile, shifted or not, consists of whole
/// squares.
#[derive(Clone)]
pub(super) struct Mosaic<'a, T> {
    half: u32,
    columns: usize,
    squares: Vec<Square<T>>,
    to_gaussian: &'a dyn Fn(&T) -> Gaussian,
}

#[derive(Debug, Clone)]
struct Square<T> {
    placed: Vec<Placed<T>>,
    /// Maximum distance from its mean that any of the primitives reaches, pixels.
    reach: f32,
}

impl<'a, T: Copy> Mosaic<'a, T> {
    /// Creates an empty mosaic. `to_gaussian` converts a primitive to a Gaussian of the picture.
    pub(super) fn new(grid: &Grid, to_gaussian: &'a dyn Fn(&T) -> Gaussian) -> Self {
        let [columns, rows] = grid.size.map(|side| side.div_ceil(grid.half) as usize);
        Mosaic {
            half: grid.half,
            columns,
            squares: vec![Square { placed: Vec::new(), reach: 0.0 }; columns * rows],
            to_gaussian,
        }
    }

    pub(super) fn count(&self) -> usize {
        self.squares.iter().map(|s| s.placed.len()).sum()
    }

    pub(super) fn all(&self) -> impl Iterator<Item = &Placed<T>> {
        self.squares.iter().flat_map(|s| &s.placed)
    }

    pub(super) fn insert(&mut self, placed: Placed<T>) {
        let gaussian = (self.to_gaussian)(&placed.primitive);
        let rows = self.squares.len() / self.columns;
        let at = |k: usize, n: usize| ((gaussian.mean[k].max(0.0) / self.half as f32) as usize).min(n - 1);
        let square = &mut self.squares[at(1, rows) * self.columns + at(0, self.columns)];
        let [x, y] = gaussian.extent();
        square.reach = square.reach.max(x).max(y);
        square.placed.push(placed);
    }

    /// Returns the indices of the squares of a tile.
    fn indices(&self, core: &Area) -> Vec<usize> {
        let range = |k: usize| core.corner[k] / self.half..(core.corner[k] + core.size[k]).div_ceil(self.half);
        range(1)
            .flat_map(|y| range(0).map(move |x| (y, x)))
            .map(|(y, x)| y as usize * self.columns + x as usize)
            .collect()
    }

    /// Returns the primitives of a tile.
    fn own(&self, core: &Area) -> Vec<T> {
        self.indices(core).into_iter().flat_map(|i| self.squares[i].placed.iter().map(|p| p.primitive)).collect()
    }

    /// Returns the primitives of other tiles that reach into `padded`.
    fn neighbours(&self, core: &Area, padded: &Area) -> Vec<T> {
        let own = self.indices(core);
        let touches = |low: [f32; 2], high: [f32; 2]| {
            (0..2).all(|k| low[k] < (padded.corner[k] + padded.size[k]) as f32 && high[k] > padded.corner[k] as f32)
        };
        let mut out = Vec::new();
        for (i, square) in self.squares.iter().enumerate() {
            let corner = [i % self.columns, i / self.columns].map(|v| (v as u32 * self.half) as f32);
            let reach = square.reach + 1.0;
            if own.contains(&i) || !touches(corner.map(|v| v - reach), corner.map(|v| v + self.half as f32 + reach)) {
                continue;
            }
            out.extend(square.placed.iter().map(|p| p.primitive).filter(|p| {
                let Gaussian { mean: [x, y], .. } = (self.to_gaussian)(p);
                let [w, h] = (self.to_gaussian)(p).extent();
                touches([x - w, y - h], [x + w, y + h])
            }));
        }
        out
    }

    /// Returns the primitives of a tile, and primitives of other tiles that reach into `padded`.
    pub(super) fn window_primitives(&self, core: &Area, padded: &Area) -> WindowPrimitives<T> {
        WindowPrimitives { own: self.own(core), neighbours: self.neighbours(core, padded) }
    }

    /// Replaces the primitives of tiles by the results of work on them.
    pub(super) fn replace(&mut self, results: Vec<(Area, Vec<Placed<T>>)>) {
        for (core, _) in &results {
            for i in self.indices(core) {
                self.squares[i] = Square { placed: Vec::new(), reach: 0.0 };
            }
        }
        results.into_iter().flat_map(|(_, placed)| placed).for_each(|placed| self.insert(placed));
    }

    /// Removes the `count` primitives with the lowest costs.
    pub(super) fn remove_cheapest(&mut self, count: usize) {
        if count == 0 {
            return;
        }
        let mut costs: Vec<f32> = self.all().map(|p| p.cost).collect();
        if count >= costs.len() {
            self.squares.iter_mut().for_each(|s| s.placed.clear());
            return;
        }
        let bar = *costs.select_nth_unstable_by(count, f32::total_cmp).1;
        // Among primitives of equal cost, the first ones are removed.
        let mut left = count - costs[..count].iter().filter(|c| c.total_cmp(&bar).is_lt()).count();
        for square in &mut self.squares {
            square.placed.retain(|p| match p.cost.total_cmp(&bar) {
                std::cmp::Ordering::Less => false,
                std::cmp::Ordering::Equal if left > 0 => {
                    left -= 1;
                    false
                }
                _ => true,
            });
        }
    }

    /// Changes the number of primitives to about `wanted`: removes the cheapest ones, or adds the best of `candidates`,
    /// which it takes out of them. Then replaces at most `swaps` of the cheapest primitives by candidates that gain
    /// more than the primitives cost.
    pub(super) fn balance(&mut self, candidates: &mut Vec<Placed<T>>, wanted: usize, swaps: usize) {
        let have = self.count();
        candidates.sort_by(|a, b| b.cost.total_cmp(&a.cost));
        let mut costs: Vec<f32> = self.all().map(|p| p.cost).collect();
        costs.sort_unstable_by(f32::total_cmp);
        let (mut removed, mut added) = (have.saturating_sub(wanted), wanted.saturating_sub(have).min(candidates.len()));
        let max_added = added + swaps;
        while added < max_added.min(candidates.len()) && removed < have && candidates[added].cost > costs[removed] {
            (removed, added) = (removed + 1, added + 1);
        }
        self.remove_cheapest(removed);
        candidates.drain(..added).for_each(|placed| self.insert(placed));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn to_gaussian(p: &[f32; 2]) -> Gaussian {
        Gaussian { mean: *p, scale: [3.0; 2], rotation: 0.0, color: [0.0; 4] }
    }

    fn at(x: f32, y: f32, cost: f32) -> Placed<[f32; 2]> {
        Placed { primitive: [x, y], cost }
    }

    fn costs(mosaic: &Mosaic<'_, [f32; 2]>) -> Vec<f32> {
        let mut costs: Vec<f32> = mosaic.all().map(|p| p.cost).collect();
        costs.sort_by(f32::total_cmp);
        costs
    }

    #[test]
    fn a_tile_returns_its_primitives_and_others_that_reach_into_it() {
        let grid = Grid { size: [300, 200], half: 64, margin: 64 };
        let mut mosaic = Mosaic::new(&grid, &to_gaussian);
        let points = [[10.0, 10.0], [127.0, 5.0], [130.0, 5.0], [200.0, 5.0], [299.9, 199.9], [300.5, -1.0]];
        points.iter().for_each(|p| mosaic.insert(at(p[0], p[1], 1.0)));
        assert_eq!(mosaic.count(), points.len());
        let core = Area { corner: [0, 0], size: [128, 128] };
        assert_eq!(mosaic.own(&core), [[10.0, 10.0], [127.0, 5.0]]);
        assert_eq!(mosaic.neighbours(&core, &core), [[130.0, 5.0]]);
        let padded = Area { corner: [0, 0], size: [192, 192] };
        assert_eq!(mosaic.neighbours(&core, &padded), [[130.0, 5.0], [200.0, 5.0]]);
        mosaic.replace(vec![(core, vec![at(290.0, 190.0, 2.0)])]);
        assert_eq!((mosaic.count(), mosaic.own(&core).len()), (points.len() - 1, 0));
    }

    #[test]
    fn the_cheapest_primitives_are_removed_and_the_best_candidates_added() {
        let grid = Grid { size: [300, 200], half: 64, margin: 64 };
        let mut mosaic = Mosaic::new(&grid, &to_gaussian);
        (0..10).for_each(|i| mosaic.insert(at(29.0 * i as f32, 7.0, (i / 2) as f32)));
        mosaic.remove_cheapest(3);
        assert_eq!(costs(&mosaic), [1.0, 2.0, 2.0, 3.0, 3.0, 4.0, 4.0]);
        let mut candidates = [0.5, 9.0, 2.5, 8.0].map(|gain| at(5.0, 5.0, gain)).to_vec();
        mosaic.balance(&mut candidates, 8, 0);
        assert_eq!(candidates, [8.0, 2.5, 0.5].map(|gain| at(5.0, 5.0, gain)));
        assert_eq!(costs(&mosaic), [1.0, 2.0, 2.0, 3.0, 3.0, 4.0, 4.0, 9.0]);
        // One candidate is added and one replaces a primitive. The next candidate would gain less than the cheapest
        // primitive costs.
        mosaic.balance(&mut vec![at(5.0, 5.0, 2.5), at(5.0, 5.0, 1.5), at(5.0, 5.0, 7.0)], 9, 5);
        assert_eq!(costs(&mosaic), [2.0, 2.0, 2.5, 3.0, 3.0, 4.0, 4.0, 7.0, 9.0]);
        mosaic.balance(&mut Vec::new(), 2, 5);
        assert_eq!(costs(&mosaic), [7.0, 9.0]);
        mosaic.remove_cheapest(7);
        assert_eq!(mosaic.count(), 0);
    }
}
