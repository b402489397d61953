//! The settings with which a layer is coded, for each tuning and for drawings.

use std::ops::Range;

use super::flat_cells::MixedBlocks;
use super::quant_matrix::Slopes;
use crate::bitstream::detail::DetailHead;
use crate::bitstream::detail::head::parameter_bytes;
use crate::constants::detail::{self, Knot};
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
    /// Lowers the levels for which an estimate of the savings is conclusive, and tries those for which it is not. In
    /// blocks with few levels, it tries all of them up to twice.
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
    /// Factors on the coefficients of luma at the first and the last of [`LUMA_GAIN_STEPS`](detail::LUMA_GAIN_STEPS).
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
        let [from, to] = detail::LUMA_GAIN_STEPS.map(StrictMath::strict_ln);
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
    pub(super) const USUAL: Closeness = Closeness { max_shortfall: detail::MAX_SHORTFALL, below: detail::AIMS_BELOW };
}

/// Returns the coding parameters that favour a quality measure.
pub(super) fn preset(tune: Tune) -> Preset {
    match tune {
        Tune::Psnr => Preset {
            head: DetailHead { biases: detail::PSNR_BIASES, ..DetailHead::PLAIN },
            lambda: detail::PSNR_LAMBDA,
            powers: [0.0; 2],
            slopes: Slopes(&[Knot { step: 1, slopes: [0, 0], chroma: DetailHead::PLAIN.chroma }]),
        },
        Tune::Iq => Preset {
            head: DetailHead { biases: detail::IQ_BIASES, ..DetailHead::SEEN },
            lambda: detail::IQ_LAMBDA,
            powers: detail::IQ_VARIANCE_EXPONENTS,
            slopes: Slopes(detail::IQ_SLOPES),
        },
    }
}

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
        max_runs: detail::MAX_RUNS,
        closeness: Closeness::USUAL,
        keeps_blocks: false,
    }
}

/// Returns the parameters for a layer over Gaussians that are not optimized under it.
pub(super) fn over_fixed_base(mut settings: SearchSettings, tune: Tune) -> SearchSettings {
    if tune == Tune::Iq {
        settings.gains = detail::LUMA_GAINS;
    }
    settings
}

/// Returns the minimum bits of the layer per pixel for which a drawing of `pixels` pixels is coded with the parameters
/// for drawings.
pub(super) fn least_drawing_bits(pixels: u64) -> f64 {
    detail::MIN_DRAWING_BITS
        * (pixels as f64 / detail::DRAWING_BITS_PIXELS).max(1.0).strict_powf(detail::DRAWING_BITS_EXPONENT)
}

/// Returns the parameters for a layer over a drawing, given those for a photograph.
pub(super) fn for_drawing(mut settings: SearchSettings, tune: Tune) -> SearchSettings {
    // Coloured lines need small chroma blocks.
    settings.coding.head.sizes[1][0] = settings.coding.head.sizes[0][0];
    settings.coding.mixed = MixedBlocks::DRAWING;
    if tune == Tune::Iq {
        // Prices do not include the cost of blocks with flat ground.
        settings.coding.blocks = BlockChoice::Rough;
        settings.powers = [detail::DRAWING_VARIANCE_EXPONENT; 2];
        settings.slopes = Slopes(detail::DRAWING_SLOPES);
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
    fn luma_is_amplified_for_perceptual_tuning_over_gaussians_that_stay() {
        let gains = |settings: SearchSettings| [1, 64, 202, 640, 9000].map(|step| settings.setting_at(step).gain);
        let usual = |tune| search_settings(tune, Channels::Rgb, false);
        let [fine, coarse] = detail::LUMA_GAINS;
        let found = gains(over_fixed_base(usual(Tune::Iq), Tune::Iq));
        assert_eq!([found[0], found[1], found[3], found[4]], [fine, fine, coarse, coarse]);
        // 202 is the middle of the logarithms of 64 and 640.
        assert!((found[2] - (fine + coarse) / 2.0).abs() < 1e-4, "{found:?}");
        let others = [over_fixed_base(usual(Tune::Psnr), Tune::Psnr), usual(Tune::Iq)];
        assert_eq!(others.map(gains), [[1.0; 5]; 2]);
    }

    #[test]
    fn large_drawings_need_more_bits_for_the_parameters_of_drawings() {
        assert_eq!([1, 300 * 300, 512 * 512].map(least_drawing_bits), [detail::MIN_DRAWING_BITS; 3]);
        let large = least_drawing_bits(2048 * 2048);
        assert!(large > 0.13 && large < 0.19, "{large}");
    }
}
