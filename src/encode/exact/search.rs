//! Searches for the smallest tolerance of colours with which the picture fits, or the largest one that reaches a quality.

use std::sync::Arc;

use super::mask::Mask;
use super::survey::Survey;
use super::{Candidate, Goal, Judge, mixed};
use crate::bitstream::ExactLayer;
use crate::bitstream::exact::near::approximate;
use crate::bitstream::exact::tile::Shape;
use crate::bitstream::exact::{ExactTile, tile_area};
use crate::bitstream::splats::PackedSplats;
use crate::constants::exact;
use crate::encode::clock::Clock;
use crate::encode::report::ReportBuilder;
use crate::encode::thumbnail;
use crate::error::Result;
use crate::instant::Instant;
use crate::options::EncodeOptions;
use crate::parallel;
use crate::pixels::Pixels;
use crate::strict_math::StrictMath;

/// Bytes that the parts of a file take besides the streams of the exact layer.
const FILE_BYTES: u64 = 48;

/// A layer with near colours.
struct Approximation {
    layer: ExactLayer,
    /// Estimated bits of each cell of each tile.
    bits: Vec<Vec<f32>>,
    /// Estimated bytes of the layer.
    bytes: f64,
}

/// Returns the best file whose exact layer has near colours, or `None` if none reaches the goal. `shown` is the picture
/// that the layer stores, and `exact` the bytes of a file without loss, if they are known.
///
/// # Errors
/// [`Error::Cancelled`](crate::Error::Cancelled) if the caller cancels.
pub(super) fn near(
    survey: &Survey,
    judge: &Judge<'_>,
    (shown, mask): (&Pixels, Option<&Mask>),
    (exact, clock): (Option<usize>, &Clock),
    options: &EncodeOptions,
    report: &mut ReportBuilder<'_>,
) -> Result<Option<Candidate>> {
    let since = report.seconds();
    let masked = mask.map(|mask| ExactLayer::of(shown, exact::TILE_SIDES[0], |x, y| mask.covers([x, y])));
    let layer = masked.as_ref().unwrap_or(&survey.layer);
    let found = match *judge.goal {
        Goal::Bytes(bytes) => {
            let bytes = bytes.saturating_sub(thumbnail::reserved(options, survey.size, bytes));
            if mask.is_some()
                && exact.is_some_and(|exact| exact as f64 <= exact::MAX_NEAR_PHOTOGRAPH_SIZE * bytes as f64)
            {
                let found = fitting(survey, &survey.layer, None, (bytes, exact::MAX_SURE_TOLERANCE), (clock, report))?;
                if let Some((layer, tolerance)) = found {
                    report.stage("exact layer", since);
                    return Candidate::new(survey.file(layer, options), tolerance).map(Some);
                }
            }
            fitting(survey, layer, mask, (bytes, exact::MAX_TOLERANCE), (clock, report))?.map(|found| (found, bytes))
        }
        _ => {
            // Photographs take most of the time.
            if mask.is_some() && clock.is_over() {
                return Ok(None);
            }
            let photographs = mask.map(|mask| mixed::reaching(mask, judge, clock, options, report)).transpose()?;
            // There is a mask, but no file of its photographs.
            if let Some(None) = photographs {
                return Ok(None);
            }
            return reaching(survey, layer, photographs.flatten().as_ref(), judge, options, (clock, report));
        }
    };
    report.stage("exact layer", since);
    let Some(((layer, tolerance), bytes)) = found else { return Ok(None) };
    let file = survey.file(layer, options);
    match mask {
        None => Candidate::new(file, tolerance).map(Some),
        Some(mask) => mixed::file((file, tolerance), mask, judge.pixels, (bytes, clock), options, report),
    }
}

/// Returns the layer with the smallest tolerance up to `most` that fits into `bytes`, and the tolerance. When the time ends,
/// it is the smallest one that was tried, or `most`.
fn fitting(
    survey: &Survey,
    layer: &ExactLayer,
    mask: Option<&Mask>,
    (bytes, most): (u64, u32),
    (clock, report): (&Clock, &mut ReportBuilder<'_>),
) -> Result<Option<(ExactLayer, u32)>> {
    let room = bytes.saturating_sub(FILE_BYTES) as f64;
    // The largest tolerance that does not fit, and the smallest that does.
    let (mut too_small, mut best) = (0, None::<(Approximation, u32)>);
    let (mut next, mut last, mut power) =
        (exact::FIRST_TOLERANCE.min(most), None::<[f64; 2]>, exact::TOLERANCE_EXPONENT);
    loop {
        report.stage_progress("exact layer", too_small as f32 / most as f32)?;
        let start = Instant::now();
        let tried = approximated(survey, layer, next, None);
        let has_time = clock.left().is_none_or(|left| left > start.elapsed());
        let bytes = tried.bytes
            + mask.map_or(0.0, |mask| mask.transform_bytes(next as f32) / (1.0 - exact::PHOTOGRAPH_BASE_SHARE));
        let logs = [f64::from(next), bytes / room].map(|v| v.strict_ln());
        if bytes <= room {
            let is_filled = bytes >= exact::MIN_FILLED * room;
            best = Some((tried, next));
            if is_filled {
                break;
            }
        } else {
            too_small = next;
        }
        let fits = best.as_ref().map_or(most + 1, |&(_, fits)| fits);
        if !has_time && best.is_some() {
            break;
        }
        if too_small + 1 >= fits {
            // Between no loss and a tolerance of 1, a part of the picture can be without loss.
            if let (Some((coarse, 1)), None) = (&best, mask) {
                report.stage_progress("exact layer", 0.0)?;
                let mixed = partly_exact(survey, layer, coarse, room, clock);
                best = best.map(|(coarse, fits)| (mixed.unwrap_or(coarse), fits));
            }
            break;
        }
        // The bytes fall with a power of the tolerance, which is that between the last two tries.
        if let Some([tolerance, bytes]) = last {
            power = ((bytes - logs[1]) / (logs[0] - tolerance))
                .clamp(exact::TOLERANCE_EXPONENT / 4.0, 4.0 * exact::TOLERANCE_EXPONENT);
        }
        last = Some(logs);
        let wanted = (logs[0] + logs[1] / power).strict_exp().ceil();
        next = (wanted.min(f64::from(most)) as u32).clamp(too_small + 1, fits - 1);
        if !has_time {
            next = most;
        }
    }
    Ok(best.map(|(found, tolerance)| (found.layer, tolerance)))
}

/// Returns a layer that fits into `room` bytes and is without loss in as many cells as possible; the others have a
/// tolerance of 1, with which `coarse` fits. These are the cells in which that saves most, whose colours hide the
/// difference best. Returns `None` if no such layer is found.
fn partly_exact(
    survey: &Survey,
    layer: &ExactLayer,
    coarse: &Approximation,
    room: f64,
    clock: &Clock,
) -> Option<Approximation> {
    let exact = approximated(survey, layer, 0, None);
    let mut saved: Vec<(f32, usize, usize)> = Vec::new();
    for (tile, (exact, coarse)) in exact.bits.iter().zip(&coarse.bits).enumerate() {
        saved.extend(exact.iter().zip(coarse).enumerate().map(|(cell, (exact, coarse))| (exact - coarse, tile, cell)));
    }
    saved.retain(|&(bits, ..)| bits > 0.0);
    saved.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then((a.1, a.2).cmp(&(b.1, b.2))));
    // Contexts repeat less at the borders of the cells, so that the layer is larger than the sum of its cells. The next
    // try aims at less, by what the last one shows.
    let mut aim = room;
    for _ in 0..exact::PARTLY_EXACT_TRIES {
        let mut missing = 8.0 * (exact.bytes - aim);
        let mut kept: Vec<Vec<bool>> = exact.bits.iter().map(|bits| vec![true; bits.len()]).collect();
        for &(bits, tile, cell) in &saved {
            if missing <= 0.0 {
                break;
            }
            missing -= f64::from(bits);
            kept[tile][cell] = false;
        }
        let found = approximated(survey, layer, 1, Some(&kept));
        if found.bytes <= room {
            return Some(found);
        }
        if clock.is_over() {
            break;
        }
        let share = (exact::PARTLY_EXACT_AIM * room - coarse.bytes) / (found.bytes - coarse.bytes);
        aim = coarse.bytes + share.clamp(0.0, 1.0) * (aim - coarse.bytes);
    }
    None
}

/// Returns the file with the largest tolerance that reaches a quality, if one does, of those that are tried in time. `photographs` is what the layer does
/// not cover.
fn reaching(
    survey: &Survey,
    layer: &ExactLayer,
    photographs: Option<&PackedSplats>,
    judge: &Judge<'_>,
    options: &EncodeOptions,
    (clock, report): (&Clock, &mut ReportBuilder<'_>),
) -> Result<Option<Candidate>> {
    let (mut reaches, mut misses, mut best) = (0, exact::MAX_TOLERANCE + 1, None);
    let mut next = exact::FIRST_TOLERANCE;
    // Finer steps hardly change the size.
    while reaches + 1 < misses && reaches * exact::TOLERANCE_RESOLUTION < misses * (exact::TOLERANCE_RESOLUTION - 1) {
        report.stage_progress("exact layer", reaches as f32 / exact::MAX_TOLERANCE as f32)?;
        let start = Instant::now();
        let layer = approximated(survey, layer, next, None).layer;
        let splats = match photographs {
            Some(photographs) => PackedSplats { exact: Some(Arc::new(layer)), ..photographs.clone() },
            None => survey.file(layer, options),
        };
        if judge.is_met(&splats)? {
            (reaches, best) = (next, Some((splats, next)));
        } else {
            misses = next;
        }
        if clock.left().is_some_and(|left| left < start.elapsed()) {
            break;
        }
        let middle = (f64::from(reaches.max(1)) * f64::from(misses)).sqrt() as u32;
        next = middle.clamp(reaches + 1, (misses - 1).max(reaches + 1));
    }
    best.map(|(splats, tolerance)| Candidate::new(splats, tolerance)).transpose()
}

/// Chooses near colours for all tiles of a layer. The cells of each tile that are `kept` have no loss.
fn approximated(survey: &Survey, layer: &ExactLayer, tolerance: u32, kept: Option<&[Vec<bool>]>) -> Approximation {
    let tiles = parallel::map(layer.tiles.len(), |i| {
        let [_, _, width, height] = tile_area(survey.size, layer.side, i);
        let shape = Shape { size: [width, height], channels: survey.channels, depth: survey.depth };
        let kept = kept.map(|cells| &cells[i][..]);
        layer.tiles[i].as_ref().map(|tile| approximate(tile, &shape, tolerance as f32, kept))
    });
    let (tiles, bits): (Vec<Option<ExactTile>>, Vec<Vec<f32>>) = tiles
        .into_iter()
        .map(|chosen| chosen.map_or((None, Vec::new()), |chosen| (Some(chosen.tile), chosen.bits)))
        .unzip();
    let bytes = bits.iter().flatten().map(|&bits| f64::from(bits)).sum::<f64>() / 8.0;
    Approximation { layer: ExactLayer { side: layer.side, tiles }, bits, bytes }
}
