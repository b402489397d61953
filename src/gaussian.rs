//! The picture as a function of the plane: 2D Gaussians, their blend and their background (spec §5).
//!
//! Lengths are pixels of the picture's own grid with pixel centres at `+0.5`; angles are radians;
//! colours are encoded sRGB values where 0 is black and 1 is white, not bounded to that range.

use bytemuck::{Pod, Zeroable};

/// Radius of a primitive's support in units of its scales (spec §5.2).
pub const CUTOFF: f32 = 3.5;

/// Offset subtracted from a Gaussian's weight so that it is continuous at the edge of the support: `exp(−CUTOFF²/2)`.
pub const CUTOFF_WEIGHT: f32 = 0.002_187_491_1;

/// Regularizer of the division in the normalized blend: `ε` of spec §5.3.
pub const EPSILON: f32 = 1.0 / 128.0;

/// Value added to a sample's alpha to give the weight of its colour in the mean of a reduced view: `η` of spec §5.5.
pub const HIDDEN: f32 = 1.0 / 4096.0;

/// Smallest legal scale, pixels.
pub const MIN_SCALE: f32 = 0.25;

/// Largest legal scale, pixels.
pub const MAX_SCALE: f32 = 1_048_576.0;

/// One primitive: a 2D Gaussian with a constant colour.
#[derive(Debug, Clone, Copy, PartialEq, Default, Pod, Zeroable)]
#[repr(C)]
pub struct Gaussian {
    /// Centre `μ`, pixels.
    pub mean: [f32; 2],
    /// Standard deviations `s₁ ≥ s₂ > 0` along the major and the minor axis, pixels.
    pub scale: [f32; 2],
    /// Direction of the major axis, radians, period π.
    pub rotation: f32,
    /// Colour, one value per channel in the order of [`Channels`]; unused ones are 0.
    pub color: [f32; 4],
}

impl Gaussian {
    /// Half width and half height of the bounding box of the support, pixels.
    #[must_use]
    pub fn extent(&self) -> [f32; 2] {
        let (sin, cos) = self.rotation.sin_cos();
        let [s1, s2] = self.scale;
        [CUTOFF * (s1 * cos).hypot(s2 * sin), CUTOFF * (s1 * sin).hypot(s2 * cos)]
    }
}

/// Rule by which primitives are combined into a colour (spec §5.3). `wᵢ` and `cᵢ` are the weights and colours of the
/// primitives, `b` is the background and `ε` is 1/128.
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
    /// Number of channels, 1 to 4.
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

    /// Returns the index of the alpha channel, if there is one.
    #[must_use]
    pub fn alpha(self) -> Option<usize> {
        match self {
            Channels::GreyAlpha => Some(1),
            Channels::Rgba => Some(3),
            _ => None,
        }
    }
}

/// A picture as Gaussians with float parameters, ready to be rasterized.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// Channels of the colours.
    pub channels: Channels,
    /// Rule by which the primitives are combined.
    pub blend: Blend,
    /// Background colour `b`.
    pub background: [f32; 4],
    /// The primitives, in any order.
    pub gaussians: Vec<Gaussian>,
}
