//! Sets of superblocks of a tile.

use std::ops::Range;

use crate::bitstream::detail::levels::{CELL, CodedBlock, SUPER, SUPERS, TILE};

/// A set of superblocks of a tile, one bit each.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Supers(u64);

impl Supers {
    pub(crate) const NONE: Supers = Supers(0);
    pub(crate) const ALL: Supers = Supers(u64::MAX);

    /// Returns the superblocks that contain the pixels of these columns and rows of a tile.
    #[inline(always)]
    pub(crate) fn of(columns: Range<usize>, rows: Range<usize>) -> Self {
        let (start, end) = (columns.start / SUPER, columns.end.div_ceil(SUPER));
        let row = ((1u64 << (end - start)) - 1) << start;
        let mut some = 0;
        for y in rows.start / SUPER..rows.end.div_ceil(SUPER) {
            some |= row << (y * SUPERS);
        }
        Supers(some)
    }

    /// Returns the superblocks that a block changes: its own and those that it touches.
    #[inline(always)]
    pub(crate) fn reached(block: &CodedBlock) -> Self {
        let [x, y] = block.cell.map(usize::from);
        let n = 1usize << block.size;
        Supers::of(
            x.saturating_sub(1) * CELL..((x + n + 1) * CELL).min(TILE),
            y.saturating_sub(1) * CELL..((y + n + 1) * CELL).min(TILE),
        )
    }

    /// Tells whether the set contains the superblock at this column and row.
    #[inline(always)]
    pub(crate) fn has(self, [x, y]: [usize; 2]) -> bool {
        self.0 >> (y * SUPERS + x) & 1 != 0
    }

    /// Tells whether the sets intersect.
    #[inline(always)]
    pub(crate) fn meets(self, other: Supers) -> bool {
        self.0 & other.0 != 0
    }

    #[inline(always)]
    pub(crate) fn with(self, other: Supers) -> Self {
        Supers(self.0 | other.0)
    }

    #[inline(always)]
    pub(crate) fn without(self, other: Supers) -> Self {
        Supers(self.0 & !other.0)
    }

    /// Returns the columns of the superblocks of a row.
    #[inline(always)]
    pub(crate) fn row(self, y: usize) -> impl Iterator<Item = usize> {
        let row = self.0 >> (y * SUPERS);
        (0..SUPERS).filter(move |x| row >> x & 1 != 0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_reach_the_superblocks_that_they_touch() {
        let of = |cell, size| Supers::reached(&CodedBlock { cell, plane: 0, size, end: 0 });
        let all = |places: &[[usize; 2]]| {
            places.iter().fold(Supers::NONE, |all, [x, y]| all.with(Supers(1 << (y * SUPERS + x))))
        };
        assert_eq!(of([1, 1], 0), all(&[[0, 0]]));
        assert_eq!(of([0, 0], 3), all(&[[0, 0], [1, 0], [0, 1], [1, 1]]));
        assert_eq!(of([8, 9], 0), all(&[[0, 1], [1, 1]]));
        assert_eq!(of([60, 63], 0), all(&[[7, 7]]));
        assert_eq!(of([56, 56], 3), all(&[[6, 6], [7, 6], [6, 7], [7, 7]]));
        assert_eq!(Supers::of(0..TILE, 0..TILE), Supers::ALL);
        assert_eq!(of([56, 56], 3).row(7).collect::<Vec<_>>(), [6, 7]);
        assert!(of([8, 9], 0).has([0, 1]) && !of([8, 9], 0).has([0, 0]));
    }
}
