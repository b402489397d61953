//! Lists the Gaussians of each tile of 16 × 16 pixels in their order.

/// Side of a tile, pixels.
pub(super) const TILE: usize = 16;

/// Bounding box of a Gaussian: its centre and half extent, pixels.
#[derive(Debug, Clone, Copy)]
pub(super) struct Reach {
    pub center: [f32; 2],
    pub half: [f32; 2],
}

impl Reach {
    /// Tells whether the box intersects a picture of this size.
    pub(super) fn meets(&self, size: [u32; 2]) -> bool {
        (0..2).all(|k| self.center[k] + self.half[k] >= 0.0 && self.center[k] - self.half[k] < size[k] as f32)
    }
}

/// The Gaussians of all tiles.
#[derive(Debug, Default)]
pub(super) struct Tiles {
    pub columns: usize,
    starts: Vec<u32>,
    ids: Vec<u32>,
}

impl Tiles {
    /// Sorts boxes into tiles, in their order; boxes with NaN are in no tile.
    pub(super) fn new(boxes: impl Iterator<Item = Reach> + Clone, [width, height]: [usize; 2]) -> Self {
        let [columns, rows] = [width, height].map(|side| side.div_ceil(TILE));
        let range = |reach: &Reach, k: usize, last: usize| {
            let (center, half) = (reach.center[k] / TILE as f32, reach.half[k] / TILE as f32);
            if !(half > 0.0 && center.is_finite()) {
                return 0..0;
            }
            // Casts to integers round towards 0, as in the published programs.
            let first = (center - half).max(0.0) as usize;
            first.min(last)..((center + half + 1.0).max(0.0) as usize).min(last)
        };
        let all = |reach: Reach| {
            let (x, y) = (range(&reach, 0, columns), range(&reach, 1, rows));
            y.flat_map(move |y| x.clone().map(move |x| y * columns + x))
        };
        let mut starts = vec![0u32; columns * rows + 1];
        boxes.clone().flat_map(all).for_each(|tile| starts[tile + 1] += 1);
        for tile in 0..columns * rows {
            starts[tile + 1] += starts[tile];
        }
        let mut next = starts.clone();
        let mut ids = vec![0u32; starts[columns * rows] as usize];
        for (id, reach) in boxes.enumerate() {
            for tile in all(reach) {
                ids[next[tile] as usize] = id as u32;
                next[tile] += 1;
            }
        }
        Tiles { columns, starts, ids }
    }

    /// Returns the members of one tile.
    pub(super) fn members(&self, row: usize, column: usize) -> &[u32] {
        let tile = row * self.columns + column;
        &self.ids[self.starts[tile] as usize..self.starts[tile + 1] as usize]
    }
}
