//! Options of the encoder that a fit sees.

/// Steps of an ablation from another method to that of this crate. Each step adds to the previous ones; normal encodes
/// use the last. The first two belong to [`Recipe::Other`](crate::options::Recipe::Other).
#[cfg_attr(not(feature = "unstable"), allow(dead_code, reason = "tools set them"))]
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default, Hash)]
pub enum Rung {
    /// A fit whose result is rounded to the nearest integers.
    Fit,
    /// Descent over the integers as well.
    Descent,
    /// Squared error, step sizes in each Gaussian's own frame, and faster decaying moments.
    Optimizer,
    /// Steps that sample some of the rows.
    Sampling,
    /// Relocation of the least useful Gaussians.
    Relocation,
    /// A price of size.
    #[default]
    Price,
}

/// Measure of quality that the fit optimizes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Tune {
    /// Squared error.
    Psnr,
    /// Perceived quality from some distance: errors are weighted by how busy the luma and its surroundings are at
    /// several sizes. It costs at most 0.5 dB of PSNR, on average 0.1 to 0.3 dB. The names of these measures are those
    /// that AV1's encoder uses.
    Iq,
}

/// Treatment of colours under alpha 0, which no viewer shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
#[non_exhaustive]
pub enum HiddenColors {
    /// Replace them by a smooth continuation of the visible colours, so that they take no bytes and leave no fringes.
    #[default]
    Continue,
    /// Fit them like visible colours, for programs that use them for other purposes. The errors of all pixels have
    /// equal weight.
    Keep,
}
