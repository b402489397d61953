//! Interleaved pixels with 8 or 16 bits a sample: what goes into the encoder and comes out of the decoder.

use crate::error::{Error, Result};
use crate::gaussian::Channels;

/// The samples of a picture, row by row, channels interleaved.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Samples {
    /// 8 bits a sample; 255 is 1.0.
    U8(Vec<u8>),
    /// 16 bits a sample, native endian; 65535 is 1.0.
    U16(Vec<u16>),
}

/// Bits a sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Depth {
    /// 8 bits.
    #[default]
    Eight,
    /// 16 bits.
    Sixteen,
}

impl Depth {
    /// Returns the code value that stands for 1.0: 255 or 65535.
    #[must_use]
    pub fn max(self) -> f32 {
        match self {
            Depth::Eight => 255.0,
            Depth::Sixteen => 65535.0,
        }
    }

    /// Returns the mean squared error of a sample, in units of the white one's square, that rounding to code values makes by
    /// itself: once in the source, once when decoding.
    pub(crate) fn rounding_error(self) -> f64 {
        2.0 / (12.0 * f64::from(self.max()).powi(2))
    }

    /// Returns the bytes of a sample: 1 or 2.
    #[must_use]
    pub fn bytes(self) -> usize {
        match self {
            Depth::Eight => 1,
            Depth::Sixteen => 2,
        }
    }
}

/// A picture in pixels. It always has exactly width × height × channels samples.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Pixels {
    width: u32,
    height: u32,
    channels: Channels,
    samples: Samples,
}

impl Pixels {
    /// Makes a picture of `samples`, row by row with interleaved channels.
    ///
    /// # Errors
    /// [`Error::Parameter`] if a side is 0 or over 2²⁰, or the number of samples is not width × height × channels.
    pub fn new(width: u32, height: u32, channels: Channels, samples: Samples) -> Result<Self> {
        for (name, side) in [("width", width), ("height", height)] {
            if side == 0 || side > 1 << 20 {
                return Err(Error::Parameter { name, problem: format!("{side} is outside 1..=1048576") });
            }
        }
        let length = match &samples {
            Samples::U8(v) => v.len(),
            Samples::U16(v) => v.len(),
        };
        let want = u64::from(width) * u64::from(height) * channels.count() as u64;
        if length as u64 != want {
            return Err(Error::Parameter {
                name: "samples",
                problem: format!("{length} given where {want} are needed"),
            });
        }
        Ok(Pixels { width, height, channels, samples })
    }

    /// Width, pixels.
    #[must_use]
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Height, pixels.
    #[must_use]
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Channels.
    #[must_use]
    pub fn channels(&self) -> Channels {
        self.channels
    }

    /// Bits a sample.
    #[must_use]
    pub fn depth(&self) -> Depth {
        match self.samples {
            Samples::U8(_) => Depth::Eight,
            Samples::U16(_) => Depth::Sixteen,
        }
    }

    /// The samples.
    #[must_use]
    pub fn samples(&self) -> &Samples {
        &self.samples
    }

    /// Returns the samples.
    #[must_use]
    pub fn into_samples(self) -> Samples {
        self.samples
    }

    /// The sample at index `i` as a value where 1.0 is white.
    pub(crate) fn value(&self, i: usize) -> f32 {
        match &self.samples {
            Samples::U8(v) => f32::from(v[i]) / 255.0,
            Samples::U16(v) => f32::from(v[i]) / 65535.0,
        }
    }
}
