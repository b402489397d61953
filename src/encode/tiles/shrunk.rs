//! A downscaled picture that is read in parts. A fit of few primitives needs no more detail.

use crate::error::Result;
use crate::gaussian::Channels;
use crate::options::HiddenColors;
use crate::pixel_source::{PixelSource, check_area};
use crate::pixels::{Depth, Pixels, Samples};
use crate::rect::Rect;

/// Number of rows that are computed at a time.
const ROWS: usize = 32;

/// A picture whose pixels are the means of squares of pixels of another picture.
pub(super) struct Shrunk<'a> {
    source: &'a dyn PixelSource,
    /// Side of the squares, pixels.
    by: u32,
    hidden: HiddenColors,
}

impl<'a> Shrunk<'a> {
    /// Downscales `source`: each square of `by` × `by` pixels becomes a pixel. Squares at the right and bottom edges
    /// may be cut off.
    pub(super) fn new(source: &'a dyn PixelSource, by: u32, hidden: HiddenColors) -> Self {
        Shrunk { source, by, hidden }
    }
}

impl PixelSource for Shrunk<'_> {
    fn width(&self) -> u32 {
        self.source.width().div_ceil(self.by)
    }

    fn height(&self) -> u32 {
        self.source.height().div_ceil(self.by)
    }

    fn channels(&self) -> Channels {
        self.source.channels()
    }

    fn depth(&self) -> Depth {
        self.source.depth()
    }

    fn part(&self, area: Rect) -> Result<Pixels> {
        check_area(area, self.size())?;
        if self.by == 1 {
            return self.source.part(area);
        }
        let Rect { x, y, width, height } = area;
        let (size, channels) = (self.source.size(), self.channels());
        let at = |v: u32, k: usize| v.saturating_mul(self.by).min(size[k]);
        let [left, right] = [at(x, 0), at(x + width, 0)];
        let mut samples = match self.depth() {
            Depth::Eight => Samples::U8(Vec::new()),
            Depth::Sixteen => Samples::U16(Vec::new()),
        };
        // Only a few rows are read at a time, because the pixels of all squares may take much memory.
        for rows in (y..y + height).step_by(ROWS) {
            let [top, bottom] = [at(rows, 1), at((rows + ROWS as u32).min(y + height), 1)];
            let pixels = self.source.part(Rect::new(left, top, right - left, bottom - top))?;
            match (pixels.samples(), &mut samples) {
                (Samples::U8(v), Samples::U8(out)) => {
                    out.extend(means(v, &pixels, (self.by, self.hidden), |v| v as u8))
                }
                (Samples::U16(v), Samples::U16(out)) => {
                    out.extend(means(v, &pixels, (self.by, self.hidden), |v| v as u16))
                }
                _ => unreachable!("a part has the depth of its picture"),
            }
        }
        Pixels::new(width, height, channels, samples)
    }
}

/// Returns the rounded means of squares of `by` × `by` pixels. Colours are weighted by their opacity, unless hidden
/// colours are kept.
fn means<T: Copy + Into<u64>>(
    samples: &[T],
    pixels: &Pixels,
    (by, hidden): (u32, HiddenColors),
    sample: impl Fn(u64) -> T,
) -> Vec<T> {
    let (channels, by) = (pixels.channels(), by as usize);
    let [width, height] = [pixels.width(), pixels.height()].map(|v| v as usize);
    let (count, alpha) = (channels.count(), channels.alpha().filter(|_| hidden == HiddenColors::Continue));
    let mut out = Vec::with_capacity(width.div_ceil(by) * height.div_ceil(by) * count);
    // Sums for each column of squares: each channel times its weight, the weights of the colours, and the number of
    // pixels.
    let mut sums = vec![[0u64; 6]; width.div_ceil(by)];
    for rows in samples.chunks(width * count * by) {
        sums.fill([0; 6]);
        for row in rows.chunks_exact(width * count) {
            for (square, sum) in row.chunks(count * by).zip(&mut sums) {
                for pixel in square.chunks_exact(count) {
                    let opacity: u64 = alpha.map_or(1, |a| pixel[a].into());
                    for (k, &v) in pixel.iter().enumerate() {
                        sum[k] += v.into() * if alpha == Some(k) { 1 } else { opacity };
                    }
                    sum[4] += opacity;
                    sum[5] += 1;
                }
            }
        }
        for sum in &sums {
            let mean = |k: usize| {
                let all = sum[if alpha == Some(k) { 5 } else { 4 }];
                // In a fully transparent square, any colour will do.
                (sum[k] + all / 2).checked_div(all).unwrap_or(0)
            };
            out.extend((0..count).map(|k| sample(mean(k))));
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_are_means_of_squares_weighted_by_opacity() {
        let values = [200, 255, 100, 0, 50, 255, 10, 255, 30, 85, 90, 170];
        let picture = Pixels::new(3, 2, Channels::GreyAlpha, Samples::U8(values.to_vec())).unwrap();
        let half = Shrunk::new(&picture, 2, HiddenColors::Continue);
        assert_eq!(half.size(), [2, 1]);
        let all = half.part(Rect::new(0, 0, 2, 1)).unwrap();
        let rounded = |v: f64| (v + 0.5) as u8;
        let grey = [(200.0 * 255.0 + 10.0 * 255.0 + 30.0 * 85.0) / 595.0, (50.0 * 255.0 + 90.0 * 170.0) / 425.0];
        let want = vec![rounded(grey[0]), rounded(595.0 / 4.0), rounded(grey[1]), rounded(425.0 / 2.0)];
        assert_eq!(all.samples(), &Samples::U8(want));
    }

    #[test]
    fn a_part_equals_the_same_area_of_the_downscaled_picture() {
        for channels in [Channels::Grey, Channels::Rgb, Channels::Rgba] {
            let (width, height) = (37u32, 70u32);
            let samples = (0..width * height * channels.count() as u32).map(|i| (i.wrapping_mul(40_503) >> 3) as u16);
            let picture = Pixels::new(width, height, channels, Samples::U16(samples.collect())).unwrap();
            for by in [1, 2, 4] {
                let small = Shrunk::new(&picture, by, HiddenColors::Continue);
                let [width, height] = small.size();
                let all = small.part(Rect::new(0, 0, width, height)).unwrap();
                for area in [[0, 0, 1, 1], [3, 2, 4, 3], [width - 2, height - 3, 2, 3]] {
                    assert_eq!(small.part(area.into()).unwrap(), all.part(area.into()).unwrap(), "{by} {area:?}");
                }
            }
        }
    }
}
