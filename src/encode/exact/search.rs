//! Searches for the smallest tolerance of colours with which the picture fits, or the largest one that reaches a quality.

use super::mask::Mask;
use super::survey::Survey;
use super::{Candidate, Goal, Judge, mixed};
use crate::bitstream::ExactLayer;
use crate::bitstream::exact::near::approximate;
use crate::bitstream::exact::tile::Shape;
use crate::bitstream::exact::{ExactTile, tile_area};
use crate::encode::report::ReportBuilder;
use crate::encode::thumbnail;
use crate::error::Result;
use crate::options::EncodeOptions;
use crate::parallel;

/// Largest tolerance, in 8-bit code values. With larger ones, letters lose their shape.
const MAX_TOLERANCE: u32 = 48;
/// Tolerance of the first try.
const FIRST_TOLERANCE: u32 = 8;
/// Bytes that the parts of a file take besides the streams of the exact layer.
const FILE_BYTES: u64 = 48;

/// A layer with near colours.
struct Approximation {
    layer: ExactLayer,
    /// Estimated bytes of the layer.
    bytes: f64,
}

/// Returns the best file whose exact layer has near colours, or `None` if none reaches the goal.
///
/// # Errors
/// [`Error::Cancelled`](crate::Error::Cancelled) if the caller cancels.
pub(super) fn near(
    survey: &Survey,
    judge: &Judge<'_>,
    mask: Option<&Mask>,
    options: &EncodeOptions,
    report: &mut ReportBuilder<'_>,
) -> Result<Option<Candidate>> {
    let since = report.seconds();
    let masked = mask.map(|mask| mask.applied(&survey.layer, survey));
    let layer = masked.as_ref().unwrap_or(&survey.layer);
    let found = match *judge.goal {
        Goal::Bytes(bytes) => {
            let bytes = bytes.saturating_sub(thumbnail::reserved(options, survey.size, bytes));
            fitting(survey, layer, mask, bytes, report)?.map(|found| (found, bytes))
        }
        _ if mask.is_some() => None,
        _ => return reaching(survey, judge, options, report),
    };
    report.stage("exact layer", since);
    let Some(((layer, tolerance), bytes)) = found else { return Ok(None) };
    let file = survey.file(layer, options);
    match mask {
        None => Candidate::new(file, tolerance).map(Some),
        Some(mask) => mixed::file((file, tolerance), mask, judge.pixels, bytes, options, report),
    }
}

/// Returns the layer with the smallest tolerance that fits into `bytes`, and the tolerance.
fn fitting(
    survey: &Survey,
    layer: &ExactLayer,
    mask: Option<&Mask>,
    bytes: u64,
    report: &mut ReportBuilder<'_>,
) -> Result<Option<(ExactLayer, u32)>> {
    let room = bytes.saturating_sub(FILE_BYTES) as f64;
    let (mut too_small, mut best) = (0, None::<(ExactLayer, u32)>);
    let mut next = FIRST_TOLERANCE;
    loop {
        report.stage_progress("exact layer", too_small as f32 / MAX_TOLERANCE as f32)?;
        let tried = approximated(survey, layer, next);
        let rest = mask.map_or(0.0, |mask| mask.transform_bytes(next as f32));
        if tried.bytes + rest <= room {
            best = Some((tried.layer, next));
        } else {
            too_small = next;
        }
        next = match &best {
            // Geometric means, because quality depends on the logarithm.
            Some((_, fits)) => ((f64::from(*fits) * f64::from(too_small.max(1))).sqrt() as u32).max(too_small + 1),
            None => (2 * too_small).min(MAX_TOLERANCE),
        };
        if best.as_ref().is_some_and(|(_, fits)| next >= *fits) || too_small == MAX_TOLERANCE {
            return Ok(best);
        }
    }
}

/// Returns the file with the largest tolerance that reaches a quality, if one does.
fn reaching(
    survey: &Survey,
    judge: &Judge<'_>,
    options: &EncodeOptions,
    report: &mut ReportBuilder<'_>,
) -> Result<Option<Candidate>> {
    let (mut reaches, mut misses, mut best) = (0, MAX_TOLERANCE + 1, None);
    let mut next = FIRST_TOLERANCE;
    while reaches + 1 < misses {
        report.stage_progress("exact layer", reaches as f32 / MAX_TOLERANCE as f32)?;
        let splats = survey.file(approximated(survey, &survey.layer, next).layer, options);
        if judge.is_met(&splats)? {
            (reaches, best) = (next, Some((splats, next)));
        } else {
            misses = next;
        }
        let middle = (f64::from(reaches.max(1)) * f64::from(misses)).sqrt() as u32;
        next = middle.clamp(reaches + 1, (misses - 1).max(reaches + 1));
    }
    best.map(|(splats, tolerance)| Candidate::new(splats, tolerance)).transpose()
}

/// Chooses near colours for all tiles of a layer.
fn approximated(survey: &Survey, layer: &ExactLayer, tolerance: u32) -> Approximation {
    let tiles = parallel::map(layer.tiles.len(), |i| {
        let [_, _, width, height] = tile_area(survey.size, layer.side, i);
        let shape = Shape { size: [width, height], channels: survey.channels, depth: survey.depth };
        layer.tiles[i].as_ref().map(|tile| approximate(tile, &shape, tolerance as f32))
    });
    let bits = tiles.iter().flatten().map(|chosen| f64::from(chosen.bits.iter().sum::<f32>())).sum::<f64>();
    let tiles: Vec<Option<ExactTile>> = tiles.into_iter().map(|chosen| chosen.map(|chosen| chosen.tile)).collect();
    Approximation { layer: ExactLayer { side: layer.side, tiles }, bytes: bits / 8.0 }
}
