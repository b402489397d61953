//! Encodes to a SSIMULACRA2 score with one fit: predicts the size of the file and the step of its layer, fits the
//! Gaussians for this size, and searches for the step.

use std::sync::Arc;

use super::division_search::{base, best_division};
use super::search::{Coded, Coder, Magnitudes};
use super::settings::{SearchSettings, for_drawing, search_settings};
use super::{LARGEST, Layered, is_coded_as_drawing, refined, residual, residuals, settings_of_layer};
use crate::bitstream::detail::DetailLayer;
use crate::bitstream::splats::PackedSplats;
use crate::constants::allocation::MIN_BASE_GROWTH;
use crate::constants::quality;
use crate::encode::allocation::{self, Division};
use crate::encode::constant;
use crate::encode::score_curve::{at_points, halvings};
use crate::encode::state::{AtQuality, Outcome};
use crate::encode::texture::Texture;
use crate::encode::whole::WholePicture;
use crate::error::Result;
use crate::fit::model::objective::planes::Planes;
use crate::fit::model::problem::Scene;
use crate::gaussian::Blend;
use crate::instant::Instant;
use crate::options::{Detail, EncodeOptions, Tune};
use crate::pixels::Pixels;
use crate::strict_math::StrictMath;

/// Returns the logarithm of the step with which a typical picture has this score.
fn typical_step(points: f64) -> f64 {
    at_points(&quality::TYPICAL_STEPS, points)
}

/// A search for the step with which a layer has a score.
#[derive(Debug)]
struct StepSearch {
    wanted: f64,
    /// Logarithm of the first step.
    first: f64,
    /// Change of the logarithm of the step for a change of the score, relative to the typical one.
    stretch: f64,
    /// Logarithms of the steps that were tried, and their scores.
    tried: Vec<[f64; 2]>,
}

impl StepSearch {
    fn new(wanted: f64, first: f64) -> Self {
        StepSearch { wanted, first, stretch: 1.0, tried: Vec::new() }
    }

    /// Returns a search that continues with slightly different Gaussians.
    fn after(&self) -> Self {
        StepSearch { stretch: self.stretch, ..StepSearch::new(self.wanted, self.next_logarithm()) }
    }

    /// Returns the step to try next.
    fn next(&self) -> u16 {
        self.next_logarithm().strict_exp().round().clamp(1.0, 65_535.0) as u16
    }

    /// Returns the logarithm of that step. It is rounded, so that the last digits of a score, which depend on the
    /// instruction set, hardly ever change the file.
    fn next_logarithm(&self) -> f64 {
        (self.expected() * quality::STEP_PARTS).round() / quality::STEP_PARTS
    }

    /// Returns the logarithm of the step at which the score is expected.
    fn expected(&self) -> f64 {
        let distance = |t: &&[f64; 2]| (t[1] - self.wanted).abs();
        let nearest = |is_above: bool| {
            let side = self.tried.iter().filter(|t| (t[1] >= self.wanted) == is_above);
            side.min_by(|a, b| distance(a).total_cmp(&distance(b)))
        };
        let beyond = |&[step, score]: &[f64; 2]| {
            let change = self.stretch * (typical_step(self.wanted) - typical_step(score));
            step + change.clamp(-quality::MAX_STEP_CHANGE, quality::MAX_STEP_CHANGE)
        };
        match (nearest(true), nearest(false)) {
            (Some(above), Some(below)) => {
                let [from, to, at] = [above[1], below[1], self.wanted].map(typical_step);
                let share = ((at - from) / (to - from)).clamp(0.1, 0.9);
                above[0] + share * (below[0] - above[0])
            }
            (Some(tried), None) | (None, Some(tried)) => beyond(tried),
            (None, None) => self.first,
        }
    }

    fn note(&mut self, step: u16, score: f64) {
        let step = f64::from(step).strict_ln();
        if let Some(last) = self.tried.last().filter(|last| (last[1] - score).abs() > quality::MIN_MEASURED_DIFFERENCE)
        {
            let stretch = (step - last[0]) / (typical_step(score) - typical_step(last[1]));
            self.stretch = stretch.clamp(quality::SLOPE_RANGE[0], quality::SLOPE_RANGE[1]);
        }
        self.tried.push([step, score]);
    }

    /// Returns whether this step was tried.
    fn has_tried(&self, step: u16) -> bool {
        let step = f64::from(step).strict_ln();
        self.tried.iter().any(|t| t[0] == step)
    }
}

/// Size of a file and step of its layer.
struct Prediction {
    /// Logarithm of the step.
    step: f64,
    /// Bytes of the file without header and metadata.
    bytes: f64,
}

/// A layer, and the score of the picture with it.
struct Tried {
    coded: Coded,
    score: f64,
}

impl Tried {
    /// Returns how far the score is from `wanted`. Too low a score is worse than any that is too high.
    fn distance(&self, wanted: f64) -> (bool, f64) {
        (self.score < wanted - quality::TOLERANCE, (self.score - wanted).abs())
    }
}

/// The result of a fit for a predicted file.
enum Attempt {
    Done(Box<Outcome>),
    /// The file has another size than predicted. `bytes` are those of a file with this `score`.
    Other {
        next: Prediction,
        bytes: u64,
        score: f64,
    },
    /// A file of this size has no layer.
    NoLayer,
}

/// Predicts the file of a picture with a score of `wanted` points.
fn predicted(planes: &Planes, settings: &SearchSettings, texture: Option<Texture>, wanted: f64) -> Prediction {
    let (width, height) = (planes.width, planes.height);
    let scene = Scene { width, height, blend: Blend::Normalized, background: planes.mean };
    let tiles = residual::residuals(scene, planes, &[]);
    let is_drawing = texture.is_some_and(|texture| texture.is_drawing());
    let shift = match texture {
        Some(texture) if !is_drawing => {
            -quality::FINENESS_EXPONENT * (texture.fineness / quality::TYPICAL_FINENESS).strict_ln()
        }
        _ => 0.0,
    };
    let step = typical_step(wanted) + shift.clamp(-quality::MAX_FINENESS_SHIFT, quality::MAX_FINENESS_SHIFT);
    let share = if is_drawing { quality::TYPICAL_DRAWING_SIZE } else { quality::TYPICAL_SIZE };
    let bytes = share * Magnitudes::of(&tiles, settings).bytes_at(step.strict_exp());
    Prediction {
        step,
        bytes: bytes.clamp(1.0, 2.0 * f64::from(width) * f64::from(height) * planes.channels.count() as f64),
    }
}

/// Predicts the bytes of a file of Gaussians and a detail layer with a score of `wanted` points.
pub(in crate::encode) fn predicted_bytes(pixels: &Pixels, options: &EncodeOptions, wanted: f64) -> f64 {
    let planes = Planes::with_hidden(pixels, options.hidden);
    let settings = search_settings(options.favoured(), pixels.channels(), pixels.channels().alpha().is_some());
    predicted(&planes, &settings, Texture::of(&planes), wanted).bytes
}

/// Encodes to a score of `wanted` points with one fit, if the file should have a layer.
pub(in crate::encode) fn layered_to_quality(picture: &mut WholePicture<'_>, wanted: f64) -> Result<AtQuality> {
    let options = picture.state.options;
    if options.favoured() == Tune::Psnr || picture.range.is_some() || picture.state.pixels() > LARGEST {
        return Ok(AtQuality::Unknown);
    }
    if let Some(outcome) = one_colour(picture, wanted)? {
        return Ok(AtQuality::Done(Box::new(outcome)));
    }
    let clock = picture.state.report.seconds();
    let settings = settings_of_layer(picture, 0);
    let mut predicted = predicted(&picture.planes, &settings, picture.measured_texture(), wanted);
    picture.state.report.stage("survey", clock);
    let mut seen = Vec::new();
    for fit in 0..quality::MAX_FITS {
        match at_prediction(picture, wanted, &predicted, fit + 1 == quality::MAX_FITS)? {
            Attempt::Done(outcome) => return Ok(AtQuality::Done(outcome)),
            Attempt::Other { next, bytes, score } => {
                predicted = next;
                seen.push((bytes, score));
            }
            Attempt::NoLayer => break,
        }
    }
    Ok(AtQuality::Expected { bytes: predicted.bytes, seen })
}

/// Returns the file of the mean colour if the picture has next to no contrast and the file has the score. A coarse
/// layer can have a larger error than it.
fn one_colour(picture: &mut WholePicture<'_>, wanted: f64) -> Result<Option<Outcome>> {
    if !constant::is_possible(picture.state.options, picture.state.blank.blend) {
        return Ok(None);
    }
    let splats = picture.flat();
    if picture.error_of(&splats) > quality::MAX_FAINT_ERROR * quality::MAX_FAINT_ERROR * picture.state.fitted_samples()
        || picture.score(&splats)? < wanted
    {
        return Ok(None);
    }
    let bytes = picture.state.file(&splats)?;
    Ok(Some(Outcome { bytes, splats, float_error: f64::INFINITY, quality: None, pruned_bytes: 0 }))
}

/// Encodes to a score of `wanted` points with a fit for the predicted file. `is_last` is whether the fit is used
/// whatever the size.
fn at_prediction(
    picture: &mut WholePicture<'_>,
    wanted: f64,
    predicted: &Prediction,
    is_last: bool,
) -> Result<Attempt> {
    let options = picture.state.options;
    let fixed = picture.state.fixed()?;
    let (samples, shared) = (picture.state.samples(), predicted.bytes as u64);
    if !allocation::has_layer(options, picture.state.pixels(), samples, shared, || picture.measured_texture()) {
        return Ok(Attempt::NoLayer);
    }
    let until = picture.state.clock.left().and_then(|left| Instant::now().checked_add(left));
    let texture = allocation::texture(options, || picture.measured_texture());
    let rounds = allocation::rounds(&picture.state, shared);
    let fit_ratio = Some(samples / predicted.bytes);
    let budget = allocation::base_budget(&picture.state, texture, predicted.bytes);
    let mut division =
        Division { fixed, shared, base_budget: budget, texture, rounds, fit_ratio, until, is_uncertain: false };
    let base = base(picture, budget as u64, &division, Vec::new())?;

    let clock = picture.state.report.seconds();
    let mut search = StepSearch::new(wanted, predicted.step);
    let is_drawing = is_coded_as_drawing(picture, predicted.bytes - (base.bytes.len() as u64 - fixed) as f64);
    let mut settings = settings_of_layer(picture, 0);
    if is_drawing {
        settings = for_drawing(settings, options.favoured());
    }
    let mut found = roughly(picture, &base.splats, &settings, &mut search, &division)?;
    let bytes = (base.bytes.len() as u64 - fixed + found.coded.bytes) as f64;
    let bytes = if (found.score - wanted).abs() > quality::ROUGH_TOLERANCE {
        bytes * (halvings(found.score) - halvings(wanted)).strict_exp2()
    } else {
        bytes
    };
    let is_wrong = (allocation::base_budget(&picture.state, texture, bytes) / budget).strict_ln().abs()
        > MIN_BASE_GROWTH.strict_ln();
    if is_wrong && !is_last && until.is_none() {
        picture.state.report.stage("detail", clock);
        let seen = base.bytes.len() as u64 + found.coded.bytes;
        let next = Prediction { step: search.next_logarithm(), bytes };
        return Ok(Attempt::Other { next, bytes: seen, score: found.score });
    }
    let mut outcome = base;
    let ratio = allocation::ratio_of(samples, predicted.bytes);
    let is_uncertain = allocation::is_uncertain(&picture.state.settings.allocation, texture, ratio);
    if is_uncertain && until.is_none() && options.detail == Detail::Auto {
        division.shared = outcome.bytes.len() as u64 - fixed + found.coded.bytes;
        let first = Layered { base: outcome, coded: Some(found.coded), error: None };
        let (best, _) = best_division(picture, first, budget, &division)?;
        outcome = best.base;
        let coded = best.coded.expect("a better division has a layer");
        let score = score_with(picture, &outcome.splats, &coded.layer)?;
        search = StepSearch::new(wanted, 0.0);
        search.note(coded.layer.head.step, score);
        found = Tried { coded, score };
    }
    for round in 0..division.rounds {
        picture.state.report.stage_progress("detail", round as f32 / division.rounds as f32)?;
        if picture.state.clock.is_over() {
            break;
        }
        (outcome.splats, found, search) = descended(picture, &outcome.splats, &found, &settings, &search)?;
    }
    found = closely(picture, &outcome.splats, &settings, search, found)?;
    outcome.splats.detail = Some(Arc::new(found.coded.layer));
    outcome.bytes = picture.state.file(&outcome.splats)?;
    outcome.quality = Some(found.score);
    picture.state.report.stage("detail", clock);
    Ok(Attempt::Done(Box::new(outcome)))
}

/// Returns the score of the picture with this layer.
fn score_with(picture: &mut WholePicture<'_>, splats: &PackedSplats, layer: &DetailLayer) -> Result<f64> {
    let splats = PackedSplats { detail: Some(Arc::new(layer.clone())), ..splats.clone() };
    picture.score(&splats)
}

/// Codes a layer with `step` and measures the score.
fn tried(
    picture: &mut WholePicture<'_>,
    splats: &PackedSplats,
    coder: &mut Coder<'_>,
    search: &mut StepSearch,
) -> Result<Tried> {
    let step = search.next();
    let coded = coder.run(step);
    let score = score_with(picture, splats, &coded.layer)?;
    search.note(step, score);
    Ok(Tried { coded, score })
}

/// Searches for a layer whose score is roughly the one of `search`.
fn roughly(
    picture: &mut WholePicture<'_>,
    splats: &PackedSplats,
    settings: &SearchSettings,
    search: &mut StepSearch,
    division: &Division,
) -> Result<Tried> {
    let is_last = division.rounds == 0;
    let tiles = residuals(picture, splats);
    let first = f64::from(search.next()).strict_ln();
    let mut coder = Coder::new(&tiles, settings, first.strict_exp(), None);
    let mut found = tried(picture, splats, &mut coder, search)?;
    for _ in 1..quality::MAX_ROUGH_TRIES {
        let (next, change) = (search.next(), search.next_logarithm() - first);
        if is_last && change.abs() < quality::MAX_STEP_CHANGE_WITH_SAME_BLOCKS
            || (found.score - search.wanted).abs() < quality::ROUGH_TOLERANCE
            || found.score > search.wanted && found.coded.bytes <= (quality::EMPTY_TILE_BYTES * tiles.len()) as u64
            || picture.state.clock.is_over()
            || search.has_tried(next)
        {
            break;
        }
        if change.abs() >= quality::MAX_STEP_CHANGE_WITH_SAME_BLOCKS {
            coder = Coder::new(&tiles, settings, f64::from(next), None);
        }
        found = tried(picture, splats, &mut coder, search)?;
    }
    Ok(found)
}

/// Fits the Gaussians' integers to the layer of `found`, and codes another one over them with the step that the score
/// asks for.
fn descended(
    picture: &mut WholePicture<'_>,
    splats: &PackedSplats,
    found: &Tried,
    settings: &SearchSettings,
    search: &StepSearch,
) -> Result<(PackedSplats, Tried, StepSearch)> {
    let next = refined(picture, splats, &found.coded.layer)?;
    let tiles = residuals(picture, &next);
    let mut after = search.after();
    let mut coder = Coder::new(&tiles, settings, f64::from(after.next()), Some(&found.coded));
    let tried = tried(picture, &next, &mut coder, &mut after)?;
    Ok((next, tried, after))
}

/// Returns the layer over `splats` whose score is closest to the one of `search`. `found` is the last one that was
/// tried.
fn closely(
    picture: &mut WholePicture<'_>,
    splats: &PackedSplats,
    settings: &SearchSettings,
    mut search: StepSearch,
    mut found: Tried,
) -> Result<Tried> {
    let wanted = search.wanted;
    if (found.score - wanted).abs() <= quality::ACCEPTED_TOLERANCE {
        return Ok(found);
    }
    let tiles = residuals(picture, splats);
    let near = SearchSettings { keeps_blocks: true, ..*settings };
    let step = f64::from(found.coded.layer.head.step);
    let mut coder = Coder::new(&tiles, &near, step, Some(&found.coded));
    for _ in 0..quality::MAX_LAYER_TRIES {
        if (found.score - wanted).abs() <= quality::ACCEPTED_TOLERANCE
            || picture.state.clock.is_over()
            || search.has_tried(search.next())
        {
            break;
        }
        let tried = tried(picture, splats, &mut coder, &mut search)?;
        if tried.distance(wanted) < found.distance(wanted) {
            found = tried;
        }
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_typical_steps_grow_as_the_score_falls() {
        assert!(quality::TYPICAL_STEPS.is_sorted_by(|a, b| a[0] < b[0] && a[1] > b[1]));
        for [step, points] in quality::TYPICAL_STEPS {
            assert!((typical_step(points) - step).abs() < 1e-9, "{points}");
        }
        assert!(typical_step(100.0) < quality::TYPICAL_STEPS[0][0]);
    }

    #[test]
    fn a_score_is_found_in_three_steps_for_pictures_with_other_curves() {
        // Curves that are shifted, steeper and flatter than the typical one.
        for (shift, slope) in [(-0.4, 1.0), (0.3, 1.2), (0.2, 0.8), (0.0, 1.3)] {
            for wanted in [50.0, 70.0, 85.0] {
                let score = |step: u16| {
                    let typical = shift + slope * (f64::from(step).ln() - 6.5) + 6.5;
                    let points = (0..2000).map(|i| f64::from(i) * 0.08 - 60.0);
                    points.min_by(|a, b| {
                        (typical_step(*a) - typical).abs().total_cmp(&(typical_step(*b) - typical).abs())
                    })
                };
                let mut search = StepSearch::new(wanted, typical_step(wanted));
                let mut tries = 0;
                loop {
                    let step = search.next();
                    let found = score(step).unwrap();
                    search.note(step, found);
                    tries += 1;
                    if (found - wanted).abs() <= quality::ACCEPTED_TOLERANCE {
                        break;
                    }
                    assert!(tries < 5, "{shift} {slope} {wanted}: {search:?}");
                }
            }
        }
    }
}
