//! The number of integer primitives, corrected by the bytes that they are over or under.

use crate::bitstream::splats::PackedGaussian;
use crate::fit::model::field::Output;
use crate::fit::model::rows::RowSet;
use crate::fit::model::{peaks, removal};
use crate::round::descend::Descent;

/// The size that a file may have.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Size {
    /// At most this many bytes, and as close to it as can be.
    Bytes(u64),
    /// As it comes.
    Free,
}

/// Bytes of a file that are not its primitives', about: the header.
const HEADER: u64 = 20;

/// Share of the room that is filled with new primitives: the first guess of their price may be too low, and a file that is
/// too long costs another round.
const FILLED: f64 = 0.97;

/// Takes away the cheapest of `gaussians`, or adds some where the error is largest, by the bytes over or under `most`.
pub(super) fn resize(descent: &mut Descent<'_>, gaussians: &mut Vec<PackedGaussian>, bytes: u64, most: u64) {
    let current = descent.seen(gaussians);
    let Descent { problem, quantizer, activity, field, .. } = descent;
    let each = (bytes.saturating_sub(HEADER) as f64 / gaussians.len().max(1) as f64).max(1.0);
    field.draw(problem, &current, RowSet::ALL, Output::Picture);
    if bytes > most {
        if gaussians.is_empty() {
            return;
        }
        let count = (((bytes - most) as f64 / each).ceil() as usize).clamp(1, gaussians.len());
        let costs = removal::costs(problem, field, RowSet::ALL, &current[..gaussians.len()]);
        let mut removed = vec![false; costs.len()];
        for i in removal::cheapest(&costs, count) {
            removed[i] = true;
            activity.mark(&quantizer.dequantize(&gaussians[i]));
        }
        let mut i = 0;
        gaussians.retain(|_| {
            i += 1;
            !removed[i - 1]
        });
    } else {
        let count = ((most - bytes) as f64 / each * FILLED) as usize;
        for peak in peaks::peaks(problem, field, RowSet::ALL, count, gaussians.len()) {
            let added = quantizer.quantize(&peaks::at_peak(&peak, problem).to_gaussian());
            activity.mark(&quantizer.dequantize(&added));
            gaussians.push(added);
        }
    }
}

/// What the primitives of a part of a picture are worth, and what others would be.
#[derive(Debug, Default)]
pub(crate) struct Worth {
    /// What each of them costs to remove, squared error.
    pub costs: Vec<f32>,
    /// Others, with the drop of the squared error that each is estimated to bring; best first.
    pub others: Vec<(PackedGaussian, f32)>,
}

/// Returns what `gaussians` are worth, and at most `count` others.
pub(crate) fn worth(descent: &mut Descent<'_>, gaussians: &[PackedGaussian], count: usize) -> Worth {
    let current = descent.seen(gaussians);
    let Descent { problem, quantizer, field, .. } = descent;
    field.draw(problem, &current, RowSet::ALL, Output::Picture);
    let costs = removal::costs(problem, field, RowSet::ALL, &current[..gaussians.len()]);
    let others = match count {
        0 => Vec::new(),
        _ => peaks::peaks(problem, field, RowSet::ALL, count, gaussians.len()),
    };
    let other = |peak| quantizer.quantize(&peaks::at_peak(peak, problem).to_gaussian());
    Worth { costs, others: others.iter().map(|peak| (other(peak), peak.gain)).collect() }
}
