//! Parts of the grid of positions: regions that are halved, and the squares where primitives sit (spec §8.4).

/// A part of the grid: corner and the logarithms of the sides, in cells.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Region {
    pub corner: [u32; 2],
    pub log: [u32; 2],
}

impl Region {
    /// The rectangle of powers of two around the whole grid, no side below `2^least`.
    pub fn whole(grid: [u32; 2], least: u32) -> Self {
        Region { corner: [0, 0], log: grid.map(|g| (u32::BITS - (g - 1).leading_zeros()).max(least)) }
    }

    /// The axis that is halved next, or `None` for a single cell.
    pub fn axis(&self) -> Option<usize> {
        match self.log {
            [0, 0] => None,
            [x, y] => Some(usize::from(x < y)),
        }
    }

    /// The lower and the upper half.
    pub fn halves(&self, axis: usize) -> [Region; 2] {
        let (mut low, mut high) = (*self, *self);
        low.log[axis] -= 1;
        high.log[axis] -= 1;
        high.corner[axis] += 1 << high.log[axis];
        [low, high]
    }

    /// Bits that [`Region::key`] has.
    pub fn key_bits(&self) -> u32 {
        self.log[0] + self.log[1]
    }

    /// The place of a primitive in the square of `2^log` cells that holds `cell`.
    pub fn place(&self, cell: [u32; 2], log: u32) -> Place {
        let (mut region, mut key) = (*self, 0);
        while region.log != [log; 2] {
            let Some(axis) = region.axis() else { break };
            let upper = (cell[axis] - region.corner[axis]) >> (region.log[axis] - 1) & 1;
            region = region.halves(axis)[upper as usize];
            key = key << 1 | u64::from(upper);
        }
        Place { log: std::cmp::Reverse(log), key, corner: region.corner }
    }

    /// Cells of the grid in each half along `axis`.
    pub fn inside(&self, axis: usize, grid: [u32; 2]) -> [u32; 2] {
        let (left, half) = (grid[axis].saturating_sub(self.corner[axis]), 1 << (self.log[axis] - 1));
        [left.min(half), left.saturating_sub(half).min(half)]
    }
}

/// Where a primitive sits: the square of `2^log` finest cells a side that is as coarse as its position step.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Place {
    /// Coarse squares first.
    pub log: std::cmp::Reverse<u32>,
    /// The halves that lead there.
    pub key: u64,
    pub corner: [u32; 2],
}

/// A [`Place`] without its key, which readers do not need.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Square {
    pub log: u32,
    pub corner: [u32; 2],
}
