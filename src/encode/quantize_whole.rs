//! Rounds the Gaussians of a whole picture to the integers of a file.

use super::fit_whole::FittedWhole;
use super::input::widened_file;
use super::report::Stage;
use super::state::{EncodeState, FitRequest, Outcome};
use super::whole::WholePicture;
use super::{constant, file, prune};
use crate::bitstream::coder::expect::PredictedCost;
use crate::bitstream::splats::PackedSplats;
use crate::error::Result;
use crate::fit::engine::Snapshot;
use crate::fit::model::problem::Problem;
use crate::gaussian::Channels;
use crate::options::Needs;
use crate::rdo::finish::{self, Client, Rounding};
use crate::rdo::rounded::Rounded;
use crate::rdo::size::Size;
use crate::target::Target;

/// Rounds Gaussians to a file of the requested size without a detail layer, and removes those that it does not need.
///
/// # Errors
/// [`Error::TooSmall`](crate::Error::TooSmall) if the file cannot be that small.
pub(super) fn quantize(picture: &mut WholePicture<'_>, fitted: FittedWhole, request: &FitRequest) -> Result<Outcome> {
    let mut outcome = rounded(picture, fitted, request)?;
    if request.under_layer.is_some() && !picture.state.settings.fit.base.is_checked {
        return Ok(outcome);
    }
    if picture.state.options.needs == Needs::Measured {
        let max_error = picture.input.pixels.depth().rounding_error() * picture.state.fitted_samples();
        prune::prune(picture, &mut outcome, max_error)?;
    }
    prefer_one_color(picture, &mut outcome, request.size)?;
    // The size loop exceeds the size only if a file without primitives does.
    match request.size.exceeded_by(&outcome.bytes) {
        over @ 1.. if request.under_layer.is_none() => {
            let needed = outcome.bytes.len() as u64;
            Err(picture.state.too_small(needed - over, needed))
        }
        _ => Ok(outcome),
    }
}

/// Rounds Gaussians to a file of the requested size.
fn rounded(picture: &mut WholePicture<'_>, fitted: FittedWhole, request: &FitRequest) -> Result<Outcome> {
    let FittedWhole { state, plan, scene } = fitted;
    let WholePicture { state: encode, input, planes, .. } = picture;
    let EncodeState { options, channels, report, blank, .. } = encode;
    let clock = report.seconds();
    let stage = Stage { name: "finish", report: &mut *report, input: *input, planes };
    let mut writer = FileWriter { stage, splats: blank.clone(), channels: *channels, levels: options.levels };
    // Under a detail layer, the bytes of the Gaussians are not limited: the layer uses the bytes that remain.
    let size = if request.under_layer.is_some() { Size::Free } else { request.size };
    let problem = Problem { scene, target: planes };
    let rounding = Rounding { problem, layout: options.layout, size, plan: &plan };
    let mut finished = finish::finish(&rounding, state, &mut writer)?;
    let bytes = writer.write(&mut finished.rounded)?;
    let FileWriter { mut splats, .. } = writer;
    splats.gaussians = finished.rounded.gaussians;
    report.stage("finish", clock);
    Ok(Outcome { bytes, splats, float_error: finished.float_error, quality: None, pruned_bytes: 0 })
}

/// Replaces the integers with a single colour, with or without a Gaussian, if that is closer to the picture.
fn prefer_one_color(picture: &WholePicture<'_>, outcome: &mut Outcome, size: Size) -> Result<()> {
    let background =
        PackedSplats { gaussians: Vec::new(), codebook: None, levels: Vec::new(), ..outcome.splats.clone() };
    let options = picture.state.options;
    let may_be_flat =
        constant::is_possible(options, picture.state.blank.blend) && !matches!(options.target, Target::Gaussians(_));
    let flat = may_be_flat.then(|| picture.flat());
    let mut error = picture.error_of(&outcome.splats);
    for single in [Some(background), flat].into_iter().flatten() {
        let (bytes, single_error) = (picture.state.file(&single)?, picture.error_of(&single));
        if (error.is_nan() || error > single_error) && size.exceeded_by(&bytes) == 0 {
            error = single_error;
            (outcome.bytes, outcome.splats, outcome.pruned_bytes) = (bytes, single, 0);
        }
    }
    Ok(())
}

/// Writes the file for which the primitives are rounded.
struct FileWriter<'a, 'b> {
    stage: Stage<'a, 'b>,
    /// The integers, without the channels that were left out.
    splats: PackedSplats,
    /// The channels of the file.
    channels: Channels,
    levels: u8,
}

impl Client for FileWriter<'_, '_> {
    fn step(&mut self, done: f32, now: &mut dyn Snapshot) -> Result<()> {
        self.stage.step(done, now)
    }

    fn bytes(&mut self, rounded: &mut Rounded) -> Result<u64> {
        Ok(self.write(rounded)?.len() as u64)
    }

    fn expected(&mut self, rounded: &mut Rounded) -> Result<Vec<PredictedCost>> {
        self.with(rounded, file::expected)
    }
}

impl FileWriter<'_, '_> {
    /// Writes the file and sorts the primitives into its order.
    fn write(&mut self, rounded: &mut Rounded) -> Result<Vec<u8>> {
        let channels = self.channels;
        self.with(rounded, |splats, levels| match file::smallest(splats, levels) {
            Ok(_) if splats.channels != channels => widened_file(splats, channels),
            bytes => bytes,
        })
    }

    /// Calls `look` with the integers of the file and its number of levels.
    fn with<T>(&mut self, rounded: &mut Rounded, look: impl FnOnce(&mut PackedSplats, u8) -> T) -> T {
        let splats = &mut self.splats;
        (splats.steps, splats.background) = (rounded.steps, rounded.background);
        std::mem::swap(&mut splats.gaussians, &mut rounded.gaussians);
        let seen = look(splats, self.levels);
        std::mem::swap(&mut splats.gaussians, &mut rounded.gaussians);
        seen
    }
}
