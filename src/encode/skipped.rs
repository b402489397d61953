//! Parts of an encode that can be skipped.

use std::fmt;

/// A part that the encoder skipped because the picture or the options do not need it, or because it was not available.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Skipped {
    /// The part that was skipped, and why.
    pub what: SkipReason,
    /// Bytes saved. It is 0 if nothing was saved, if only time was saved (and spent on quality), or if it was not
    /// measured.
    pub bytes: u64,
    /// Seconds saved, estimated from the cost of one iteration. It is 0 if that is not known.
    pub seconds: f64,
}

/// A part of an encode that can be skipped. It is displayed as the name of the part, a colon and the reason.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum SkipReason {
    /// Alpha, because all pixels are opaque.
    Alpha,
    /// Colour, because all pixels are grey.
    Color,
    /// Colour and alpha, because all pixels are grey and opaque.
    ColorAndAlpha,
    /// Colours under alpha 0, which are replaced with a continuation of the visible ones.
    HiddenColors,
    /// The weights of [`Tune::Iq`](crate::Tune::Iq), because the picture is so uniform that they are the same
    /// everywhere.
    StructureWeights,
    /// The fit, because the picture has only one colour.
    Fit,
    /// Gaussians, because the contrasts of the picture are finer than the steps of their colours. It is one colour with a
    /// detail layer instead.
    Contrasts {
        /// Number of sample values between the smallest and the largest of the picture.
        levels: u32,
    },
    /// Gaussians and a detail layer, because the picture itself, without loss, needs no more bytes.
    Loss,
    /// Gaussians and a detail layer in a part of the picture or all of it, because an exact layer with colours near those
    /// of the picture is better.
    NearColors,
    /// The last iterations, because the error was already small enough.
    Iterations,
    /// Gaussians, because the error stays small enough without them.
    Gaussians,
    /// A separate colour for each Gaussian, because a codebook is smaller.
    OwnColors,
    /// The GPU, if the encoder might have used one.
    Gpu {
        /// Reason why it was not used.
        reason: String,
    },
}

impl fmt::Display for SkipReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            SkipReason::Alpha => "alpha: all pixels are opaque",
            SkipReason::Color => "colour: all pixels are grey",
            SkipReason::ColorAndAlpha => "colour and alpha: all pixels are grey and opaque",
            SkipReason::HiddenColors => "colours under alpha 0: they are invisible",
            SkipReason::StructureWeights => "weights of pixels: the picture is so uniform that all weights are equal",
            SkipReason::Fit => "the fit: the picture has a single colour",
            SkipReason::Contrasts { levels } => {
                return write!(
                    f,
                    "Gaussians: the samples use {levels} of 65536 values, and the steps of a detail layer, 4 and more, are \
                     finer than those of Gaussians; decoders may differ by up to 257 values"
                );
            }
            SkipReason::Loss => "Gaussians and a detail layer: the picture without loss needs no more bytes",
            SkipReason::NearColors => "Gaussians and a detail layer: colours near those of the picture are better",
            SkipReason::Iterations => "iterations: the error is below the rounding error, or well below the target",
            SkipReason::Gaussians => {
                "Gaussians: without them, the error stays below the rounding error or the target"
            }
            SkipReason::OwnColors => "a separate colour for each Gaussian: a codebook is smaller",
            SkipReason::Gpu { reason } => return write!(f, "the GPU: {reason}"),
        })
    }
}
