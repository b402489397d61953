//! Names in errors: the parameter that is wrong, and the limit that is exceeded.

use std::fmt;

/// What an [`Error::Parameter`](crate::Error::Parameter) is about: an option, an argument or a part of one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Parameter {
    /// Answer of a worker to a task.
    Answer,
    /// Part of a picture that is read.
    Area,
    /// Device that fits the picture.
    Backend,
    /// Background of given Gaussians.
    Background,
    /// Rule that combines the Gaussians.
    Blend,
    /// Size of the file, or the bytes of a task or an answer.
    Bytes,
    /// Code points of colours.
    Cicp,
    /// Colour of a Gaussian.
    Color,
    /// Colour type of a picture of the `image` crate.
    ColorType,
    /// Detail layer of the file.
    Detail,
    /// Amount of work.
    Effort,
    /// Gaussians to render.
    Gaussians,
    /// Height of a picture or a view.
    Height,
    /// Number of progressive levels.
    Levels,
    /// Centre of a Gaussian.
    Mean,
    /// Memory for the output.
    Out,
    /// Path of the output.
    Path,
    /// Pixels of a picture.
    Pixels,
    /// Precision of given Gaussians.
    Precision,
    /// PSNR of the file.
    Psnr,
    /// Perceptual quality of the file.
    Quality,
    /// Ratio of the raw size to the file size.
    Ratio,
    /// Region of a picture.
    Region,
    /// Rotation of a Gaussian.
    Rotation,
    /// Samples of a picture.
    Samples,
    /// Scale of a Gaussian.
    Scale,
    /// Seed of the random numbers.
    Seed,
    /// Task of a worker.
    Task,
    /// Texture that is rendered to.
    Texture,
    /// Thumbnail in the file.
    Thumbnail,
    /// Side of the tiles.
    Tiles,
    /// Time limit of the encode.
    Time,
    /// Quality measure of the fit.
    Tune,
    /// View to render.
    View,
    /// Width of a picture or a view.
    Width,
    /// Another value, by its name: a field of the format, or an argument of a program that uses this crate.
    Other(&'static str),
}

impl Parameter {
    /// Returns the name in messages, such as `effort`.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Parameter::Answer => "answer",
            Parameter::Area => "area",
            Parameter::Backend => "backend",
            Parameter::Background => "background",
            Parameter::Blend => "blend",
            Parameter::Bytes => "bytes",
            Parameter::Cicp => "cicp",
            Parameter::Color => "color",
            Parameter::ColorType => "color type",
            Parameter::Detail => "detail",
            Parameter::Effort => "effort",
            Parameter::Gaussians => "gaussians",
            Parameter::Height => "height",
            Parameter::Levels => "levels",
            Parameter::Mean => "mean",
            Parameter::Out => "out",
            Parameter::Path => "path",
            Parameter::Pixels => "pixels",
            Parameter::Precision => "precision",
            Parameter::Psnr => "psnr",
            Parameter::Quality => "quality",
            Parameter::Ratio => "ratio",
            Parameter::Region => "region",
            Parameter::Rotation => "rotation",
            Parameter::Samples => "samples",
            Parameter::Scale => "scale",
            Parameter::Seed => "seed",
            Parameter::Task => "task",
            Parameter::Texture => "texture",
            Parameter::Thumbnail => "thumbnail",
            Parameter::Tiles => "tiles",
            Parameter::Time => "time",
            Parameter::Tune => "tune",
            Parameter::View => "view",
            Parameter::Width => "width",
            Parameter::Other(name) => name,
        }
    }
}

impl fmt::Display for Parameter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// The field of [`Limits`](crate::Limits) that an [`Error::LimitExceeded`](crate::Error::LimitExceeded) is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Limit {
    /// [`Limits::width`](crate::Limits::width).
    Width,
    /// [`Limits::height`](crate::Limits::height).
    Height,
    /// [`Limits::gaussians`](crate::Limits::gaussians).
    Gaussians,
    /// [`Limits::tile_pairs`](crate::Limits::tile_pairs).
    TilePairs,
    /// [`Limits::work`](crate::Limits::work), or [`Limits::overlap`](crate::Limits::overlap).
    Work,
    /// [`Limits::alloc`](crate::Limits::alloc).
    Alloc,
    /// [`Limits::metadata`](crate::Limits::metadata).
    Metadata,
}

impl Limit {
    /// Returns the name of the field, such as `alloc`.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Limit::Width => "width",
            Limit::Height => "height",
            Limit::Gaussians => "gaussians",
            Limit::TilePairs => "tile_pairs",
            Limit::Work => "work",
            Limit::Alloc => "alloc",
            Limit::Metadata => "metadata",
        }
    }
}

impl fmt::Display for Limit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}
