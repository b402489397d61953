//! Options of the decoder.

use crate::limits::Limits;
use crate::rect::Rect;

/// Treatment of truncated and damaged files.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
#[non_exhaustive]
pub enum Damage {
    /// Return an error.
    #[default]
    Refuse,
    /// Draw the groups that are intact, if the file has any, and report the numbers of missing parts.
    Accept,
}

/// Layers of a file to draw.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
#[non_exhaustive]
pub enum Layers {
    /// All layers of the file: the picture.
    #[default]
    Both,
    /// The Gaussians alone: the detail layer and the exact layer are not read.
    Gaussians,
    /// The detail layer alone, on middle grey. A file without one gives plain grey.
    Detail,
}

/// Options of [`Decoder`](crate::Decoder).
#[derive(Debug, Clone, PartialEq, Eq, Default)]
#[non_exhaustive]
pub struct DecodeOptions {
    /// Limits on size, memory and work.
    pub limits: Limits,
    /// The part to draw, in pixels of the picture; `None`: all of it.
    pub region: Option<Rect>,
    /// Width and height of the output, pixels; `None`: those of the region. Larger ones sample the continuous picture,
    /// smaller ones are low-passed as [`View::resized`](crate::raster::View::resized) says.
    pub size: Option<[u32; 2]>,
    /// Treatment of truncated and damaged files.
    pub damage: Damage,
    /// Layers to draw.
    pub layers: Layers,
}
