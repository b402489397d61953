//! What an encode did without, and what that saved.

use super::session::{Outcome, Session};
use crate::bitstream::splats::PackedSplats;
use crate::error::Result;
use crate::fit::finish;
use crate::fit::target::Target as Planes;
use crate::leave_out;

/// Something that the encoder did without, because the picture or the options do not need it or it was not to be had.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct LeftOut {
    /// What it is, a colon, and why.
    pub what: String,
    /// Bytes saved; 0 where it saves only time, which then buys quality, or nothing that was measured.
    pub bytes: u64,
    /// Seconds saved, estimated from the cost of one iteration with and without it; 0 where that is not known.
    pub seconds: f64,
}

/// All of it, in the order in which it was found.
#[derive(Debug, Default)]
pub(super) struct Savings(Vec<LeftOut>);

impl Savings {
    /// Notes what was left out, in place of what an earlier attempt left out for the same reason.
    pub(super) fn note(&mut self, what: impl Into<String>, bytes: u64, seconds: f64) {
        let what = what.into();
        self.0.retain(|l| l.what != what);
        self.0.push(LeftOut { what, bytes, seconds });
    }

    pub(super) fn into_list(self) -> Vec<LeftOut> {
        self.0
    }
}

impl Session<'_> {
    /// Takes out the primitives without which the squared error of what was fitted stays within `enough`.
    pub(super) fn prune(&mut self, outcome: &mut Outcome, enough: f64) -> Result<()> {
        let clock = self.tracer.seconds();
        let scene = self.stored_scene(&outcome.splats);
        let Some(pruned) = leave_out::pruned(&scene, &self.planes, &outcome.splats, enough) else { return Ok(()) };
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
            let draw = || leave_out::drawing_seconds(&scene, planes, &projected);
            draw().min(draw())
        };
        let spent: f64 = self.stages.iter().map(|s| s.1).sum();
        let saved = spent * (seconds(whole) / seconds(&self.planes).max(1e-9) - 1.0).max(0.0);
        // It was the first to be left out.
        self.savings.0.insert(0, LeftOut { what: what.to_owned(), bytes: 0, seconds: saved });
    }
}
