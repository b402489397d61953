//! Removes primitives from a file whose score is above the requested one.
//!
//! It saves time: six pictures of 128 pixels at a quality of 50 and effort 3 take a third less than with a search that goes
//! on until the score is close, whose files are 2 % smaller. `python lab/constants.py quality::MAX_TRIMMED_POINTS 0.5
//! --pictures PICTURES --ratio q50 --effort 3` measures such a search.

use super::file;
use super::input::stored_scene;
use super::state::Outcome;
use super::whole::WholePicture;
use crate::bitstream::splats::PackedSplats;
use crate::constants::quality;
use crate::error::Result;
use crate::fit::model::drawing::field::{Field, Output};
use crate::fit::model::objective::rows::RowSet;
use crate::fit::model::placing::removal;
use crate::fit::model::problem::Problem;
use crate::rdo::rounded::projected;

/// Maximum number of primitives that are tried individually after groups of them can no longer be removed.
const MAX_SINGLY_REMOVED: usize = 24;

/// Removes the least important primitives as long as the score stays at or above `wanted`.
pub(super) fn trim(picture: &mut WholePicture<'_>, outcome: &mut Outcome, wanted: f64) -> Result<()> {
    if !outcome.splats.levels.is_empty() || outcome.splats.detail.is_some() {
        return Ok(());
    }
    let clock = picture.state.report.seconds();
    let splats = &outcome.splats;
    let problem = Problem { scene: stored_scene(splats), target: &picture.planes };
    let drawn = projected(&splats.quantizer(), &splats.gaussians, splats.height);
    let mut field = Field::default();
    field.draw(&problem, &drawn, RowSet::ALL, Output::Picture);
    let order = removal::cheapest_first(&removal::costs(&problem, &field, RowSet::ALL, &drawn));
    let without = |out: &[usize]| {
        let mut is_out = vec![false; order.len()];
        out.iter().for_each(|&i| is_out[i] = true);
        let left = splats.gaussians.iter().zip(&is_out).filter(|(_, out)| !**out).map(|(g, _)| *g);
        PackedSplats { gaussians: left.collect(), codebook: None, ..splats.clone() }
    };
    // Without the first `sure` primitives the score is still high enough; without the first `over` it is not.
    let (mut sure, mut over, mut points) = (0, order.len() + 1, outcome.quality);
    // The first guess is small, because a point is roughly a hundredth of the score.
    let mut next = order.len() / 64 + 1;
    let resolution = (order.len() / 1000).max(1);
    while over - sure > resolution && !picture.state.clock.is_over() {
        let count = next.clamp(sure + 1, over - 1);
        let found = picture.score(&without(&order[..count]))?;
        if found >= wanted {
            (sure, points) = (count, Some(found));
            if found - wanted < quality::AIM_ABOVE {
                break;
            }
        } else {
            over = count;
        }
        next = if over > order.len() { sure * 2 } else { (sure + over) / 2 };
    }
    // Primitives that hardly affect the squared error can still be visible, so the next ones are tried
    // individually.
    let mut out = order[..sure].to_vec();
    for &i in order[sure..].iter().take(MAX_SINGLY_REMOVED) {
        if points.is_none_or(|p| p - wanted < quality::AIM_ABOVE) || picture.state.clock.is_over() {
            break;
        }
        out.push(i);
        let found = picture.score(&without(&out))?;
        if found >= wanted {
            points = Some(found);
        } else {
            out.pop();
        }
    }
    if !out.is_empty() {
        let mut fewer = without(&out);
        let narrow = file::smallest(&mut fewer, 1)?;
        let bytes = if picture.state.fits_all_channels() { narrow } else { picture.state.file(&fewer)? };
        if bytes.len() < outcome.bytes.len() {
            outcome.pruned_bytes += (outcome.bytes.len() - bytes.len()) as u64;
            (outcome.bytes, outcome.splats, outcome.quality) = (bytes, fewer, points);
        }
    }
    picture.state.report.stage("prune", clock);
    Ok(())
}
