//! Colours as single numbers.

/// A colour as a number, the first channel in the lowest bits. Those with 16 bits for each channel are those of the
/// specification; those with 8 bits take half the memory, for pictures of 8 bits.
pub(super) trait Packed: Copy + Eq {
    const ZERO: Self;

    /// Returns the number with 16 bits for each channel.
    fn wide(self) -> u64;

    /// Returns the colour of a number with 16 bits for each channel, whose samples fit.
    fn of(wide: u64) -> Self;

    /// Returns any other number of 32 bits.
    fn number(self) -> u32;

    /// Stores any other number of 32 bits.
    fn of_number(number: u32) -> Self;
}

impl Packed for u64 {
    const ZERO: Self = 0;

    #[inline(always)]
    fn wide(self) -> u64 {
        self
    }

    #[inline(always)]
    fn of(wide: u64) -> Self {
        wide
    }

    #[inline(always)]
    fn number(self) -> u32 {
        self as u32
    }

    #[inline(always)]
    fn of_number(number: u32) -> Self {
        number.into()
    }
}

impl Packed for u32 {
    const ZERO: Self = 0;

    #[inline(always)]
    fn wide(self) -> u64 {
        let wide = u64::from(self);
        let wide = (wide | wide << 16) & 0x0000_ffff_0000_ffff;
        (wide | wide << 8) & 0x00ff_00ff_00ff_00ff
    }

    #[inline(always)]
    fn of(wide: u64) -> Self {
        let narrow = (wide | wide >> 8) & 0x0000_ffff_0000_ffff;
        (narrow | narrow >> 16) as u32
    }

    #[inline(always)]
    fn number(self) -> u32 {
        self
    }

    #[inline(always)]
    fn of_number(number: u32) -> Self {
        number
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn narrow_colours_have_the_same_samples() {
        for color in [0u32, 0x0403_0201, 0xff80_fe7f, u32::MAX] {
            let wide = color.wide();
            for k in 0..4 {
                assert_eq!(wide >> (16 * k) & 0xffff, u64::from(color >> (8 * k) & 0xff), "{color:x}");
            }
            assert_eq!(u32::of(wide), color);
        }
    }
}
