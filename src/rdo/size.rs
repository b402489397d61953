//! Corrections of the number of integer primitives, by the bytes above or below the requested size.

use crate::bitstream::splats::PackedGaussian;
use crate::constants::rdo;
use crate::fit::model::drawing::field::Output;
use crate::fit::model::objective::rows::RowSet;
use crate::fit::model::placing::{peaks, removal};
use crate::rdo::descend::Descent;

/// The requested size of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Size {
    /// At most this many bytes, and as close to that as possible.
    Bytes(u64),
    /// No requested size.
    Free,
}

impl Size {
    /// Returns the number of bytes by which `file` exceeds the requested size.
    pub(crate) fn exceeded_by(self, file: &[u8]) -> u64 {
        match self {
            Size::Bytes(max_bytes) => (file.len() as u64).saturating_sub(max_bytes),
            Size::Free => 0,
        }
    }
}

/// Approximate number of bytes of a file that are not its primitives': the header.
const HEADER: u64 = 20;

/// Returns whether a file is as large as it may be: below `max_bytes` by no more than one part in `part`.
pub(crate) fn is_settled(bytes: u64, max_bytes: u64, part: u64) -> bool {
    bytes <= max_bytes && max_bytes - bytes <= (max_bytes / part).max(rdo::SETTLED_BYTES)
}

/// Change of the number of primitives that brings a file to its size.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Correction {
    /// This many primitives are too many.
    Remove(usize),
    /// There are bytes for this many more primitives.
    Add(usize),
}

/// Returns the correction of a file of `bytes`, of which `count` primitives take `primitives` bytes, to `max_bytes`.
pub(crate) fn correction(count: usize, primitives: u64, bytes: u64, max_bytes: u64) -> Correction {
    let each = (primitives as f64 / count.max(1) as f64).max(1.0);
    match bytes.checked_sub(max_bytes) {
        Some(over @ 1..) => Correction::Remove((over as f64 / each).ceil() as usize),
        _ => Correction::Add(((max_bytes - bytes) as f64 / each * rdo::FILL_SHARE) as usize),
    }
}

/// Removes the cheapest of `gaussians`, or adds some where the error is largest, by the bytes above or below
/// `max_bytes`.
pub(super) fn resize(descent: &mut Descent<'_>, gaussians: &mut Vec<PackedGaussian>, bytes: u64, max_bytes: u64) {
    let current = descent.visible(gaussians);
    let Descent { problem, quantizer, activity, field, .. } = descent;
    let correction = correction(gaussians.len(), bytes.saturating_sub(HEADER), bytes, max_bytes);
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

/// The worth of the primitives in a part of a picture, and of candidates that could be added.
#[derive(Debug, Default)]
pub(crate) struct Worth {
    /// Increase of the squared error if a primitive were removed, for each primitive.
    pub costs: Vec<f32>,
    /// Candidates with the estimated decrease of the squared error, best first.
    pub candidates: Vec<(PackedGaussian, f32)>,
}

/// Returns the worth of `gaussians`, and at most `count` candidates.
pub(crate) fn worth(descent: &mut Descent<'_>, gaussians: &[PackedGaussian], count: usize) -> Worth {
    let current = descent.visible(gaussians);
    let Descent { problem, quantizer, field, .. } = descent;
    field.draw(problem, &current, RowSet::ALL, Output::Picture);
    let costs = removal::costs(problem, field, RowSet::ALL, &current[..gaussians.len()]);
    let candidates = match count {
        0 => Vec::new(),
        _ => peaks::peaks(problem, field, RowSet::ALL, count, gaussians.len()),
    };
    let quantized = |peak| quantizer.quantize(&peaks::at_peak(peak, problem).to_gaussian());
    Worth { costs, candidates: candidates.iter().map(|peak| (quantized(peak), peak.gain)).collect() }
}
