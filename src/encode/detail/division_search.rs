//! Divides the bytes of a file between Gaussians and layer where only trying tells how: sharp pictures, which need more
//! Gaussians and which the encoder can only recognize after it has fitted the smaller base, and pages of text with
//! photographs, for which it encodes several divisions and compares them. Small files may be better without a layer, so
//! it encodes them with and without one.

use std::sync::Arc;

use super::{Layered, error_of_layered, joined, layer, two_steps};
use crate::bitstream::splats::PackedSplats;
use crate::constants::allocation::{MAX_TRIED_BASE_SHARE, MIN_BASE_GROWTH};
use crate::constants::division;
use crate::encode::allocation::{self, Division, keep};
use crate::encode::gaussians;
use crate::encode::input::stored_scene;
use crate::encode::render::drawn;
use crate::encode::state::Outcome;
use crate::encode::whole::WholePicture;
use crate::error::Result;
use crate::fit::model::drawing::field::{Field, Output};
use crate::fit::model::drawing::project::Primitive;
use crate::fit::model::objective::rows::RowSet;
use crate::fit::model::placing::peaks;
use crate::fit::model::problem::Problem;
use crate::metrics;
use crate::options::{Detail, Tune};
use crate::raster::View;
use crate::rdo::rounded::projected;
use crate::strict_math::StrictMath;

/// Codes a layer over `base`, tries other divisions where they may be better, and writes the file. `is_new` is whether
/// `base` was fitted for this file.
pub(in crate::encode) fn layered(
    picture: &mut WholePicture<'_>,
    base: Outcome,
    is_new: bool,
    division: &Division,
) -> Result<Outcome> {
    let (most, base_budget) = (division.max_bytes(), division.base_budget);
    let may_divide = picture.state.options.detail == Detail::Auto;
    let mut layered = layer(picture, base, most)?;
    if may_divide && is_new {
        layered = with_larger_base(picture, layered, division)?;
    }
    if layered.coded.is_none() {
        // There is no room for a layer, so the Gaussians get all bytes.
        return gaussians::of_whole(picture, &division.request_without_layer());
    }
    if may_divide && is_new {
        let mut best_budget = base_budget;
        let ratio = division.ratio(picture.state.samples());
        let is_uncertain = allocation::is_uncertain(&picture.state.settings.allocation, division.texture, ratio);
        if division.until.is_none() && picture.state.base_factor.is_none() && is_uncertain {
            (layered, best_budget) = best_division(picture, layered, base_budget, division)?;
            // Further tries of a search use the same division.
            picture.state.base_factor = Some(best_budget / base_budget);
        }
        keep(&mut picture.state, &layered.base, best_budget);
    }
    let clock = picture.state.report.seconds();
    let outcome = joined(picture, layered, most, division.rounds, division.until)?;
    picture.state.report.stage("detail", clock);
    if division.is_uncertain { or_gaussians_alone(picture, outcome, division) } else { Ok(outcome) }
}

/// Returns `layered`, or Gaussians alone in a file of the same size if they look better.
fn or_gaussians_alone(picture: &mut WholePicture<'_>, layered: Outcome, division: &Division) -> Result<Outcome> {
    let alone = gaussians::of_whole(picture, &division.request_without_layer())?;
    let losses = [ms_ssim_loss(picture, &alone.splats)?, ms_ssim_loss(picture, &layered.splats)?];
    let [Some(loss), Some(loss_of_layered)] = losses else { return Ok(layered) };
    Ok(if loss < division::MAX_LOSS_OF_GAUSSIANS * loss_of_layered { alone } else { layered })
}

/// Fits larger bases to a sharp picture, as long as they gain enough, and returns the best result.
fn with_larger_base(picture: &mut WholePicture<'_>, mut layered: Layered, division: &Division) -> Result<Layered> {
    let (few, ratio) = (division.base_budget, division.ratio(picture.state.samples()));
    let most_for_base = allocation::most_for_base(ratio) * division.shared as f64;
    // With perceptual tuning the smaller base is equally good. A time budget is too short for several fits.
    let is_exact = picture.state.options.favoured() == Tune::Psnr;
    if !is_exact || division.until.is_some() || most_for_base <= MIN_BASE_GROWTH * few {
        return Ok(layered);
    }
    let max_sharpness = allocation::max_sharpness(&picture.state.settings.allocation, ratio);
    if sharpness(picture, &layered, few * division::MEASURED_LAYER_BYTES)?
        .is_some_and(|sharpness| sharpness <= max_sharpness)
    {
        return Ok(layered);
    }
    for bytes in [(few * most_for_base).sqrt(), most_for_base] {
        let initial = primitives_of(&layered.base.splats);
        let base = base(picture, bytes as u64, division, initial)?;
        let mut other = layer(picture, base, division.max_bytes())?;
        let errors = [error_of_layered(picture, &mut layered), error_of_layered(picture, &mut other)];
        let gain = 10.0 * (errors[0] / errors[1]).strict_log10();
        if gain > 0.0 {
            layered = other;
        }
        if gain.is_nan() || gain < division::MIN_BASE_GAIN {
            break;
        }
    }
    Ok(layered)
}

/// Fits Gaussians of `bytes` bytes, without header and metadata, as the base of a layer. The fit continues `initial` if
/// there are any.
pub(super) fn base(
    picture: &mut WholePicture<'_>,
    bytes: u64,
    division: &Division,
    initial: Vec<Primitive>,
) -> Result<Outcome> {
    let request = division.base_request(&picture.state, bytes, initial);
    gaussians::of_whole(picture, &request)
}

/// Encodes with more and with fewer bytes for the Gaussians than the base of `first`, whose budget is `few` bytes, as
/// long as MS-SSIM increases. Returns the best result and the budget of its base.
pub(super) fn best_division(
    picture: &mut WholePicture<'_>,
    first: Layered,
    few: f64,
    division: &Division,
) -> Result<(Layered, f64)> {
    let most = MAX_TRIED_BASE_SHARE * division.shared as f64;
    let Some(mut dissimilarity) = ms_ssim_loss_of_layered(picture, &first)? else { return Ok((first, few)) };
    let mut best = (first, few);
    let (up, down) = (division::TRIED_BASE_FACTOR, 1.0 / division::TRIED_BASE_FACTOR);
    for change in if few * up < most { [up, down] } else { [down, up] } {
        let (mut bytes, mut is_better) = (few, false);
        loop {
            let next = (bytes * change).min(most);
            if (next / bytes).max(bytes / next) < division::MIN_TRIED_FACTOR || next < division::MIN_TRIED_SHARE * most
            {
                break;
            }
            bytes = next;
            let base = base(picture, bytes as u64, division, Vec::new())?;
            let other = layer(picture, base, division.max_bytes())?;
            match ms_ssim_loss_of_layered(picture, &other)? {
                Some(found) if found < division::MAX_LOSS_AFTER_CHANGE * dissimilarity => {
                    (best, dissimilarity, is_better) = ((other, bytes), found, true);
                }
                _ => break,
            }
        }
        if is_better {
            break;
        }
    }
    Ok(best)
}

/// Returns 1 minus the MS-SSIM of a picture. Returns `None` if it has no layer or is too small for MS-SSIM.
fn ms_ssim_loss_of_layered(picture: &WholePicture<'_>, layered: &Layered) -> Result<Option<f64>> {
    let Some(coded) = &layered.coded else { return Ok(None) };
    let mut splats = layered.base.splats.clone();
    splats.detail = Some(Arc::new(coded.layer.clone()));
    ms_ssim_loss(picture, &splats)
}

/// Returns 1 minus the MS-SSIM of a picture. Returns `None` if it is too small for MS-SSIM.
fn ms_ssim_loss(picture: &WholePicture<'_>, splats: &PackedSplats) -> Result<Option<f64>> {
    let drawn = drawn(splats, &View::new(splats.width, splats.height), splats.depth)?;
    Ok(metrics::compare(picture.input.pixels, &drawn)?.ms_ssim.map(|similarity| 1.0 - similarity))
}

/// Returns the sharpness of a picture: the estimated gain of more Gaussians relative to the gain of a larger layer.
/// Returns `None` if there is no layer.
fn sharpness(picture: &WholePicture<'_>, layered: &Layered, bytes: f64) -> Result<Option<f64>> {
    let Some(coded) = &layered.coded else { return Ok(None) };
    let splats = &layered.base.splats;
    // All errors have equal weight here, whatever the tuning, because this distinguishes pictures best.
    let [finer, coarser] = two_steps(picture, splats, coded, bytes);
    let decibels = 10.0 * (coarser[1] / finer[1]).strict_log10() / (finer[0] / coarser[0]).strict_log2();
    if !decibels.is_finite() {
        return Ok(None);
    }
    let estimated_gain = estimated_gain(picture, splats);
    Ok(Some(estimated_gain / decibels.max(0.1)))
}

/// Returns the estimated fraction of the error of `splats` that doubling the number of Gaussians would remove.
fn estimated_gain(picture: &WholePicture<'_>, splats: &PackedSplats) -> f64 {
    let plain = picture.planes.untuned();
    let problem = Problem { scene: stored_scene(splats), target: &plain };
    let drawn = projected(&splats.quantizer(), &splats.gaussians, splats.height);
    let mut field = Field::default();
    let error = field.draw(&problem, &drawn, RowSet::ALL, Output::Picture);
    let count = splats.gaussians.len();
    let peaks = peaks::peaks(&problem, &field, RowSet::ALL, count, count);
    peaks.iter().map(|peak| f64::from(peak.gain)).sum::<f64>() / error.max(f64::MIN_POSITIVE)
}

/// Converts the Gaussians of `splats` to primitives of a fit.
fn primitives_of(splats: &PackedSplats) -> Vec<Primitive> {
    let quantizer = splats.quantizer();
    splats.gaussians.iter().map(|g| Primitive::from_gaussian(&quantizer.dequantize(g))).collect()
}
