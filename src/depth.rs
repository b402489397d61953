//! The bit depth of samples.

/// Bits per sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[doc(alias = "bit_depth")]
pub enum Depth {
    /// 8 bits.
    #[default]
    Eight,
    /// 16 bits.
    Sixteen,
}

impl Depth {
    /// Returns the code value that represents 1.0: 255 or 65535.
    #[must_use]
    pub fn max(self) -> u16 {
        match self {
            Depth::Eight => 255,
            Depth::Sixteen => 65535,
        }
    }

    /// Returns the mean squared error that rounding to code values causes by itself, once in the source and once in
    /// decoding, where white is 1.0.
    #[cfg(feature = "encode")]
    pub(crate) fn rounding_error(self) -> f64 {
        2.0 / (12.0 * f64::from(self.max()).powi(2))
    }

    /// Returns the size of a sample in bytes: 1 or 2.
    #[must_use]
    pub fn bytes(self) -> usize {
        match self {
            Depth::Eight => 1,
            Depth::Sixteen => 2,
        }
    }
}
