//! Removes the primitives that a file does not need, after the fit.

use std::cell::Cell;

use super::file;
use super::input::stored_scene;
use super::state::Outcome;
use super::whole::WholePicture;
use crate::bitstream::splats::{PackedGaussian, PackedSplats};
use crate::constants::encode;
use crate::error::Result;
use crate::fit::model::drawing::field::{Field, Output};
use crate::fit::model::objective::rows::RowSet;
use crate::fit::model::placing::removal;
use crate::fit::model::problem::{Problem, overlap};
use crate::rdo::descend::Descent;
use crate::rdo::rounded::projected;

/// Removes primitives as long as the squared error over the fitted samples stays within `max_error`.
pub(super) fn prune(picture: &mut WholePicture<'_>, outcome: &mut Outcome, max_error: f64) -> Result<()> {
    if outcome.splats.detail.is_some() {
        return Ok(());
    }
    let clock = picture.state.report.seconds();
    let problem = Problem { scene: stored_scene(&outcome.splats), target: &picture.planes };
    let time = picture.state.clock;
    let Some(pruned) = pruned(&problem, &outcome.splats, max_error, &|| time.is_over()) else { return Ok(()) };
    let file = picture.state.file(&pruned)?;
    if file.len() < outcome.bytes.len() {
        outcome.pruned_bytes += (outcome.bytes.len() - file.len()) as u64;
        (outcome.bytes, outcome.splats) = (file, pruned);
    }
    picture.state.report.stage("prune", clock);
    Ok(())
}

/// Returns `splats` with the fewest primitives found that keep the squared error within `max_error`. The search ends
/// early when `is_over` returns true. Returns `None` if all primitives are needed.
fn pruned(
    problem: &Problem<'_>,
    splats: &PackedSplats,
    max_error: f64,
    is_over: &dyn Fn() -> bool,
) -> Option<PackedSplats> {
    if !splats.levels.is_empty() {
        return None;
    }
    let quantizer = splats.quantizer();
    let floats: Vec<_> = splats.gaussians.iter().map(|g| quantizer.dequantize(g)).collect();
    let overlap = overlap(&problem.scene, &floats).max(1.0);
    let (rendered, most) =
        (Cell::new(0), encode::MIN_PRUNING_RENDERS.max((encode::MAX_PRUNING_RENDERS / overlap) as usize));
    let is_over = || is_over() || rendered.get() >= most;
    let project = |gaussians: &[PackedGaussian]| projected(&quantizer, gaussians, problem.scene.height);
    let mut field = Field::default();
    let mut best = splats.gaussians.clone();
    for _ in 0..encode::MAX_PRUNING_ROUNDS {
        if is_over() {
            break;
        }
        let mut trial = best.clone();
        if trial.len() < splats.gaussians.len() {
            let lambda = 0.0;
            Descent::new(*problem, &quantizer, Field::default()).sweep(&mut trial, &[], lambda);
        }
        let drawn = project(&trial);
        rendered.set(rendered.get() + 1);
        if field.draw(problem, &drawn, RowSet::ALL, Output::Picture) > max_error {
            break;
        }
        let costs = removal::costs(problem, &field, RowSet::ALL, &drawn);
        let order = removal::cheapest_first(&costs);
        // Searches for the maximum number that can be removed: `sure` primitives can be removed, `over` cannot.
        let (mut sure, mut over) = (0, trial.len() + 1);
        let without = |count: usize| -> Vec<PackedGaussian> {
            let mut removed = vec![false; trial.len()];
            order[..count].iter().for_each(|&i| removed[i] = true);
            trial.iter().zip(&removed).filter(|(_, r)| !**r).map(|(g, _)| *g).collect()
        };
        while over - sure > 1 && !is_over() {
            let middle = (sure + over) / 2;
            let rest = project(&without(middle));
            rendered.set(rendered.get() + 1);
            match field.draw(problem, &rest, RowSet::ALL, Output::Picture) <= max_error {
                true => sure = middle,
                false => over = middle,
            }
        }
        if sure == 0 {
            break;
        }
        best = without(sure);
        // The remaining gain would not be worth another round.
        if sure * encode::MIN_PRUNED_PART < best.len() {
            break;
        }
    }
    if best.len() <= encode::MAX_SINGLY_PRUNED && !is_over() {
        let mut error =
            |gaussians: &[PackedGaussian]| field.draw(problem, &project(gaussians), RowSet::ALL, Output::Picture);
        let mut i = if error(&best) <= max_error { 0 } else { best.len() };
        while i < best.len() && !is_over() {
            rendered.set(rendered.get() + 1);
            let mut without = best.clone();
            without.remove(i);
            if error(&without) <= max_error { best = without } else { i += 1 }
        }
    }
    if best.len() == splats.gaussians.len() {
        return None;
    }
    let mut pruned = PackedSplats { gaussians: best, ..splats.clone() };
    file::smallest(&mut pruned, 1).ok()?;
    Some(pruned)
}
