//! The number of integer primitives, corrected by the bytes that they are over or under.

use crate::bitstream::splats::PackedGaussian;
use crate::fit::model::drawing::field::Output;
use crate::fit::model::objective::rows::RowSet;
use crate::fit::model::placing::{peaks, removal};
use crate::round::descend::Descent;

/// The size that a file may have.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Size {
    /// At most this many bytes, and as close to it as can be.
    Bytes(u64),
    /// As it comes.
    Free,
}

impl Size {
    /// Returns the bytes by which a file is larger than it may be.
    pub(crate) fn exceeded_by(self, file: &[u8]) -> u64 {
        match self {
            Size::Bytes(most) => (file.len() as u64).saturating_sub(most),
            Size::Free => 0,
        }
    }
}

/// Bytes of a file that are not its primitives', about: the header.
const HEADER: u64 = 20;

/// Share of the room that is filled with new primitives: the first guess of their price may be too low, and a file that is
/// too long costs another round.
const FILLED: f64 = 0.97;

/// Bytes that a settled file may always be short: less than one primitive.
const SETTLED_BYTES: u64 = 4;

/// Returns whether a file is as large as it may be: short of `most` bytes by no more than one part in `part`.
pub(crate) fn is_settled(bytes: u64, most: u64, part: u64) -> bool {
    bytes <= most && most - bytes <= (most / part).max(SETTLED_BYTES)
}

/// Change of the number of primitives that brings a file to its size.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Correction {
    /// So many are too many.
    Remove(usize),
    /// There is room for so many more.
    Add(usize),
}

/// Returns the correction of a file of `bytes`, in which `count` primitives take `primitives` bytes, to `most` bytes.
pub(crate) fn correction(count: usize, primitives: u64, bytes: u64, most: u64) -> Correction {
    let each = (primitives as f64 / count.max(1) as f64).max(1.0);
    match bytes.checked_sub(most) {
        Some(over @ 1..) => Correction::Remove((over as f64 / each).ceil() as usize),
        _ => Correction::Add(((most - bytes) as f64 / each * FILLED) as usize),
    }
}

/// Takes away the cheapest of `gaussians`, or adds some where the error is largest, by the bytes over or under `most`.
pub(super) fn resize(descent: &mut Descent<'_>, gaussians: &mut Vec<PackedGaussian>, bytes: u64, most: u64) {
    let current = descent.seen(gaussians);
    let Descent { problem, quantizer, activity, field, .. } = descent;
    let correction = correction(gaussians.len(), bytes.saturating_sub(HEADER), bytes, most);
    field.draw(problem, &current, RowSet::ALL, Output::Picture);
    match correction {
        Correction::Remove(_) if gaussians.is_empty() => {}
        Correction::Remove(count) => {
            let count = count.clamp(1, gaussians.len());
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
        }
        Correction::Add(count) => {
            for peak in peaks::peaks(problem, field, RowSet::ALL, count, gaussians.len()) {
                let added = quantizer.quantize(&peaks::at_peak(&peak, problem).to_gaussian());
                activity.mark(&quantizer.dequantize(&added));
                gaussians.push(added);
            }
        }
    }
}

/// Worth of the primitives in a part of a picture, and of others that could be added.
#[derive(Debug, Default)]
pub(crate) struct Worth {
    /// Rise of the squared error if a primitive were removed, for each of them.
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
