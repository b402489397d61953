//! The part of their range that the samples of a picture with 16 bits use. Medical and satellite pictures often use the
//! lowest 10 or 12 bits, or less.

use crate::pixels::{Pixels, Samples};

/// Part of the range below which a picture counts as narrow. The finest steps of the colours of Gaussians are then too
/// coarse for it (spec §5.1), and its contrasts are too weak to be measured as they are seen.
const NARROW: u16 = u16::MAX / 8;

/// The smallest and the largest sample of the visible colours of a narrow picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct UsedRange {
    low: u16,
    high: u16,
}

impl UsedRange {
    /// Returns the range of `pixels`. Returns `None` if it is not narrow, or if the picture has 8 bits or no visible
    /// colours.
    pub(crate) fn narrow(pixels: &Pixels) -> Option<UsedRange> {
        UsedRange::of(pixels)?.if_narrow()
    }

    /// Returns the range of `pixels`, however wide. Returns `None` if the picture has 8 bits or no visible colours.
    pub(crate) fn of(pixels: &Pixels) -> Option<UsedRange> {
        let Samples::U16(samples) = pixels.samples() else { return None };
        let (count, alpha) = (pixels.channels().count(), pixels.channels().alpha());
        let colors = count - usize::from(alpha.is_some());
        let (mut low, mut high) = (u16::MAX, 0);
        for pixel in samples.chunks_exact(count).filter(|p| alpha.is_none_or(|a| p[a] > 0)) {
            for &v in &pixel[..colors] {
                (low, high) = (low.min(v), high.max(v));
            }
        }
        (low <= high).then_some(UsedRange { low, high })
    }

    /// Returns the range of two parts together.
    pub(crate) fn and(self, other: Self) -> Self {
        UsedRange { low: self.low.min(other.low), high: self.high.max(other.high) }
    }

    /// Returns the range if it is narrow.
    pub(crate) fn if_narrow(self) -> Option<Self> {
        (self.high - self.low < NARROW).then_some(self)
    }

    /// Returns the number of values between the smallest and the largest sample, both included.
    pub(crate) fn levels(self) -> u32 {
        u32::from(self.high - self.low) + 1
    }

    /// Returns the factor by which [`stretched`](Self::stretched) increases contrasts.
    pub(crate) fn factor(self) -> f32 {
        f32::from(u16::MAX) / f32::from((self.high - self.low).max(1))
    }

    /// Returns `pixels` with the colours of this range stretched to the whole range. Colours outside it are clamped.
    #[cfg(any(test, feature = "quality-hook"))]
    pub(crate) fn stretched(self, pixels: &Pixels) -> Pixels {
        let Samples::U16(samples) = pixels.samples() else { return pixels.clone() };
        let (count, alpha) = (pixels.channels().count(), pixels.channels().alpha());
        let span = u32::from((self.high - self.low).max(1));
        let stretch = |v: u16| {
            let above = u32::from(v.clamp(self.low, self.high) - self.low);
            ((above * u32::from(u16::MAX) + span / 2) / span) as u16
        };
        let of = |(i, &v): (usize, &u16)| if alpha == Some(i % count) { v } else { stretch(v) };
        let stretched = samples.iter().enumerate().map(of).collect();
        Pixels::new(pixels.width(), pixels.height(), pixels.channels(), Samples::U16(stretched)).expect("the same size")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gaussian::Channels;

    #[test]
    fn the_range_is_that_of_visible_colours_and_stretches_to_all_values() {
        let samples = vec![1000, 65535, 1400, 30_000, 40_000, 0, 1200, 1];
        let pixels = Pixels::new(4, 1, Channels::GreyAlpha, Samples::U16(samples)).unwrap();
        let range = UsedRange::narrow(&pixels).unwrap();
        assert_eq!((range.low, range.high, range.levels()), (1000, 1400, 401));
        let Samples::U16(stretched) = range.stretched(&pixels).into_samples() else { panic!() };
        assert_eq!(stretched, [0, 65535, 65535, 30_000, 65535, 0, 32768, 1]);
    }

    #[test]
    fn wide_ranges_and_8_bits_are_not_narrow() {
        let grey = |samples| Pixels::new(2, 1, Channels::Grey, samples).unwrap();
        assert_eq!(UsedRange::narrow(&grey(Samples::U16(vec![0, NARROW]))), None);
        assert!(UsedRange::narrow(&grey(Samples::U16(vec![5, NARROW + 4]))).is_some());
        assert_eq!(UsedRange::narrow(&grey(Samples::U8(vec![5, 6]))), None);
    }
}
