//! Replaces colours under alpha 0, which are invisible, with a smooth continuation of the visible ones.
//!
//! Arbitrary hidden colours (often black or white) cost bits, and appear as fringes where the decoded alpha is not
//! exactly 0. The continuation is a pull–push pyramid (Gortler et al., *The Lumigraph*, 1996, §3.4). Each level halves
//! the picture and averages the visible colours, weighted by their alpha. Each level then fills its gaps from the next
//! coarser one. Alpha itself does not change.
//!
//! The cells of all levels lie on a grid that starts at the picture's corner. The levels above [`LEVELS`] are computed
//! once, for the whole picture. A part therefore has the same pixels as that area of the whole picture, and memory
//! stays bounded for pictures in tiles.

use crate::error::Result;
use crate::gaussian::Channels;
use crate::options::HiddenColors;
use crate::pixel_source::PixelSource;
use crate::pixels::{Depth, Pixels, Samples};
use crate::rect::Rect;

/// Number of levels that are computed anew for each part. The coarser levels are kept for the whole picture.
const LEVELS: u32 = 5;
/// Side of the cells of the finest level that is kept, pixels.
const CELL: u32 = 1 << LEVELS;
/// Margin around a part on which its levels depend, pixels: one cell of each level, rounded up to whole cells.
const MARGIN: u32 = 2 * CELL;
/// Side of the parts in which the whole picture is read once, pixels; a multiple of [`CELL`].
const READ: u32 = 2048;
/// Maximum number of colour channels.
const COLORS: usize = 3;

/// A level of the pyramid, row by row.
#[derive(Debug, Clone, PartialEq)]
struct Level {
    width: usize,
    height: usize,
    /// Mean colour of each cell, 0..=1 where 1 is white, and the fraction of the cell that is visible, 0..=1.
    cells: Vec<([f32; COLORS], f32)>,
}

impl Level {
    /// Returns the level whose cells are twice as large.
    fn halved(&self) -> Level {
        let (width, height) = (self.width.div_ceil(2), self.height.div_ceil(2));
        let mut cells = Vec::with_capacity(width * height);
        for y in 0..height {
            for x in 0..width {
                let mut sum = Sum::default();
                for v in 2 * y..(2 * y + 2).min(self.height) {
                    for u in 2 * x..(2 * x + 2).min(self.width) {
                        let (color, weight) = self.cells[v * self.width + u];
                        sum.add(color, weight);
                    }
                }
                cells.push(sum.cell());
            }
        }
        Level { width, height, cells }
    }

    /// Fills the invisible part of each cell from `above`, the next coarser level. `above` is already filled and starts
    /// at the same corner.
    fn fill(&mut self, above: &Level) {
        for y in 0..self.height {
            for x in 0..self.width {
                let (color, weight) = &mut self.cells[y * self.width + x];
                if *weight < 1.0 {
                    let other = above.between(x, y);
                    for (c, o) in color.iter_mut().zip(other) {
                        *c = *weight * *c + (1.0 - *weight) * o;
                    }
                    *weight = 1.0;
                }
            }
        }
    }

    /// Returns the colour at the centre of cell (`x`, `y`) of the next finer level, interpolated bilinearly between the
    /// four nearest cells.
    fn between(&self, x: usize, y: usize) -> [f32; COLORS] {
        // The centre is a quarter of a cell away from the centre of the cell that contains it.
        let near = |v: usize, n: usize| {
            let own = v / 2;
            let next = if v.is_multiple_of(2) { own.saturating_sub(1) } else { (own + 1).min(n - 1) };
            [own, next]
        };
        let (columns, rows) = (near(x, self.width), near(y, self.height));
        let mut color = [0.0; COLORS];
        for (row, v) in rows.into_iter().zip([0.75, 0.25f32]) {
            for (column, u) in columns.into_iter().zip([0.75, 0.25f32]) {
                let (cell, _) = &self.cells[row * self.width + column];
                color.iter_mut().zip(cell).for_each(|(c, value)| *c += u * v * value);
            }
        }
        color
    }
}

/// The sum of four cells.
#[derive(Default)]
struct Sum {
    color: [f32; COLORS],
    weight: f32,
}

impl Sum {
    fn add(&mut self, color: [f32; COLORS], weight: f32) {
        self.color.iter_mut().zip(color).for_each(|(sum, c)| *sum += weight * c);
        self.weight += weight;
    }

    fn cell(self) -> ([f32; COLORS], f32) {
        if self.weight == 0.0 {
            return ([0.0; COLORS], 0.0);
        }
        (self.color.map(|c| c / self.weight), self.weight.min(1.0))
    }
}

/// A picture with alpha whose hidden colours continue the visible ones.
pub(super) struct InpaintedSource<'a> {
    source: &'a dyn PixelSource,
    /// The filled level with cells of [`CELL`] pixels, for the whole picture.
    coarse: Level,
}

impl<'a> InpaintedSource<'a> {
    /// Reads the whole picture of `source` once, part by part. Returns `None` if it has no hidden colours, or if
    /// `hidden` keeps them. Calls `on_progress` for each part.
    ///
    /// # Errors
    /// Returns an error of `source` or of `on_progress`.
    pub(super) fn new(
        source: &'a dyn PixelSource,
        hidden: HiddenColors,
        mut on_progress: impl FnMut() -> Result<()>,
    ) -> Result<Option<Self>> {
        if hidden == HiddenColors::Keep || source.channels().alpha().is_none() {
            return Ok(None);
        }
        let [width, height] = source.size();
        let size = [width, height].map(|side| side.div_ceil(CELL) as usize);
        let mut coarse =
            Level { width: size[0], height: size[1], cells: vec![([0.0; COLORS], 0.0); size[0] * size[1]] };
        let mut has_hidden = false;
        for y in (0..height).step_by(READ as usize) {
            for x in (0..width).step_by(READ as usize) {
                on_progress()?;
                let part = source.part(Rect::new(x, y, READ.min(width - x), READ.min(height - y)))?;
                has_hidden |= hides_colors(&part);
                let mut level = halved_pixels(&part);
                for _ in 1..LEVELS {
                    level = level.halved();
                }
                let [left, top] = [x, y].map(|v| (v / CELL) as usize);
                for (row, cells) in level.cells.chunks_exact(level.width).enumerate() {
                    coarse.cells[(top + row) * coarse.width + left..][..level.width].copy_from_slice(cells);
                }
            }
        }
        if !has_hidden {
            return Ok(None);
        }
        fill_all(&mut coarse);
        Ok(Some(InpaintedSource { source, coarse }))
    }

    /// Replaces the hidden colours of `part`, whose corner (`x`, `y`) lies on the grid of [`CELL`]. Pixels within
    /// [`MARGIN`] of an edge of the part are not final, unless it is an edge of the picture.
    fn filled(&self, part: Pixels, Rect { x, y, .. }: Rect) -> Result<Pixels> {
        let mut levels = vec![halved_pixels(&part)];
        while levels.len() < LEVELS as usize {
            levels.push(levels[levels.len() - 1].halved());
        }
        let last = levels.len() - 1;
        let [left, top] = [x, y].map(|v| (v / CELL) as usize);
        let (width, height) = (levels[last].width, levels[last].height);
        let mut cells = Vec::with_capacity(width * height);
        for row in self.coarse.cells.chunks_exact(self.coarse.width).skip(top).take(height) {
            cells.extend_from_slice(&row[left..][..width]);
        }
        levels[last].cells = cells;
        for k in (0..last).rev() {
            let (below, above) = levels.split_at_mut(k + 1);
            below[k].fill(&above[0]);
        }
        with_hidden(part, &levels[0])
    }
}

impl PixelSource for InpaintedSource<'_> {
    fn width(&self) -> u32 {
        self.source.width()
    }

    fn height(&self) -> u32 {
        self.source.height()
    }

    fn channels(&self) -> Channels {
        self.source.channels()
    }

    fn depth(&self) -> Depth {
        self.source.depth()
    }

    fn part(&self, area: Rect) -> Result<Pixels> {
        let part = self.source.part(area)?;
        if !hides_colors(&part) {
            return Ok(part);
        }
        let Rect { x, y, width, height } = area;
        let from = [x, y].map(|v| v.saturating_sub(MARGIN) / CELL * CELL);
        let to = |v: u32, side: u32| v.saturating_add(MARGIN).min(side);
        let [right, bottom] = [to(x + width, self.width()), to(y + height, self.height())];
        let around = Rect::new(from[0], from[1], right - from[0], bottom - from[1]);
        let filled =
            if around == area { self.filled(part, around)? } else { self.filled(self.source.part(around)?, around)? };
        filled.part(Rect::new(x - from[0], y - from[1], width, height))
    }
}

/// Returns `pixels` with its hidden colours replaced. Returns `None` if it has none, or if `hidden` keeps them. Calls
/// `on_progress` from time to time.
///
/// # Errors
/// Returns an error of `on_progress`.
pub(super) fn inpainted(
    pixels: &Pixels,
    hidden: HiddenColors,
    on_progress: impl FnMut() -> Result<()>,
) -> Result<Option<Pixels>> {
    match InpaintedSource::new(pixels, hidden, on_progress)? {
        Some(inpainted) => inpainted.part(Rect::new(0, 0, pixels.width(), pixels.height())).map(Some),
        None => Ok(None),
    }
}

/// Fills a level completely from the levels above it, up to a single cell.
fn fill_all(level: &mut Level) {
    if level.width * level.height > 1 {
        let mut above = level.halved();
        fill_all(&mut above);
        level.fill(&above);
    }
}

/// Returns whether `pixels` has pixels of alpha 0.
pub(super) fn hides_colors(pixels: &Pixels) -> bool {
    let Some(alpha) = pixels.channels().alpha() else { return false };
    let count = pixels.channels().count();
    match pixels.samples() {
        Samples::U8(v) => v.chunks_exact(count).any(|p| p[alpha] == 0),
        Samples::U16(v) => v.chunks_exact(count).any(|p| p[alpha] == 0),
    }
}

/// Returns the level with cells of 2 × 2 pixels. Colours are weighted by their alpha.
fn halved_pixels(pixels: &Pixels) -> Level {
    let count = pixels.channels().count();
    let (width, height) = (pixels.width() as usize, pixels.height() as usize);
    let across = width.div_ceil(2);
    let mut cells = Vec::with_capacity(across * height.div_ceil(2));
    for y in (0..height).step_by(2) {
        for x in (0..width).step_by(2) {
            let mut sum = Sum::default();
            for v in y..(y + 2).min(height) {
                for u in x..(x + 2).min(width) {
                    let first = (v * width + u) * count;
                    let mut color = [0.0; COLORS];
                    color.iter_mut().enumerate().take(count - 1).for_each(|(k, c)| *c = pixels.value(first + k));
                    sum.add(color, pixels.value(first + count - 1));
                }
            }
            cells.push(sum.cell());
        }
    }
    Level { width: across, height: height.div_ceil(2), cells }
}

/// Replaces the colours of pixels of alpha 0 with colours interpolated between the cells of `above`.
fn with_hidden(pixels: Pixels, above: &Level) -> Result<Pixels> {
    let (width, height, channels) = (pixels.width(), pixels.height(), pixels.channels());
    fn replaced<T: Copy + PartialEq + Default>(
        v: &mut [T],
        size: [usize; 2],
        above: &Level,
        sample: impl Fn(f32) -> T,
    ) {
        let count = v.len() / (size[0] * size[1]);
        for (i, pixel) in v.chunks_exact_mut(count).enumerate() {
            if pixel[count - 1] == T::default() {
                let color = above.between(i % size[0], i / size[0]);
                pixel[..count - 1].iter_mut().zip(color).for_each(|(p, c)| *p = sample(c));
            }
        }
    }
    let size = [width as usize, height as usize];
    let mut samples = pixels.into_samples();
    match &mut samples {
        Samples::U8(v) => replaced(v, size, above, |c| (c * 255.0 + 0.5) as u8),
        Samples::U16(v) => replaced(v, size, above, |c| (c * 65535.0 + 0.5) as u16),
    }
    Pixels::new(width, height, channels, samples)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a picture whose alpha is a disc, with noise as hidden colours.
    fn disc(width: u32, height: u32, channels: Channels, hidden: u16) -> Pixels {
        let count = channels.count();
        let samples = (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).flat_map(|(x, y)| {
            let far = (x.abs_diff(width / 3).pow(2) + y.abs_diff(height / 2).pow(2)) as f32;
            let alpha = (20.0 - far.sqrt()).clamp(0.0, 1.0);
            (0..count).map(move |k| match k + 1 == count {
                true => (alpha * 65535.0) as u16,
                false if alpha > 0.0 => (x * 300 + y * 100 + k as u32 * 5000) as u16,
                false => hidden.wrapping_mul((x * 7 + y * 13 + k as u32) as u16),
            })
        });
        Pixels::new(width, height, channels, Samples::U16(samples.collect())).unwrap()
    }

    fn filled(pixels: &Pixels) -> Pixels {
        inpainted(pixels, HiddenColors::Continue, || Ok(())).unwrap().expect("hidden colours")
    }

    #[test]
    fn result_depends_only_on_visible_colors_and_keeps_them_and_alpha() {
        for channels in [Channels::GreyAlpha, Channels::Rgba] {
            let [a, b] = [0, 40_503].map(|hidden| disc(150, 97, channels, hidden));
            let filled = [&a, &b].map(filled);
            assert_eq!(filled[0], filled[1]);
            let count = channels.count();
            let (Samples::U16(before), Samples::U16(after)) = (a.samples(), filled[0].samples()) else {
                unreachable!()
            };
            for (p, q) in before.chunks_exact(count).zip(after.chunks_exact(count)) {
                assert_eq!(p[count - 1], q[count - 1]);
                assert!(p[count - 1] == 0 || p == q);
            }
        }
    }

    #[test]
    fn parts_equal_the_same_area_of_the_whole_picture() {
        // The picture spans several cells, so that parts can lie anywhere on the grid.
        let picture = disc(300, 260, Channels::Rgba, 12_345);
        let whole = filled(&picture);
        let parts = InpaintedSource::new(&picture, HiddenColors::Continue, || Ok(())).unwrap().unwrap();
        for area in [[0, 0, 300, 260], [1, 1, 2, 3], [64, 32, 128, 96], [131, 77, 169, 183], [299, 259, 1, 1]] {
            assert_eq!(parts.part(area.into()).unwrap(), whole.part(area.into()).unwrap(), "{area:?}");
        }
    }

    #[test]
    fn a_single_visible_color_fills_all_hidden_pixels() {
        // There is one visible colour, which all hidden pixels receive.
        let samples = (0..64 * 64).flat_map(|i| if i % 64 < 9 { [200, 30, 10, 255] } else { [0, 255, 0, 0] });
        let picture = Pixels::new(64, 64, Channels::Rgba, Samples::U8(samples.collect())).unwrap();
        let Samples::U8(v) = filled(&picture).into_samples() else { unreachable!() };
        assert!(v.chunks_exact(4).all(|p| p[..3] == [200, 30, 10]));
    }

    #[test]
    fn pictures_without_hidden_colors_are_unchanged() {
        let opaque = Pixels::new(2, 2, Channels::GreyAlpha, Samples::U8(vec![9, 255, 8, 1, 7, 255, 6, 255])).unwrap();
        assert!(inpainted(&opaque, HiddenColors::Continue, || Ok(())).unwrap().is_none());
        let grey = Pixels::new(2, 1, Channels::Grey, Samples::U8(vec![0, 1])).unwrap();
        assert!(inpainted(&grey, HiddenColors::Continue, || Ok(())).unwrap().is_none());
        let clear = Pixels::new(2, 1, Channels::GreyAlpha, Samples::U8(vec![5, 0, 9, 0])).unwrap();
        assert_eq!(filled(&clear).samples(), &Samples::U8(vec![0, 0, 0, 0]));
    }
}
