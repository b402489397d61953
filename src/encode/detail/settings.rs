//! The settings with which a layer is coded, for each tuning and for drawings.

use std::ops::Range;

use super::flat_cells::MixedBlocks;
use super::quant_matrix::{Knot, Slopes};
use crate::bitstream::detail::DetailHead;
use crate::bitstream::detail::head::parameter_bytes;
use crate::gaussian::Channels;
use crate::options::Tune;
use crate::strict_math::StrictMath;

/// Settings for coding a layer.
#[derive(Debug, Clone, Copy)]
pub(super) struct Setting {
    pub head: DetailHead,
    pub channels: Channels,
    /// Squared error that a bit must save (λ), in squared steps.
    pub lambda: f32,
    /// Factor on the coefficients of luma before they are quantized.
    pub gain: f32,
    pub level_search: LevelSearch,
    pub blocks: BlockChoice,
    /// Costs of blocks that contain both flat and other cells, where ringing is visible.
    pub mixed: MixedBlocks,
}

/// Method for choosing the blocks of a tile.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum BlockChoice {
    /// Uses an estimate (`blocks::blocks`).
    Rough,
    /// Uses the prices of the entropy coder (`choose::priced_blocks`) and, for blocks with many levels, the estimate. This
    /// gains 0.1 dB of PSNR, or up to 0.3 points of SSIMULACRA2, and takes fifteen times as long.
    Priced,
}

/// Thoroughness of the search for levels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum LevelSearch {
    /// Tries each clearly uncertain level once.
    Quick,
    /// Tries the levels for which the estimated savings are inconclusive. In blocks with few levels, it tries all of
    /// them up to twice.
    Thorough,
    /// Tries every uncertain level up to twice.
    Exhaustive,
}

/// Parameters and byte budget for coding a layer.
#[derive(Debug, Clone, Copy)]
pub(super) struct SearchSettings {
    pub coding: Setting,
    /// Exponents of the variance with which the steps grow in fine and in coarse layers, if there are classes.
    pub powers: [f32; 2],
    /// Growth of the steps with frequency, and steps of chroma.
    pub slopes: Slopes,
    /// Factors on the coefficients of luma at the first and the last of [`GAIN_STEPS`].
    pub gains: [f32; 2],
    /// Maximum bytes of index and streams.
    pub max_bytes: u64,
    /// Maximum number of coder runs.
    pub max_runs: u32,
    /// How close the layer comes to `max_bytes`.
    pub closeness: Closeness,
    /// Whether a search keeps the blocks of an earlier layer of nearly the same tiles.
    pub keeps_blocks: bool,
}

impl SearchSettings {
    /// Returns the settings of a layer with this step.
    pub(super) fn setting_at(&self, step: u16) -> Setting {
        let mut coding = self.coding;
        coding.head.step = step;
        self.slopes.apply(&mut coding.head);
        let [from, to] = GAIN_STEPS.map(StrictMath::strict_ln);
        let share = ((f32::from(step).strict_ln() - from) / (to - from)).clamp(0.0, 1.0);
        coding.gain = self.gains[0] + share * (self.gains[1] - self.gains[0]);
        coding
    }

    /// Returns the bytes that the parameters of a layer take beyond those of these settings, with which the budget was
    /// computed. Parameters that depend on the step may take more.
    pub(super) fn more_parameter_bytes(&self, head: &DetailHead) -> u64 {
        parameter_bytes(head).saturating_sub(parameter_bytes(&self.coding.head))
    }
}

/// How close the search comes to the available bytes.
#[derive(Debug, Clone, Copy)]
pub(super) struct Closeness {
    /// Maximum shortfall of an accepted layer, as a fraction of the available bytes.
    pub max_shortfall: f64,
    /// Fraction of the available bytes by which the search aims below them.
    pub below: f64,
}

impl Closeness {
    pub(super) const USUAL: Closeness = Closeness { max_shortfall: 0.004, below: 0.0015 };
}

/// Maximum number of coder runs in a search.
const RUNS: u32 = 7;
/// Steps between which the factor on luma grows with the logarithm of the step, 1/64 code value.
const GAIN_STEPS: [f32; 2] = [64.0, 640.0];
/// Factors on the coefficients of luma at these steps, with which [`Tune::Iq`] codes the layer over Gaussians that are not
/// optimized under it. Quantization removes energy, which looks like blur. With these factors, and without biases of the
/// reconstruction, effort 2 gains 0.5, 0.7 and 0.6 SSIMULACRA2 points on Kodak and 0.2 on CID22 at ratios of 20, 50 and
/// 100, and Butteraugli grows by 0.5 % (docs/studies/perceptual-tuning.md). Where the Gaussians are optimized under the
/// layer, the factors gain nothing.
const GAINS: [f32; 2] = [1.01, 1.04];
/// Returns the coding parameters that favour a quality measure.
pub(super) fn preset(tune: Tune) -> Preset {
    match tune {
        // The biases of `DetailHead::PLAIN` lose 0.02 dB at a ratio of 20 and nothing at 50.
        Tune::Psnr => Preset {
            head: DetailHead { biases: [1, 3], ..DetailHead::PLAIN },
            lambda: 0.10,
            powers: [0.0; 2],
            slopes: Slopes(&[Knot { step: 1, slopes: [0, 0], chroma: DetailHead::PLAIN.chroma }]),
        },
        Tune::Ssim => Preset {
            head: DetailHead { biases: [2, 4], ..DetailHead::SEEN },
            lambda: 0.09,
            powers: [0.08; 2],
            // Compared with slopes of 16 at every step, at effort 3, these gain 0.0011 of MS-SSIM (1.9 SSIMULACRA2
            // points) on seven pictures at a ratio of 50 and 0.0037 on three Kodak pictures at 100. They lose 0.26 and
            // 0.33 dB. λ = 0.075 changes nothing.
            slopes: Slopes(&[
                Knot { step: 600, slopes: [16, 16], chroma: [48, 32] },
                Knot { step: 3000, slopes: [90, 40], chroma: [48, 32] },
            ]),
        },
        // Compared with slopes of 40 at every step, at a ratio of 100 and effort 2, these gain 4.3 SSIMULACRA2 points
        // on three Kodak pictures and 0.5 on two of CLIC. They lose 0.39 and 0.11 dB. The power grows as well. It
        // gains 0.02, 0.1 and 0.2 points on Kodak and CID22 at ratios of 20, 50 and 100, and loses 0.00, 0.01 and 0.03
        // of Butteraugli. With 0.22 Butteraugli loses three times as much. The first knot is for small steps.
        // On 18 pictures of Kodak and CID22 at a ratio of 10, that knot gains 0.1 points and 0.03 of Butteraugli;
        // drawings would lose 0.7 points by its chroma. Chroma slopes of 40 and 60 instead of 100 and 150 lose 0.05 to
        // 0.16 points on Kodak, CID22 and CLIC at ratios of 20 to 100.
        // Biases of [0, 2] instead of none lose 0.1 to 0.2 SSIMULACRA2 points at efforts 1 and 2, 0.07 at 2.8 megapixels,
        // and nothing where the Gaussians are optimized under the layer.
        Tune::Iq => Preset {
            head: DetailHead { biases: [0, 0], ..DetailHead::SEEN },
            lambda: 0.1,
            powers: [0.11, 0.165],
            slopes: Slopes(&[
                Knot { step: 100, slopes: [10, 40], chroma: [80, 40] },
                Knot { step: 600, slopes: [40, 100], chroma: [64, 32] },
                Knot { step: 3000, slopes: [130, 150], chroma: [64, 32] },
            ]),
        },
    }
}

/// Minimum bits of the layer per pixel for which a drawing is coded with the parameters for drawings. A screenshot and
/// a page gain 5.4 and 0.5 SSIMULACRA2 points with 0.3 bits (a ratio of 50), and 5.6 and 2.6 points with 0.11 bits (a
/// ratio of 100). Three diagrams gain 0.0 to 0.3 points with 0.25 bits (a ratio of 50). They lose up to 0.9 points with
/// 0.06 bits. With 0.03 bits (a ratio of 200), all but one lose up to 5 points, because the layer has few levels there
/// and larger blocks are cheaper.
const DRAWING_BITS: f64 = 0.09;
/// Number of pixels above which these bits grow, and the exponent. On parts of 2048 × 2048 pixels of a map and of a
/// page, the parameters for drawings lose 3.3 and 2.4 points with 0.1 bits (a ratio of 200); with 0.2 bits (100), they
/// lose 1.2 and gain 0.5.
const DRAWING_BITS_PIXELS: f64 = 262_144.0;
const DRAWING_BITS_POWER: f64 = 0.2;
/// Growth of the steps with frequency in drawings, whose lines are sharp in coarse layers too.
const DRAWING_SLOPES: Slopes = Slopes(&[
    Knot { step: 600, slopes: [20, 40], chroma: [64, 32] },
    Knot { step: 3000, slopes: [40, 60], chroma: [64, 32] },
]);
/// Exponent of the luma variance with which the steps grow in drawings.
const DRAWING_POWER: f32 = 0.06;

/// Parameters for coding a layer.
pub(super) struct Preset {
    pub head: DetailHead,
    /// Squared error that a bit must save (λ), in squared steps.
    pub lambda: f32,
    /// Exponents of the luma variance with which the steps grow, in fine and in coarse layers.
    pub powers: [f32; 2],
    /// Growth of the steps with frequency, and steps of chroma.
    pub slopes: Slopes,
}

/// Returns the parameters for coding a layer of a file with these channels. The caller sets the byte budget.
pub(super) fn search_settings(tune: Tune, channels: Channels, has_alpha: bool) -> SearchSettings {
    let Preset { mut head, lambda, powers, slopes } = preset(tune);
    head.alpha = has_alpha;
    slopes.apply(&mut head);
    // For pure squared error, the rough estimate loses 0.1 dB.
    let blocks = if tune == Tune::Psnr { BlockChoice::Priced } else { BlockChoice::Rough };
    let level_search = if tune == Tune::Psnr { LevelSearch::Exhaustive } else { LevelSearch::Thorough };
    let mixed = if tune == Tune::Iq { MixedBlocks::PHOTOGRAPH } else { MixedBlocks::PLAIN };
    let coding = Setting { head, channels, lambda, gain: 1.0, level_search, blocks, mixed };
    SearchSettings {
        coding,
        powers,
        slopes,
        gains: [1.0; 2],
        max_bytes: 0,
        max_runs: RUNS,
        closeness: Closeness::USUAL,
        keeps_blocks: false,
    }
}

/// Returns the parameters for a layer over Gaussians that are not optimized under it.
pub(super) fn over_fixed_base(mut settings: SearchSettings, tune: Tune) -> SearchSettings {
    if tune == Tune::Iq {
        settings.gains = GAINS;
    }
    settings
}

/// Returns the minimum bits of the layer per pixel for which a drawing of `pixels` pixels is coded with the parameters
/// for drawings.
pub(super) fn least_drawing_bits(pixels: u64) -> f64 {
    DRAWING_BITS * (pixels as f64 / DRAWING_BITS_PIXELS).max(1.0).strict_powf(DRAWING_BITS_POWER)
}

/// Returns the parameters for a layer over a drawing, given those for a photograph.
pub(super) fn for_drawing(mut settings: SearchSettings, tune: Tune) -> SearchSettings {
    // Coloured lines need small chroma blocks.
    settings.coding.head.sizes[1][0] = settings.coding.head.sizes[0][0];
    settings.coding.mixed = MixedBlocks::DRAWING;
    if tune == Tune::Iq {
        // Prices do not include the cost of blocks with flat ground.
        settings.coding.blocks = BlockChoice::Rough;
        settings.powers = [DRAWING_POWER; 2];
        settings.slopes = DRAWING_SLOPES;
        settings.slopes.apply(&mut settings.coding.head);
    }
    settings
}

/// Returns the planes of a kind.
pub(super) fn planes(kind: usize) -> Range<usize> {
    [0..1, 1..3, 3..4][kind].clone()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn large_drawings_need_more_bits_for_the_parameters_of_drawings() {
        assert_eq!([1, 300 * 300, 512 * 512].map(least_drawing_bits), [DRAWING_BITS; 3]);
        let large = least_drawing_bits(2048 * 2048);
        assert!(large > 0.13 && large < 0.19, "{large}");
    }
}
