//! Codes the detail layer: the residual of the Gaussians, in the bytes that the Gaussians do not use.

mod adaptive_quantization;
mod chroma_coupling;
mod coefficients;
pub(super) mod division_search;
mod flat_cells;
mod partition;
mod parts;
#[cfg(feature = "quality-hook")]
pub(super) mod quality_search;
mod quant_matrix;
mod refine_base;
mod residual;
mod ringing;
mod scaled;
mod search;
mod settings;
mod trellis;

use std::sync::Arc;
use std::time::Duration;

use super::allocation;
use super::input::stored_scene;
use super::prepared::Prepared;
use super::state::Outcome;
use super::stored_error;
use super::whole::WholePicture;
use crate::bitstream::detail::DetailLayer;
use crate::bitstream::detail::levels::tile_counts;
use crate::bitstream::splats::PackedSplats;
use crate::constants::detail;
use crate::constants::division;
use crate::constants::fit;
use crate::effort::LayerSettings;
use crate::error::Result;
use crate::fit::model::objective::planes::Planes;
use crate::instant::Instant;
use crate::options::Tune;
use crate::rdo::rounded::projected;
use crate::strict_math::StrictMath;
use parts::Parts;
use residual::TileResidual;
use search::{Coded, search};
use settings::{
    BlockChoice, Closeness, LevelSearch, Preset, SearchSettings, for_drawing, least_drawing_bits, over_fixed_base,
    preset, search_settings,
};

/// Maximum number of pixels for which memory holds the whole residual, at about 30 bytes per pixel. For larger pictures
/// the encoder computes the residual one part at a time and fits the Gaussians only once.
pub(super) const LARGEST: u64 = 1 << 26;

/// Gaussians, with a layer over them if there was room for one.
pub(super) struct Layered {
    base: Outcome,
    coded: Option<Coded>,
    /// Squared error with the weights of the fit, once it is known.
    error: Option<f64>,
}

/// Codes a layer over `base`, for a file of at most `max_bytes` bytes, and records the time.
fn layer(picture: &mut WholePicture<'_>, base: Outcome, max_bytes: u64) -> Result<Layered> {
    let clock = picture.state.report.seconds();
    let coded = code_layer(picture, &base.splats, max_bytes, None)?;
    picture.state.report.stage("detail", clock);
    Ok(Layered { base, coded, error: None })
}

/// Returns the squared error of `layered` with the weights of the fit; infinity without a layer.
fn error_of_layered(picture: &WholePicture<'_>, layered: &mut Layered) -> f64 {
    let Layered { base, coded, error } = layered;
    let measured = || coded.as_ref().map_or(f64::INFINITY, |coded| layered_error(picture, &base.splats, &coded.layer));
    *error.get_or_insert_with(measured)
}

/// Fits the Gaussians' integers to the layer and the layer to the Gaussians, in at most `rounds` rounds that end by
/// `until`. Writes the file.
fn joined(
    picture: &mut WholePicture<'_>,
    mut layered: Layered,
    max_bytes: u64,
    rounds: u32,
    until: Option<Instant>,
) -> Result<Outcome> {
    let mut error = if rounds > 0 { error_of_layered(picture, &mut layered) } else { 0.0 };
    let Layered { base: mut outcome, coded, .. } = layered;
    let Some(mut coded) = coded else { return Ok(outcome) };
    let mut took = Duration::ZERO;
    for round in 0..rounds {
        picture.state.report.stage_progress("detail", round as f32 / rounds as f32)?;
        let start = Instant::now();
        // A round takes as long as the previous one.
        if until.is_some_and(|end| start + took > end) {
            break;
        }
        let splats = refined(picture, &outcome.splats, &coded.layer)?;
        let Some(next) = code_layer(picture, &splats, max_bytes, Some(&coded))? else { break };
        let next_error = layered_error(picture, &splats, &next.layer);
        if next_error >= error {
            break;
        }
        (error, coded, outcome.splats) = (next_error, next, splats);
        took = start.elapsed();
    }
    outcome.splats.detail = Some(Arc::new(coded.layer));
    outcome.bytes = picture.state.file(&outcome.splats)?;
    Ok(outcome)
}

/// Fits the integers of the Gaussians of `splats` to `layer`.
fn refined(picture: &WholePicture<'_>, splats: &PackedSplats, layer: &DetailLayer) -> Result<PackedSplats> {
    let Preset { lambda, .. } = preset(picture.state.options.favoured());
    let step = f32::from(layer.head.step) / 64.0 / 255.0;
    // An error of luma is an equal error in each of the colours.
    let colors = if picture.planes.channels.count() >= 3 { 3.0 } else { 1.0 };
    let price = colors * lambda * step * step;
    let mut refined = splats.clone();
    let layer = (layer, picture.state.channels);
    refine_base::descend(&mut refined, &picture.planes, layer, price, picture.state.options.levels)?;
    Ok(refined)
}

/// Returns the bytes and the unweighted error of two layers in the blocks of `coded`. The first has about `bytes`
/// bytes, or as many as `coded` if that has fewer. The second has a coarser step.
fn two_steps(picture: &WholePicture<'_>, splats: &PackedSplats, coded: &Coded, bytes: f64) -> [[f64; 2]; 2] {
    let tiles = residuals(picture, splats);
    let factor = (coded.bytes as f64 / bytes).max(1.0).strict_powf(1.0 / division::COARSER_STEP_EXPONENT);
    [factor, factor * division::COARSER_STEP].map(|factor| {
        let mut settings = settings_of_layer(picture, coded.bytes);
        let step = f64::from(coded.layer.head.step) * factor;
        settings.coding.head = coded.layer.head;
        settings.coding.head.step = step.min(65_535.0) as u16;
        settings.coding.level_search = LevelSearch::Quick;
        let other = search::once(&tiles, &settings, coded);
        [other.bytes as f64, plain_error(picture, splats, &other.layer)]
    })
}

/// Returns the error that the encoder minimizes, with the weights of the fit.
fn layered_error(picture: &WholePicture<'_>, splats: &PackedSplats, layer: &DetailLayer) -> f64 {
    error_by(picture, &picture.planes, splats, layer)
}

/// Returns the error without the weights of the tuning.
fn plain_error(picture: &WholePicture<'_>, splats: &PackedSplats, layer: &DetailLayer) -> f64 {
    error_by(picture, &picture.planes.untuned(), splats, layer)
}

/// Returns the error with the weights of `planes`.
fn error_by(picture: &WholePicture<'_>, planes: &Planes, splats: &PackedSplats, layer: &DetailLayer) -> f64 {
    let drawn = projected(&splats.quantizer(), &splats.gaussians, splats.height);
    let layer = (layer, picture.state.channels);
    stored_error::squared_error((stored_scene(splats), planes), &drawn, layer)
}

fn residuals(picture: &WholePicture<'_>, splats: &PackedSplats) -> Vec<TileResidual> {
    let drawn = projected(&splats.quantizer(), &splats.gaussians, splats.height);
    let mut tiles = residual::residuals(stored_scene(splats), &picture.planes, &drawn);
    if let Some(range) = picture.range {
        // Luma only serves to find where errors are masked.
        tiles.iter_mut().flat_map(|tile| &mut tile.luma).for_each(|luma| *luma *= range.factor());
    }
    tiles
}

/// Returns the tuning of the layer. Contrasts of few levels need the finest steps at all frequencies.
fn layer_tune(picture: &WholePicture<'_>) -> Tune {
    let has_few_levels = picture.range.is_some_and(|range| range.levels() < detail::MIN_TUNED_SAMPLE_VALUES);
    if has_few_levels { Tune::Psnr } else { picture.state.options.favoured() }
}

fn settings_of_layer(picture: &WholePicture<'_>, max_bytes: u64) -> SearchSettings {
    let has_alpha = picture.planes.channels.alpha().is_some();
    // Choosing the blocks at the final step gains 0.02 dB on small pictures. On large ones it gains 0.006 dB and
    // takes the most time.
    let keeps_blocks = picture.state.pixels() >= fit::LARGE_PIXELS;
    let LayerSettings { max_shortfall, aims_below, has_priced_blocks, avoids_ringing, .. } =
        picture.state.settings.layer;
    let mut settings = SearchSettings {
        max_bytes,
        keeps_blocks,
        closeness: Closeness { max_shortfall, below: aims_below },
        ..search_settings(layer_tune(picture), picture.state.channels, has_alpha)
    };
    if has_priced_blocks && picture.state.pixels() < fit::LARGE_PIXELS {
        settings.coding.blocks = BlockChoice::Priced;
    }
    if !avoids_ringing {
        settings.coding.mixed.ringing = None;
    }
    if !allocation::has_rounds(&picture.state) {
        settings = over_fixed_base(settings, layer_tune(picture));
    }
    settings
}

/// Returns whether a layer of `bytes` bytes is coded with the parameters for drawings.
fn is_coded_as_drawing(picture: &WholePicture<'_>, bytes: f64) -> bool {
    let bits = 8.0 * bytes / picture.state.pixels() as f64;
    picture.range.is_none()
        && bits >= least_drawing_bits(picture.state.pixels())
        && picture.measured_texture().is_some_and(|texture| texture.is_drawing())
}

/// Codes the residual of the Gaussians of `splats`, for a file of at most `max_bytes` bytes.
fn code_layer(
    picture: &WholePicture<'_>,
    splats: &PackedSplats,
    max_bytes: u64,
    near: Option<&Coded>,
) -> Result<Option<Coded>> {
    let mut settings = settings_of_layer(picture, 0);
    let left =
        |settings: &SearchSettings| left_for_layer(splats, settings, max_bytes, |empty| picture.state.file(empty));
    let Some(mut bytes) = left(&settings)? else { return Ok(None) };
    let is_drawing = match near {
        // The search may keep the blocks of `near`, so the range of block sizes must be the same.
        Some(near) => near.layer.head.sizes == for_drawing(settings, Tune::Psnr).coding.head.sizes,
        None => is_coded_as_drawing(picture, bytes as f64),
    };
    if is_drawing {
        let drawing = for_drawing(settings, picture.state.options.favoured());
        let Some(less) = left(&drawing)? else { return Ok(None) };
        (settings, bytes) = (drawing, less);
    }
    let mut tiles = residuals(picture, splats);
    if let (Some(near), Tune::Psnr) = (near, picture.state.options.favoured()) {
        chroma_coupling::couple(&mut tiles, &near.layer, picture.state.channels);
    }
    Ok(search(&tiles, &SearchSettings { max_bytes: bytes, ..settings }, near))
}

/// Codes a layer over `base`, Gaussians of one colour, in a file of at most `max_bytes` bytes.
pub(super) fn over_one_color(prepared: &mut Prepared<'_>, base: Outcome, max_bytes: u64) -> Result<Outcome> {
    match prepared {
        Prepared::Whole(picture) if picture.state.pixels() <= LARGEST => {
            let layered = layer(picture, base, max_bytes)?;
            joined(picture, layered, max_bytes, 0, None)
        }
        _ => layered_in_parts(prepared, base, max_bytes),
    }
}

/// Codes a layer over `base` in a file of `max_bytes` bytes, one part of the picture at a time, and writes the file.
/// It is for pictures whose residual is too large for memory.
pub(super) fn layered_in_parts(prepared: &mut Prepared<'_>, mut base: Outcome, max_bytes: u64) -> Result<Outcome> {
    let source = prepared.fitted_source();
    let state = prepared.state_mut();
    let clock = state.report.seconds();
    let (channels, tune, hidden) = (state.channels, state.options.favoured(), state.options.hidden);
    let parts = Parts { source, splats: &base.splats, channels, tune, hidden };
    let settings = over_fixed_base(search_settings(tune, channels, source.channels().alpha().is_some()), tune);
    let Some(left) = left_for_layer(parts.splats, &settings, max_bytes, |empty| state.file(empty))? else {
        return Ok(base);
    };
    let report = &mut state.report;
    if let Some(layer) = parts.layer(left, &mut |done| report.stage_progress("detail", done))? {
        base.splats.detail = Some(Arc::new(layer));
        base.bytes = state.file(&base.splats)?;
    }
    state.report.stage("detail", clock);
    Ok(base)
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
