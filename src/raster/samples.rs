//! Code values of either depth, written into the caller's buffer.

use crate::pixels::Depth;

/// Where a band of pixels goes: rows one after the other, channels interleaved.
#[derive(Debug)]
pub enum SamplesMut<'a> {
    /// 8 bits a sample.
    U8(&'a mut [u8]),
    /// 16 bits a sample, native endian.
    U16(&'a mut [u16]),
}

impl SamplesMut<'_> {
    /// Bits a sample.
    #[must_use]
    pub fn depth(&self) -> Depth {
        match self {
            SamplesMut::U8(_) => Depth::Eight,
            SamplesMut::U16(_) => Depth::Sixteen,
        }
    }
}

/// A code value.
pub(super) trait Sample: Copy + Default + Send + Sync {
    /// The code value of white.
    const WHITE: f32;

    /// The code value from an integer within `0..=WHITE`.
    fn from_code(code: i32) -> Self;
}

impl Sample for u8 {
    const WHITE: f32 = 255.0;

    #[inline(always)]
    fn from_code(code: i32) -> Self {
        code as u8
    }
}

impl Sample for u16 {
    const WHITE: f32 = 65535.0;

    #[inline(always)]
    fn from_code(code: i32) -> Self {
        code as u16
    }
}
