//! Interleaved pixels with 8 or 16 bits per sample: the input of the encoder and the output of the decoder.

pub use crate::depth::Depth;
use crate::error::{Error, Result};
use crate::gaussian::Channels;
use crate::parameter::Parameter;

/// The samples of a picture, row by row, channels interleaved.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Samples {
    /// 8 bits per sample; 255 is 1.0.
    U8(Vec<u8>),
    /// 16 bits per sample, native endian; 65535 is 1.0.
    U16(Vec<u16>),
}

impl From<Vec<u8>> for Samples {
    fn from(samples: Vec<u8>) -> Self {
        Samples::U8(samples)
    }
}

impl From<&[u8]> for Samples {
    fn from(samples: &[u8]) -> Self {
        Samples::U8(samples.to_vec())
    }
}

impl From<Vec<u16>> for Samples {
    fn from(samples: Vec<u16>) -> Self {
        Samples::U16(samples)
    }
}

impl From<&[u16]> for Samples {
    fn from(samples: &[u16]) -> Self {
        Samples::U16(samples.to_vec())
    }
}

/// A picture of pixels. It always has exactly width × height × channels samples.
#[derive(Debug, Clone, PartialEq, Eq)]
#[doc(alias("bitmap", "image_buffer"))]
pub struct Pixels {
    width: u32,
    height: u32,
    channels: Channels,
    samples: Samples,
}

impl Pixels {
    /// Returns a picture with these `samples`: rows from the top, channels interleaved. They are of 8 bits (`Vec<u8>`,
    /// `&[u8]`), of 16 bits (`Vec<u16>`, `&[u16]`), or [`Samples`].
    ///
    /// # Errors
    /// [`Error::Parameter`] if a side is 0 or over 2²⁰, or if the number of samples is not width × height × channels.
    pub fn new(width: u32, height: u32, channels: Channels, samples: impl Into<Samples>) -> Result<Self> {
        let samples = samples.into();
        for (parameter, side) in [(Parameter::Width, width), (Parameter::Height, height)] {
            if side == 0 || side > 1 << 20 {
                return Err(Error::Parameter { parameter, problem: format!("{side} is outside 1..=1048576") });
            }
        }
        let length = match &samples {
            Samples::U8(v) => v.len(),
            Samples::U16(v) => v.len(),
        };
        let want = u64::from(width) * u64::from(height) * channels.count() as u64;
        if length as u64 != want {
            return Err(Error::Parameter {
                parameter: Parameter::Samples,
                problem: format!("{length} given where {want} are needed"),
            });
        }
        Ok(Pixels { width, height, channels, samples })
    }

    /// Returns the width, pixels.
    #[must_use]
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Returns the height, pixels.
    #[must_use]
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Returns the channels.
    #[must_use]
    pub fn channels(&self) -> Channels {
        self.channels
    }

    /// Returns the number of bits per sample.
    #[must_use]
    pub fn depth(&self) -> Depth {
        match self.samples {
            Samples::U8(_) => Depth::Eight,
            Samples::U16(_) => Depth::Sixteen,
        }
    }

    /// Returns the samples: rows from the top, channels interleaved.
    #[must_use]
    pub fn samples(&self) -> &Samples {
        &self.samples
    }

    /// Returns the samples without copying them.
    #[must_use]
    pub fn into_samples(self) -> Samples {
        self.samples
    }

    /// Returns the sample at index `i` as a value where 1.0 is white.
    #[cfg(feature = "encode")]
    pub(crate) fn value(&self, i: usize) -> f32 {
        match &self.samples {
            Samples::U8(v) => f32::from(v[i]) / 255.0,
            Samples::U16(v) => f32::from(v[i]) / 65535.0,
        }
    }
}
