//! Things that an encode can leave out.

use std::fmt;

/// Something that the encoder left out, because the picture or the options do not need it or because it was not
/// available.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Skipped {
    /// Name of the thing and the reason.
    pub what: SkipReason,
    /// Bytes saved; 0 if nothing was saved, if only time was (which then buys quality), or if it was not measured.
    pub bytes: u64,
    /// Seconds saved, estimated from the cost of one iteration; 0 where that is not known.
    pub seconds: f64,
}

/// Something that an encode can leave out. Its text is the thing, a colon, and the reason.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum SkipReason {
    /// Alpha, where all is opaque.
    Alpha,
    /// Colour, where all is grey.
    Color,
    /// Colour and alpha, where all is grey and opaque.
    ColorAndAlpha,
    /// Colours under alpha 0, which continue the visible ones instead.
    HiddenColors,
    /// The weights of [`Tune::Ssim`](crate::Tune::Ssim) and [`Tune::Iq`](crate::Tune::Iq), where the picture is so even
    /// that they are the same everywhere.
    StructureWeights,
    /// The fit, where the picture is one colour.
    Fit,
    /// Iterations, where the error was small enough before the last one.
    Iterations,
    /// Primitives without which the error stays small enough.
    Primitives,
    /// A colour of its own for each primitive, where a codebook is smaller.
    OwnColors,
    /// The GPU, where the encoder might have used one.
    Gpu {
        /// Reason why it was not used.
        reason: String,
    },
}

impl fmt::Display for SkipReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            SkipReason::Alpha => "alpha: all is opaque",
            SkipReason::Color => "colour: all is grey",
            SkipReason::ColorAndAlpha => "colour and alpha: all is grey and opaque",
            SkipReason::HiddenColors => "colours under alpha 0: nobody sees them",
            SkipReason::StructureWeights => "weights of pixels: the picture is so even that all weigh the same",
            SkipReason::Fit => "the fit: the picture is one colour",
            SkipReason::Iterations => "iterations: the error is below that of rounding, or well below the target",
            SkipReason::Primitives => {
                "primitives without which the error stays below that of rounding, or of the target"
            }
            SkipReason::OwnColors => "a colour of its own for each primitive: a codebook is smaller",
            SkipReason::Gpu { reason } => return write!(f, "the GPU: {reason}"),
        })
    }
}
