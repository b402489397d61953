//! Writes the file of an encode, and reports its result.

use super::prepared::Prepared;
use super::render::check_metadata;
use super::report::{EncodeReport, Encoded};
use super::skipped::SkipReason;
use super::state::{EncodeState, Outcome, decibels};
use crate::bitstream::splats::{Metadata, PackedSplats};
use crate::error::Result;

/// Adds the metadata to a file, and reports the result.
pub(super) fn write(mut prepared: Prepared<'_>, mut outcome: Outcome) -> Result<Encoded> {
    let stored = prepared.state().options.stored();
    if stored != Metadata::default() {
        outcome.splats.metadata = Metadata { thumbnail: outcome.splats.metadata.thumbnail.take(), ..stored };
        outcome.bytes = prepared.state().file(&outcome.splats)?;
    }
    // Only what the written file leaves out counts, not what discarded tries of a search left out.
    if outcome.pruned_bytes > 0 {
        prepared.state_mut().report.note(SkipReason::Gaussians, outcome.pruned_bytes, 0.0);
    }
    check_metadata(&outcome.splats.metadata)?;
    note_codebook(&mut prepared, &outcome)?;
    let error = prepared.error(&outcome.splats)?;
    prepared.inspect_written(&outcome.splats)?;
    // The error before rounding was measured over the fitted channels. The factor adds the channels that were left out,
    // in the same proportion as in the file.
    let float_error = outcome.float_error * prepared.error_factor(&outcome.splats, error)?;
    let samples = prepared.state().samples();
    let EncodeState { options, device, report, .. } = prepared.state_mut();
    let report = EncodeReport {
        gaussians: outcome.splats.gaussians.len(),
        effort: options.effort,
        psnr: decibels(error, samples),
        float_psnr: decibels(float_error, samples),
        quality: outcome.quality,
        seconds: report.seconds(),
        stages: std::mem::take(&mut report.stages),
        skipped: std::mem::take(&mut report.skipped),
        chosen: device.chosen().clone(),
    };
    Ok(Encoded { bytes: outcome.bytes, report })
}

/// Records the bytes that a codebook saved, compared with a file without it.
fn note_codebook(prepared: &mut Prepared<'_>, outcome: &Outcome) -> Result<()> {
    if outcome.splats.codebook.is_some() {
        let direct = prepared.state().file(&PackedSplats { codebook: None, ..outcome.splats.clone() })?;
        let saved = direct.len().saturating_sub(outcome.bytes.len()) as u64;
        prepared.state_mut().report.note(SkipReason::OwnColors, saved, 0.0);
    }
    Ok(())
}
