//! Fits Gaussians to a picture and rounds them to the integers of a file.

use super::prepared::Prepared;
use super::primitive_count::count_for;
use super::state::{EncodeState, FitRequest, Outcome};
use super::tiles::fit::FittedTiles;
use super::whole::WholePicture;
use super::{fit_whole, quantize_whole, tiles};
use crate::error::Result;
use crate::rdo::size::Size;

/// Gaussians before rounding.
pub(super) enum Fitted<'a> {
    Whole(fit_whole::FittedWhole),
    Tiled(FittedTiles<'a>),
}

/// Fits Gaussians to a picture.
///
/// # Errors
/// [`Error::TooSmall`](crate::Error::TooSmall) if a file of the requested size cannot hold any,
/// [`Error::Cancelled`](crate::Error::Cancelled) if the caller cancels, and the errors of the device.
pub(super) fn fit<'a>(prepared: &mut Prepared<'a>, request: &FitRequest) -> Result<Fitted<'a>> {
    let count = count_of(request, prepared.state())?;
    match prepared {
        Prepared::Whole(picture) => fit_whole::fit(picture, count, request).map(Fitted::Whole),
        Prepared::Tiled(picture) => tiles::fit::fit(picture, count, request).map(Fitted::Tiled),
    }
}

/// Rounds fitted Gaussians to a file of the requested size without a detail layer.
///
/// # Errors
/// As [`fit`].
///
/// # Panics
/// Panics if `fitted` is not of this picture.
pub(super) fn quantize<'a>(prepared: &mut Prepared<'a>, fitted: Fitted<'a>, request: &FitRequest) -> Result<Outcome> {
    match (prepared, fitted) {
        (Prepared::Whole(picture), Fitted::Whole(fitted)) => quantize_whole::quantize(picture, fitted, request),
        (Prepared::Tiled(picture), Fitted::Tiled(fitted)) => tiles::quantize(picture, fitted, request),
        _ => panic!("the Gaussians belong to another picture"),
    }
}

/// Fits Gaussians to a picture and rounds them.
///
/// # Errors
/// As [`fit`].
pub(super) fn encode(prepared: &mut Prepared<'_>, request: &FitRequest) -> Result<Outcome> {
    let fitted = fit(prepared, request)?;
    quantize(prepared, fitted, request)
}

/// Fits Gaussians to a whole picture and rounds them.
///
/// # Errors
/// As [`fit`].
pub(super) fn of_whole(picture: &mut WholePicture<'_>, request: &FitRequest) -> Result<Outcome> {
    let count = count_of(request, &picture.state)?;
    let fitted = fit_whole::fit(picture, count, request)?;
    quantize_whole::quantize(picture, fitted, request)
}

/// Returns the initial number of primitives of a fit.
fn count_of(request: &FitRequest, state: &EncodeState<'_>) -> Result<usize> {
    match (request.count, request.size) {
        (Some(count), _) => Ok(count),
        (None, Size::Bytes(max_bytes)) => count_for(state.options, max_bytes, state.fixed()?, state.samples()),
        (None, Size::Free) => Ok(0),
    }
}
