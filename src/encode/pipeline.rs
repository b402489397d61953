//! From a session to the file and its report.

use super::drawn::check_metadata;
use super::session::{EncodeSession, Outcome, decibels};
use super::skipped::SkipReason;
use super::{EncodeReport, Encoded, rate_control};
use crate::bitstream::splats::{Metadata, PackedSplats};
use crate::error::Result;

/// Encodes as the options request, and reports the result.
pub(super) fn run<'a, S: EncodeSession<'a>>(mut session: S) -> Result<Encoded> {
    let mut outcome = rate_control::to_target(&mut session)?;
    let stored = session.options().stored();
    if stored != Metadata::default() {
        outcome.splats.metadata = Metadata { thumbnail: outcome.splats.metadata.thumbnail.take(), ..stored };
        outcome.bytes = session.file(&outcome.splats)?;
    }
    // Only what the written file leaves out counts, not what discarded tries of a search left out.
    if outcome.pruned_bytes > 0 {
        session.report().note(SkipReason::Primitives, outcome.pruned_bytes, 0.0);
    }
    check_metadata(&outcome.splats.metadata)?;
    note_codebook(&mut session, &outcome)?;
    let error = session.error(&outcome.splats)?;
    session.trace_end(&outcome.splats, error)?;
    // The error before rounding was measured over the fitted channels. The factor adds the channels that were left out,
    // in the same proportion as in the file.
    let weight = if session.fits_all_channels() { 1.0 } else { error / session.fitted_error(&outcome.splats)? };
    let float_error = outcome.float_error * if weight.is_finite() { weight } else { 1.0 };
    let (samples, chosen, effort) = (session.samples(), session.chosen(), session.options().effort);
    let report = session.report();
    let report = EncodeReport {
        primitives: outcome.splats.gaussians.len(),
        effort,
        psnr: decibels(error, samples),
        float_psnr: decibels(float_error, samples),
        quality: outcome.quality,
        seconds: report.seconds(),
        stages: std::mem::take(&mut report.stages),
        skipped: std::mem::take(&mut report.skipped),
        chosen,
        trace: report.tracer.take_points(),
    };
    Ok(Encoded { bytes: outcome.bytes, report })
}

/// Records the bytes that a codebook saved, compared with a file without it.
fn note_codebook<'a, S: EncodeSession<'a>>(session: &mut S, outcome: &Outcome) -> Result<()> {
    if outcome.splats.codebook.is_some() {
        let direct = session.file(&PackedSplats { codebook: None, ..outcome.splats.clone() })?;
        let saved = direct.len().saturating_sub(outcome.bytes.len()) as u64;
        session.report().note(SkipReason::OwnColors, saved, 0.0);
    }
    Ok(())
}
