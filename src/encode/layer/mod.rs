//! Codes the detail layer: the residual of the Gaussians, in the bytes that the Gaussians do not use.

mod blocks;
mod choose;
mod classes;
mod coefficients;
mod coupled;
pub(super) mod divide;
pub(super) mod division;
pub(super) mod error;
mod ground;
mod in_steps;
mod join;
pub(super) mod parts;
mod residual;
mod ringing;
mod search;
mod slopes;
pub(super) mod texture;
#[cfg(feature = "quality-hook")]
pub(super) mod to_quality;

use std::sync::Arc;
use std::time::Duration;

use super::input::stored_scene;
use super::session::{EncodeSession, Outcome};
use super::whole::WholeSession;
use crate::bitstream::detail::levels::tile_counts;
use crate::bitstream::detail::{DetailHead, DetailLayer};
use crate::bitstream::splats::PackedSplats;
use crate::error::Result;
use crate::fit::model::objective::planes::Planes;
use crate::fit::model::problem::LARGE_PIXELS;
use crate::gaussian::Channels;
use crate::instant::Instant;
use crate::options::Tune;
use crate::pixel_source::PixelSource;
use crate::round::rounded::projected;
use crate::strict_math::StrictMath;
use choose::{BlockChoice, LevelSearch, Setting};
use ground::MixedBlocks;
use parts::Parts;
use residual::TileResidual;
use search::{Closeness, Coded, SearchSettings, search};
use slopes::{Knot, Slopes};

/// Maximum number of coder runs in a search.
const RUNS: u32 = 7;
/// Minimum effort at which the blocks of a small picture are chosen by the prices of the entropy coder with any tuning.
/// On Kodak and CID22 they gain 0.1 and 0.03 points of SSIMULACRA2 at ratios of 20 to 100, and 0.3 at 200 on Kodak, and
/// take 2 to 6 % more time. At 2.8 megapixels they gain nothing.
const MIN_PRICED_EFFORT: u8 = 4;

/// Returns the coding parameters that favour a quality measure.
fn preset(tune: Tune) -> Preset {
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
        // Compared with slopes of 40 at every step, at a ratio of 100 and effort 1, these gain 4.3 SSIMULACRA2 points
        // on three Kodak pictures and 0.5 on two of CLIC. They lose 0.39 and 0.11 dB. The power grows as well. It
        // gains 0.02, 0.1 and 0.2 points on Kodak and CID22 at ratios of 20, 50 and 100, and loses 0.00, 0.01 and 0.03
        // of Butteraugli. With 0.22 Butteraugli loses three times as much. The first knot is for small steps.
        // On 18 pictures of Kodak and CID22 at a ratio of 10, that knot gains 0.1 points and 0.03 of Butteraugli;
        // drawings would lose 0.7 points by its chroma. Chroma slopes of 40 and 60 instead of 100 and 150 lose 0.05 to
        // 0.16 points on Kodak, CID22 and CLIC at ratios of 20 to 100.
        Tune::Iq => Preset {
            head: DetailHead::SEEN,
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
struct Preset {
    head: DetailHead,
    /// Squared error that a bit must save (λ), in squared steps.
    lambda: f32,
    /// Exponents of the luma variance with which the steps grow, in fine and in coarse layers ([`Masking`]).
    powers: [f32; 2],
    /// Growth of the steps with frequency, and steps of chroma.
    slopes: Slopes,
}

/// Number of sample values of a picture with 16 bits below which its layer is coded for the lowest squared error. The
/// smallest step is 4 values, and the tuned ones are several times larger at high frequencies.
const MIN_TUNED_LEVELS: u32 = 2048;

/// Factor between the two steps at which the value of the layer's bytes is measured.
const COARSER: f64 = 1.5;
/// Exponent with which the bytes decrease as the step grows, in the range of this measurement.
const MEASURED_FALL: f64 = 1.4;

/// Gaussians, with a layer over them if there was room for one.
pub(super) struct Layered {
    base: Outcome,
    coded: Option<Coded>,
    /// Squared error with the weights of the fit, once it is known.
    error: Option<f64>,
}

impl WholeSession<'_> {
    /// Codes a layer over `base`, for a file of at most `max_bytes` bytes.
    fn layer(&self, base: Outcome, max_bytes: u64) -> Result<Layered> {
        let splats = &base.splats;
        let coded = self.coded(splats, max_bytes, None)?;
        Ok(Layered { base, coded, error: None })
    }

    /// Returns the squared error of `layered` with the weights of the fit; infinity without a layer.
    fn error_of_layered(&self, layered: &mut Layered) -> f64 {
        let Layered { base, coded, error } = layered;
        let measured = || coded.as_ref().map_or(f64::INFINITY, |coded| self.layered_error(&base.splats, &coded.layer));
        *error.get_or_insert_with(measured)
    }

    /// Fits the Gaussians' integers to the layer and the layer to the Gaussians, in at most `rounds` rounds that end by
    /// `until`. Writes the file.
    fn joined(&mut self, mut layered: Layered, max_bytes: u64, rounds: u32, until: Option<Instant>) -> Result<Outcome> {
        let mut error = if rounds > 0 { self.error_of_layered(&mut layered) } else { 0.0 };
        let Layered { base: mut outcome, coded, .. } = layered;
        let Some(mut coded) = coded else { return Ok(outcome) };
        let mut took = Duration::ZERO;
        for round in 0..rounds {
            self.report.stage_progress("detail", round as f32 / rounds as f32)?;
            let start = Instant::now();
            // A round takes as long as the previous one.
            if until.is_some_and(|end| start + took > end) {
                break;
            }
            let Preset { lambda, .. } = preset(self.input.options.favoured());
            let mut splats = outcome.splats.clone();
            let step = f32::from(coded.layer.head.step) / 64.0 / 255.0;
            // An error of luma is an equal error in each of the colours.
            let colors = if self.planes.channels.count() >= 3 { 3.0 } else { 1.0 };
            let price = colors * lambda * step * step;
            let layer = (&coded.layer, self.input.channels());
            join::descend(&mut splats, &self.planes, layer, price, self.input.options.levels)?;
            let Some(next) = self.coded(&splats, max_bytes, Some(&coded))? else { break };
            let next_error = self.layered_error(&splats, &next.layer);
            if next_error >= error {
                break;
            }
            (error, coded, outcome.splats) = (next_error, next, splats);
            took = start.elapsed();
        }
        outcome.splats.detail = Some(Arc::new(coded.layer));
        outcome.bytes = self.file(&outcome.splats)?;
        Ok(outcome)
    }

    /// Returns the bytes and the unweighted error of two layers in the blocks of `coded`. The first has about `bytes`
    /// bytes, or as many as `coded` if that has fewer. The second has a coarser step.
    fn two_steps(&self, splats: &PackedSplats, coded: &Coded, bytes: f64) -> [[f64; 2]; 2] {
        let tiles = self.residuals(splats);
        let factor = (coded.bytes as f64 / bytes).max(1.0).strict_powf(1.0 / MEASURED_FALL);
        [factor, factor * COARSER].map(|factor| {
            let mut settings = self.settings_of_layer(coded.bytes);
            let step = f64::from(coded.layer.head.step) * factor;
            settings.coding.head = coded.layer.head;
            settings.coding.head.step = step.min(65_535.0) as u16;
            settings.coding.level_search = LevelSearch::Quick;
            let other = search::once(&tiles, &settings, coded);
            [other.bytes as f64, self.plain_error(splats, &other.layer)]
        })
    }

    /// Returns the error that the encoder minimizes, with the weights of the fit.
    fn layered_error(&self, splats: &PackedSplats, layer: &DetailLayer) -> f64 {
        self.error_by(&self.planes, splats, layer)
    }

    /// Returns the error without the weights of the tuning.
    fn plain_error(&self, splats: &PackedSplats, layer: &DetailLayer) -> f64 {
        self.error_by(&self.planes.untuned(), splats, layer)
    }

    /// Returns the error with the weights of `planes`.
    fn error_by(&self, planes: &Planes, splats: &PackedSplats, layer: &DetailLayer) -> f64 {
        let drawn = projected(&splats.quantizer(), &splats.gaussians, splats.height);
        let layer = (layer, self.input.channels());
        error::squared_error((stored_scene(splats), planes), &drawn, layer)
    }

    fn residuals(&self, splats: &PackedSplats) -> Vec<TileResidual> {
        let drawn = projected(&splats.quantizer(), &splats.gaussians, splats.height);
        let mut tiles = residual::residuals(stored_scene(splats), &self.planes, &drawn);
        if let Some(range) = self.range {
            // Luma only serves to find where errors are masked.
            tiles.iter_mut().flat_map(|tile| &mut tile.luma).for_each(|luma| *luma *= range.factor());
        }
        tiles
    }

    /// Returns the tuning of the layer. Contrasts of few levels need the finest steps at all frequencies.
    fn layer_tune(&self) -> Tune {
        let has_few_levels = self.range.is_some_and(|range| range.levels() < MIN_TUNED_LEVELS);
        if has_few_levels { Tune::Psnr } else { self.input.options.favoured() }
    }

    fn settings_of_layer(&self, max_bytes: u64) -> SearchSettings {
        let has_alpha = self.planes.channels.alpha().is_some();
        // Choosing the blocks at the final step gains 0.02 dB on small pictures. On large ones it gains 0.006 dB and
        // takes the most time.
        let keeps_blocks = self.pixels() >= LARGE_PIXELS;
        let effort = self.input.options.effort;
        let mut settings = SearchSettings {
            max_bytes,
            keeps_blocks,
            closeness: if effort == 1 { Closeness::HASTY } else { Closeness::USUAL },
            ..search_settings(self.layer_tune(), self.input.channels(), has_alpha)
        };
        if effort >= MIN_PRICED_EFFORT && self.pixels() < LARGE_PIXELS {
            settings.coding.blocks = BlockChoice::Priced;
        }
        settings
    }

    /// Returns whether a layer of `bytes` bytes is coded with the parameters for drawings.
    fn is_coded_as_drawing(&self, bytes: f64) -> bool {
        let bits = 8.0 * bytes / self.pixels() as f64;
        self.range.is_none()
            && bits >= least_drawing_bits(self.pixels())
            && self.measured_texture().is_some_and(|texture| texture.is_drawing())
    }

    /// Codes the residual of the Gaussians of `splats`, for a file of at most `max_bytes` bytes.
    fn coded(&self, splats: &PackedSplats, max_bytes: u64, near: Option<&Coded>) -> Result<Option<Coded>> {
        let mut settings = self.settings_of_layer(0);
        let left = |settings: &SearchSettings| left_for_layer(splats, settings, max_bytes, |empty| self.file(empty));
        let Some(mut bytes) = left(&settings)? else { return Ok(None) };
        let is_drawing = match near {
            // The search may keep the blocks of `near`, so the range of block sizes must be the same.
            Some(near) => near.layer.head.sizes == for_drawing(settings, Tune::Psnr).coding.head.sizes,
            None => self.is_coded_as_drawing(bytes as f64),
        };
        if is_drawing {
            let drawing = for_drawing(settings, self.input.options.favoured());
            let Some(less) = left(&drawing)? else { return Ok(None) };
            (settings, bytes) = (drawing, less);
        }
        let mut tiles = self.residuals(splats);
        if let (Some(near), Tune::Psnr) = (near, self.input.options.favoured()) {
            coupled::couple(&mut tiles, &near.layer, self.input.channels());
        }
        Ok(search(&tiles, &SearchSettings { max_bytes: bytes, ..settings }, near))
    }
}

/// Codes a layer over `base` in a file of `max_bytes` bytes, one part of `source` at a time, and writes the file.
/// It is for pictures whose residual is too large for memory. `source` has the fitted channels.
pub(super) fn layered_in_parts<'a, S: EncodeSession<'a>>(
    session: &mut S,
    source: &dyn PixelSource,
    mut base: Outcome,
    max_bytes: u64,
) -> Result<Outcome> {
    let (channels, tune, hidden) = (session.channels(), session.options().favoured(), session.options().hidden);
    let parts = Parts { source, splats: &base.splats, channels, tune, hidden };
    let settings = search_settings(tune, channels, source.channels().alpha().is_some());
    let Some(left) = left_for_layer(parts.splats, &settings, max_bytes, |empty| session.file(empty))? else {
        return Ok(base);
    };
    let report = session.report();
    if let Some(layer) = parts.layer(left, &mut |done| report.stage_progress("detail", done))? {
        base.splats.detail = Some(Arc::new(layer));
        base.bytes = session.file(&base.splats)?;
    }
    Ok(base)
}

/// Returns the parameters for coding a layer of a file with these channels. The caller sets the byte budget.
fn search_settings(tune: Tune, channels: Channels, has_alpha: bool) -> SearchSettings {
    let Preset { mut head, lambda, powers, slopes } = preset(tune);
    head.alpha = has_alpha;
    slopes.apply(&mut head);
    // For pure squared error, the rough estimate loses 0.1 dB.
    let blocks = if tune == Tune::Psnr { BlockChoice::Priced } else { BlockChoice::Rough };
    let level_search = if tune == Tune::Psnr { LevelSearch::Exhaustive } else { LevelSearch::Thorough };
    let mixed = if tune == Tune::Iq { MixedBlocks::PHOTOGRAPH } else { MixedBlocks::PLAIN };
    let coding = Setting { head, channels, lambda, level_search, blocks, mixed };
    SearchSettings {
        coding,
        powers,
        slopes,
        max_bytes: 0,
        max_runs: RUNS,
        closeness: Closeness::USUAL,
        keeps_blocks: false,
    }
}

/// Returns the minimum bits of the layer per pixel for which a drawing of `pixels` pixels is coded with the parameters
/// for drawings.
fn least_drawing_bits(pixels: u64) -> f64 {
    DRAWING_BITS * (pixels as f64 / DRAWING_BITS_PIXELS).max(1.0).strict_powf(DRAWING_BITS_POWER)
}

/// Returns the parameters for a layer over a drawing, given those for a photograph.
fn for_drawing(mut settings: SearchSettings, tune: Tune) -> SearchSettings {
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

/// Returns the byte budget for index and streams of a layer over `splats` in a file of `max_bytes` bytes, or `None` if
/// there is no room for a layer. `file` writes a file.
fn left_for_layer(
    splats: &PackedSplats,
    settings: &SearchSettings,
    max_bytes: u64,
    file: impl Fn(&PackedSplats) -> Result<Vec<u8>>,
) -> Result<Option<u64>> {
    let [across, down] = tile_counts([splats.width, splats.height]);
    let count = across * down;
    let mut empty = splats.clone();
    empty.detail = Some(Arc::new(DetailLayer { head: settings.coding.head, tiles: vec![None; count] }));
    let fixed = file(&empty)?.len() as u64 - count as u64;
    Ok(max_bytes.checked_sub(fixed).filter(|&left| left > 2 * count as u64))
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
