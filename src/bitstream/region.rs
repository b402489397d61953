//! Regions of the grid of positions that are halved repeatedly, and the squares that contain Gaussians (spec §8.4).

/// A region of the grid: its corner, and the binary logarithms of its sides, in cells.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Region {
    pub corner: [u32; 2],
    pub log: [u32; 2],
}

impl Region {
    /// Returns the rectangle of powers of two around the whole grid; no side is below `2^least`.
    pub(crate) fn whole(grid: [u32; 2], least: u32) -> Self {
        Region { corner: [0, 0], log: grid.map(|g| (u32::BITS - (g - 1).leading_zeros()).max(least)) }
    }

    /// Returns the axis that is halved next, or `None` for a single cell.
    pub(crate) fn axis(&self) -> Option<usize> {
        match self.log {
            [0, 0] => None,
            [x, y] => Some(usize::from(x < y)),
        }
    }

    /// Returns the lower and the upper half.
    pub(crate) fn halves(&self, axis: usize) -> [Region; 2] {
        let (mut low, mut high) = (*self, *self);
        low.log[axis] -= 1;
        high.log[axis] -= 1;
        high.corner[axis] += 1 << high.log[axis];
        [low, high]
    }

    /// Returns the number of bits of the key of [`Region::place`].
    pub(crate) fn key_bits(&self) -> u32 {
        self.log[0] + self.log[1]
    }

    /// Returns the place of a Gaussian in the square of `2^log` cells that contains `cell`.
    pub(crate) fn place(&self, cell: [u32; 2], log: u32) -> Place {
        let (mut region, mut key) = (*self, 0);
        while region.log != [log; 2] {
            let Some(axis) = region.axis() else { break };
            let upper = (cell[axis] - region.corner[axis]) >> (region.log[axis] - 1) & 1;
            region = region.halves(axis)[upper as usize];
            key = key << 1 | u64::from(upper);
        }
        Place { log: std::cmp::Reverse(log), key, corner: region.corner }
    }

    /// Returns the number of cells of the grid in each half along `axis`.
    pub(crate) fn inside(&self, axis: usize, grid: [u32; 2]) -> [u32; 2] {
        let (left, half) = (grid[axis].saturating_sub(self.corner[axis]), 1 << (self.log[axis] - 1));
        [left.min(half), left.saturating_sub(half).min(half)]
    }
}

/// Place of a Gaussian: the square, with a side of `2^log` finest cells, that is as coarse as its position step.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Place {
    /// Binary logarithm of the side; coarse squares come first.
    pub log: std::cmp::Reverse<u32>,
    /// The sequence of halves that leads to the square.
    pub key: u64,
    pub corner: [u32; 2],
}

/// A [`Place`] without its key, which readers do not need.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Square {
    pub log: u32,
    pub corner: [u32; 2],
}
