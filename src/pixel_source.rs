//! Pictures whose pixels are read in parts.

use crate::error::Result;
use crate::gaussian::Channels;
use crate::parameter::Parameter;
use crate::pixels::{Depth, Pixels, Samples};
use crate::rect::Rect;

/// A picture whose parts can be read by several threads at a time: a picture in memory, or a file of samples that is
/// larger than memory.
#[doc(alias("streaming", "tiles"))]
pub trait PixelSource: Sync {
    /// Returns the width, pixels.
    fn width(&self) -> u32;
    /// Returns the height, pixels.
    fn height(&self) -> u32;
    /// Returns the channels.
    fn channels(&self) -> Channels;
    /// Returns the number of bits per sample.
    fn depth(&self) -> Depth;
    /// Returns width and height, pixels.
    fn size(&self) -> [u32; 2] {
        [self.width(), self.height()]
    }
    /// Returns the pixels if they are in memory as [`Pixels`].
    fn as_pixels(&self) -> Option<&Pixels> {
        None
    }
    /// Returns the pixels of a part.
    ///
    /// # Errors
    /// [`Error::Parameter`](crate::Error::Parameter) if the part is empty or not within the picture, and errors of
    /// reading, such as [`Error::Io`](crate::Error::Io).
    fn part(&self, area: Rect) -> Result<Pixels>;
}

impl PixelSource for Pixels {
    fn width(&self) -> u32 {
        Pixels::width(self)
    }

    fn height(&self) -> u32 {
        Pixels::height(self)
    }

    fn channels(&self) -> Channels {
        Pixels::channels(self)
    }

    fn depth(&self) -> Depth {
        Pixels::depth(self)
    }

    fn as_pixels(&self) -> Option<&Pixels> {
        Some(self)
    }

    fn part(&self, area: Rect) -> Result<Pixels> {
        fn cut<T: Copy>(
            samples: &[T],
            row: usize,
            rows: std::ops::Range<usize>,
            columns: std::ops::Range<usize>,
        ) -> Vec<T> {
            rows.flat_map(|y| samples[y * row..][columns.clone()].iter().copied()).collect()
        }
        check_area(area, [self.width(), self.height()])?;
        let [x, y, width, height] = <[u32; 4]>::from(area).map(|v| v as usize);
        let count = self.channels().count();
        let (row, rows, columns) =
            (Pixels::width(self) as usize * count, y..y + height, x * count..(x + width) * count);
        let samples = match self.samples() {
            Samples::U8(v) => Samples::U8(cut(v, row, rows, columns)),
            Samples::U16(v) => Samples::U16(cut(v, row, rows, columns)),
        };
        Pixels::new(area.width, area.height, self.channels(), samples)
    }
}

/// Checks that a part is not empty and lies within a picture of `size`.
///
/// # Errors
/// [`Error::Parameter`](crate::Error::Parameter) if it does not.
pub fn check_area(area: Rect, size: [u32; 2]) -> Result<()> {
    area.check(Parameter::Area, size)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::Error;

    #[test]
    fn a_part_has_the_samples_of_its_place() {
        let samples: Vec<u16> = (0..5 * 4 * 3).collect();
        let pixels = Pixels::new(5, 4, Channels::Rgb, Samples::U16(samples)).unwrap();
        let part = pixels.part(Rect::new(3, 1, 2, 2)).unwrap();
        assert_eq!((part.width(), part.height(), part.depth()), (2, 2, Depth::Sixteen));
        assert_eq!(part.samples(), &Samples::U16(vec![24, 25, 26, 27, 28, 29, 39, 40, 41, 42, 43, 44]));
        assert_eq!(pixels.part(Rect::new(0, 0, 5, 4)).unwrap(), pixels);
        for area in [[0, 0, 6, 1], [0, 0, 0, 1], [4, 0, u32::MAX, 1], [0, 4, 1, 1]] {
            assert!(
                matches!(pixels.part(area.into()), Err(Error::Parameter { parameter: Parameter::Area, .. })),
                "{area:?}"
            );
        }
    }
}
