//! Code values of either depth, written into the caller's buffer.

use crate::pixels::{Depth, Samples};
use crate::simd::{LANES, Simd};

/// Output buffer of a renderer: rows one after the other, from the top, with interleaved channels.
#[derive(Debug)]
pub enum SamplesMut<'a> {
    /// 8 bits per sample; 255 is 1.0.
    U8(&'a mut [u8]),
    /// 16 bits per sample, native endian; 65535 is 1.0.
    U16(&'a mut [u16]),
}

impl SamplesMut<'_> {
    /// Returns the number of bits per sample.
    #[must_use]
    pub fn depth(&self) -> Depth {
        match self {
            SamplesMut::U8(_) => Depth::Eight,
            SamplesMut::U16(_) => Depth::Sixteen,
        }
    }

    /// Returns the number of samples.
    pub(crate) fn count(&self) -> usize {
        match self {
            SamplesMut::U8(samples) => samples.len(),
            SamplesMut::U16(samples) => samples.len(),
        }
    }
}

/// Reusable buffers for code values of either depth.
#[derive(Debug, Default)]
pub(super) struct Codes {
    eight: Vec<u8>,
    sixteen: Vec<u16>,
}

/// A code value.
pub(super) trait Sample: Copy + Default + Send + Sync + Into<f32> {
    /// The code value of white.
    const WHITE: f32;

    /// Returns the buffer of this depth.
    fn codes(codes: &mut Codes) -> &mut Vec<Self>;

    /// `floor(v)` for `0 ≤ v < WHITE + 1`.
    fn floor(v: f32) -> Self;

    /// Writes eight pixels with interleaved channels from code values, which are rounded down.
    fn store<S: Simd, const C: usize>(simd: S, to: &mut [Self], v: [S::Vector; C]);

    /// Copies exact samples, from position `at` on, and converts them to this depth.
    fn copy_exact(samples: &Samples, at: usize, to: &mut [Self]);
}

impl Sample for u8 {
    const WHITE: f32 = 255.0;

    fn codes(codes: &mut Codes) -> &mut Vec<u8> {
        &mut codes.eight
    }

    #[inline(always)]
    fn floor(v: f32) -> u8 {
        v as u8
    }

    #[inline(always)]
    fn store<S: Simd, const C: usize>(simd: S, to: &mut [u8], v: [S::Vector; C]) {
        if let (&[r, g, b], Ok(to)) = (v.as_slice(), <&mut [u8; 3 * LANES]>::try_from(&mut *to)) {
            simd.store_rgb(to, [r, g, b]);
            return;
        }
        let mut codes = [[0; LANES]; C];
        for (codes, v) in codes.iter_mut().zip(v) {
            *codes = simd.floor(v);
        }
        for (i, pixel) in to.chunks_exact_mut(C).enumerate() {
            for c in 0..C {
                pixel[c] = codes[c][i] as u8;
            }
        }
    }

    fn copy_exact(samples: &Samples, at: usize, to: &mut [u8]) {
        match samples {
            Samples::U8(v) => to.copy_from_slice(&v[at..][..to.len()]),
            // Rounds to the nearest of the values `257·v`.
            Samples::U16(v) => {
                to.iter_mut().zip(&v[at..]).for_each(|(to, &v)| *to = ((u32::from(v) + 128) / 257) as u8)
            }
        }
    }
}

impl Sample for u16 {
    const WHITE: f32 = 65535.0;

    fn codes(codes: &mut Codes) -> &mut Vec<u16> {
        &mut codes.sixteen
    }

    #[inline(always)]
    fn floor(v: f32) -> u16 {
        v as u16
    }

    #[inline(always)]
    fn store<S: Simd, const C: usize>(simd: S, to: &mut [u16], v: [S::Vector; C]) {
        let mut codes = [[0; LANES]; C];
        for (codes, v) in codes.iter_mut().zip(v) {
            *codes = simd.floor(v);
        }
        for (i, pixel) in to.chunks_exact_mut(C).enumerate() {
            for c in 0..C {
                pixel[c] = codes[c][i] as u16;
            }
        }
    }

    fn copy_exact(samples: &Samples, at: usize, to: &mut [u16]) {
        match samples {
            Samples::U8(v) => to.iter_mut().zip(&v[at..]).for_each(|(to, &v)| *to = 257 * u16::from(v)),
            Samples::U16(v) => to.copy_from_slice(&v[at..][..to.len()]),
        }
    }
}
