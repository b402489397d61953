//! What is taken out after a fit, and what that and what was left out before it saved.

use super::channels;
use super::job::{Outcome, Session};
use crate::bitstream::splats::PackedSplats;
use crate::error::Result;
use crate::fit::model::planes::Target as Planes;
use crate::round::finish;

impl Session<'_> {
    /// Takes out the primitives without which the squared error of what was fitted stays within `enough`.
    pub(super) fn prune(&mut self, outcome: &mut Outcome, enough: f64) -> Result<()> {
        let clock = self.tracer.seconds();
        let scene = self.stored_scene(&outcome.splats);
        let Some(pruned) = channels::pruned(&scene, &self.planes, &outcome.splats, enough) else { return Ok(()) };
        let file = self.file(&pruned)?;
        if file.len() < outcome.bytes.len() {
            let what = "primitives without which the error stays below that of rounding, or of the target";
            self.savings.note(what, (outcome.bytes.len() - file.len()) as u64, 0.0);
            (outcome.bytes, outcome.splats) = (file, pruned);
        }
        self.stages.push(("prune", self.tracer.seconds() - clock));
        Ok(())
    }

    /// Notes what a codebook saved, from a file written without it.
    pub(super) fn note_codebook(&mut self, outcome: &Outcome) -> Result<()> {
        if outcome.splats.codebook.is_some() {
            let direct = self.file(&PackedSplats { codebook: None, ..outcome.splats.clone() })?;
            let saved = direct.len().saturating_sub(outcome.bytes.len()) as u64;
            self.savings.note("a colour of its own for each primitive: a codebook is smaller", saved, 0.0);
        }
        Ok(())
    }

    /// Notes the channels that were left out and the seconds that they would have taken: one iteration with them, as
    /// `whole` has them, and one without tell.
    pub(super) fn note_channels(&mut self, what: &'static str, whole: &Planes, splats: &PackedSplats) {
        let scene = self.stored_scene(splats);
        let projected = finish::projected(&splats.quantizer(), &splats.gaussians, splats.height);
        let seconds = |planes: &Planes| {
            let draw = || channels::drawing_seconds(&scene, planes, &projected);
            draw().min(draw())
        };
        let spent: f64 = self.stages.iter().map(|s| s.1).sum();
        let saved = spent * (seconds(whole) / seconds(&self.planes).max(1e-9) - 1.0).max(0.0);
        self.savings.note_first(what, saved);
    }
}
