//! Division of a picture into tiles, and the order in which they are processed.

use crate::rect::Rect;

/// A rectangle, in pixels of the picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Area {
    pub corner: [u32; 2],
    pub size: [u32; 2],
}

impl Area {
    pub(super) fn bounds(&self) -> Rect {
        Rect::new(self.corner[0], self.corner[1], self.size[0], self.size[1])
    }

    pub(super) fn pixels(&self) -> f64 {
        f64::from(self.size[0]) * f64::from(self.size[1])
    }

    /// Returns the corner, which is the offset from local coordinates to those of the picture.
    pub(super) fn origin(&self) -> [f32; 2] {
        self.corner.map(|v| v as f32)
    }

    /// Converts a rectangle from coordinates of the picture to those of this area. If it
    /// starts to the left of this area or above it, the result lies outside any picture.
    pub(super) fn inward(&self, Rect { x, y, width, height }: Rect) -> Rect {
        let local = |v: u32, k: usize| v.checked_sub(self.corner[k]).unwrap_or(u32::MAX);
        Rect::new(local(x, 0), local(y, 1), width, height)
    }

    pub(super) fn holds(&self, point: [f32; 2]) -> bool {
        (0..2).all(|k| {
            let low = self.corner[k] as f32;
            low <= point[k] && point[k] < low + self.size[k] as f32
        })
    }
}

/// A tile and the pixels that are read while it is processed.
#[derive(Debug, Clone, Copy)]
pub(super) struct Window {
    /// The tile itself. A primitive belongs to the tile that contains its mean.
    pub core: Area,
    /// The tile and a margin around it.
    pub padded: Area,
    /// Number of the window, unique within the picture.
    pub index: u64,
}

impl Window {
    /// Returns the columns and rows of the tile, relative to `padded`.
    pub(super) fn own(&self) -> (std::ops::Range<usize>, std::ops::Range<u32>) {
        let range = |k: usize| {
            let first = self.core.corner[k] - self.padded.corner[k];
            first..first + self.core.size[k]
        };
        let columns = range(0);
        (columns.start as usize..columns.end as usize, range(1))
    }
}

/// Position of the tiles of a pass.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Shift {
    /// The first tile starts at the picture's corner.
    None,
    /// The tiles are shifted by half a tile to the left and up, so that the seams of unshifted tiles lie in their
    /// interiors.
    Half,
}

/// Corners of windows are multiples of this, in pixels, so that lattice positions of the picture are lattice positions
/// of the window, too.
pub(super) const UNIT: u32 = 64;

/// Layout of the tiles of a picture.
#[derive(Debug, Clone, Copy)]
pub(super) struct Grid {
    pub size: [u32; 2],
    /// Half the side of a tile, pixels.
    pub half: u32,
    /// Width of the margin around a tile, pixels.
    pub margin: u32,
}

impl Grid {
    /// Returns the windows of a pass, grouped into turns. Any two tiles of a turn have another tile between them.
    pub(super) fn turns(&self, shift: Shift) -> Vec<Vec<Window>> {
        let side = 2 * self.half;
        let cuts = |length: u32| -> Vec<[u32; 2]> {
            let first = if shift == Shift::Half { self.half } else { side };
            let ends = (0..).map(|i| first.saturating_add(side.saturating_mul(i))).take_while(|&end| end < length);
            let ends: Vec<u32> = ends.chain([length]).collect();
            ends.iter().enumerate().map(|(i, &end)| [if i > 0 { ends[i - 1] } else { 0 }, end]).collect()
        };
        let [columns, rows] = self.size.map(cuts);
        let mut turns = vec![Vec::new(); 4];
        let all = rows.iter().enumerate().flat_map(|(j, y)| columns.iter().enumerate().map(move |(i, x)| (i, j, x, y)));
        for (index, (i, j, x, y)) in all.enumerate() {
            let core = Area { corner: [x[0], y[0]], size: [x[1] - x[0], y[1] - y[0]] };
            let index = 2 * index as u64 + u64::from(shift == Shift::Half);
            turns[i % 2 + 2 * (j % 2)].push(Window { core, padded: self.with_margin(&core), index });
        }
        turns
    }

    /// Returns the windows of an unshifted pass in the order of its turns.
    pub(super) fn windows(&self) -> Vec<Window> {
        self.turns(Shift::None).concat()
    }

    fn with_margin(&self, core: &Area) -> Area {
        let corner = core.corner.map(|v| v.saturating_sub(self.margin));
        let end = |k: usize| (core.corner[k] + core.size[k]).saturating_add(self.margin).min(self.size[k]);
        Area { corner, size: [end(0) - corner[0], end(1) - corner[1]] }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_cover_each_pixel_once_and_tiles_of_a_turn_are_apart() {
        for (size, half, margin) in
            [([700, 390], 128, 64), ([256, 256], 128, 64), ([129, 2000], 128, 128), ([1, 1], 64, 64)]
        {
            let grid = Grid { size, half, margin };
            for shift in [Shift::None, Shift::Half] {
                let mut covered = vec![0u8; (size[0] * size[1]) as usize];
                for turn in grid.turns(shift) {
                    for (i, window) in turn.iter().enumerate() {
                        let [x, y, w, h] = window.core.bounds().into();
                        for (y, x) in (y..y + h).flat_map(|y| (x..x + w).map(move |x| (y, x))) {
                            covered[(y * size[0] + x) as usize] += 1;
                        }
                        assert!(window.padded.corner.iter().all(|v| v % UNIT == 0));
                        for other in &turn[..i] {
                            let apart = (0..2).any(|k| {
                                let [a, b] =
                                    [&window.core, &other.core].map(|c| (c.corner[k], c.corner[k] + c.size[k]));
                                a.0 >= b.1 + half || b.0 >= a.1 + half
                            });
                            assert!(apart, "{window:?} {other:?}");
                        }
                    }
                }
                assert!(covered.iter().all(|&n| n == 1), "{size:?} {shift:?}");
            }
        }
    }
}
