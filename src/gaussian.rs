//! The picture as a continuous function of position: 2D Gaussians, blending and background (spec §5).
//!
//! Lengths are in pixels of the picture's own grid, and pixel centres are at `+0.5`. Angles are in radians. Colours
//! are encoded sRGB values, where 0 is black and 1 is white; they may lie outside that range.

use crate::depth::Depth;

/// Radius of a Gaussian's support in units of its scales (spec §5.2).
pub const CUTOFF: f32 = 3.5;

/// Offset subtracted from a Gaussian's weight so that it is continuous at the edge of the support: `exp(−CUTOFF²/2)`.
pub const CUTOFF_WEIGHT: f32 = 0.002_187_491_1;

/// Regularizer of the division in the normalized blend: `ε` of spec §5.3.
pub const EPSILON: f32 = 1.0 / 128.0;

/// Value added to the alpha of a sample when it weighs the sample's colour in a reduced view: `η` of spec §5.5.
pub const HIDDEN: f32 = 1.0 / 4096.0;

/// Smallest scale that the format allows, pixels.
#[cfg(feature = "encode")]
pub const MIN_SCALE: f32 = 0.25;

/// Largest scale that the format allows, pixels.
#[cfg(feature = "encode")]
#[cfg(feature = "encode")]
pub const MAX_SCALE: f32 = 1_048_576.0;

/// One Gaussian: a 2D Gaussian with a constant colour.
///
/// Rust, Python and JavaScript have its values in the same order and units: mean x and y (pixels, the centre of the
/// first pixel is at (0.5, 0.5)), scale along the major and the minor axis (pixels), rotation (radians, from x towards
/// y), and the colour, one value per channel (encoded sRGB, 0 is black and 1 is white).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "gpu", derive(bytemuck::Pod, bytemuck::Zeroable))]
#[repr(C)]
#[doc(alias("splat", "primitive"))]
pub struct Gaussian {
    /// Centre `μ`, pixels.
    pub mean: [f32; 2],
    /// Standard deviations `s₁ ≥ s₂ > 0` along the major and the minor axis, pixels.
    pub scale: [f32; 2],
    /// Direction of the major axis, radians, period π.
    pub rotation: f32,
    /// Colour, one value per channel in the order of [`Channels`]. The values of unused channels are 0.
    pub color: [f32; 4],
}

impl Gaussian {
    /// Returns the half width and the half height of the bounding box of the support, pixels.
    #[must_use]
    pub fn extent(&self) -> [f32; 2] {
        let (sin, cos) = self.rotation.sin_cos();
        let [s1, s2] = self.scale;
        [CUTOFF * (s1 * cos).hypot(s2 * sin), CUTOFF * (s1 * sin).hypot(s2 * cos)]
    }
}

/// Rule that combines the Gaussians of a picture into a colour (spec §5.3). `wᵢ` and `cᵢ` are the weights and colours
/// of the Gaussians, `b` is the background and `ε` is 1/128.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
pub enum Blend {
    /// `I(x) = (Σ wᵢ cᵢ + ε b) / (Σ wᵢ + ε)`.
    #[default]
    Normalized,
    /// `I(x) = b + Σ wᵢ cᵢ`.
    Sum,
}

/// The channels of a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Channels {
    /// Grey.
    Grey,
    /// Grey and straight alpha.
    GreyAlpha,
    /// Red, green, blue.
    Rgb,
    /// Red, green, blue and straight alpha.
    Rgba,
}

impl Channels {
    /// Returns the number of channels, 1 to 4.
    #[must_use]
    pub fn count(self) -> usize {
        match self {
            Channels::Grey => 1,
            Channels::GreyAlpha => 2,
            Channels::Rgb => 3,
            Channels::Rgba => 4,
        }
    }

    /// Returns the channels of a picture with `count` of them, or `None` unless `count` is in `1..=4`.
    #[must_use]
    pub fn from_count(count: usize) -> Option<Self> {
        [Channels::Grey, Channels::GreyAlpha, Channels::Rgb, Channels::Rgba].into_iter().find(|c| c.count() == count)
    }

    /// Returns the index of the alpha channel, or `None` if there is none.
    #[must_use]
    pub fn alpha(self) -> Option<usize> {
        match self {
            Channels::GreyAlpha => Some(1),
            Channels::Rgba => Some(3),
            _ => None,
        }
    }
}

/// A picture as Gaussians with float parameters: what a file stores
/// ([`SsplatImage::gaussians`](crate::SsplatImage::gaussians)), and what [`Renderer`](crate::Renderer) and
/// `Encoder::encode_gaussians` take.
///
/// A file can also have a detail layer, which is not part of this.
#[derive(Debug, Clone, PartialEq)]
pub struct Gaussians {
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// Channels of the colours.
    pub channels: Channels,
    /// Number of bits per sample of the picture that a file of these Gaussians represents.
    /// [`Renderer`](crate::Renderer) renders at any depth.
    pub depth: Depth,
    /// Rule that combines the Gaussians.
    pub blend: Blend,
    /// Background colour `b`.
    pub background: [f32; 4],
    /// The Gaussians, in any order.
    pub list: Vec<Gaussian>,
}
