//! A picture that is fitted in tiles: its preparation and its measurements.

use std::ops::ControlFlow;

use super::constant;
use super::floats::OnProgress;
use super::grid::{Grid, UNIT, Window};
use super::narrow::Narrowed;
use crate::bitstream::splats::PackedSplats;
use crate::effort::EffortSettings;
use crate::encode::Progress;
use crate::encode::channels::widen;
use crate::encode::clock::Clock;
use crate::encode::constant::{constant, is_possible};
use crate::encode::device::Choice;
use crate::encode::hidden::InpaintedSource;
use crate::encode::input::{self, may_leave_out};
use crate::encode::render::{decoded_error, drawn_part};
use crate::encode::report::ReportBuilder;
use crate::encode::skipped::SkipReason;
use crate::encode::state::EncodeState;
use crate::encode::workers::Executor;
use crate::error::{Error, Result};
use crate::gaussian::Blend;
use crate::options::{Detail, EncodeOptions};
use crate::parameter::Parameter;
use crate::pixel_source::PixelSource;
use crate::pixels::Depth;
#[cfg(feature = "quality-hook")]
use crate::ssimulacra2::ssimulacra2;
use crate::used_range::UsedRange;

/// A picture that is fitted in tiles.
pub(in crate::encode) struct TiledPicture<'a> {
    pub state: EncodeState<'a>,
    /// The picture with all its channels.
    pub source: &'a dyn PixelSource,
    /// The picture without its constant channels.
    pub fitted_source: &'a dyn PixelSource,
    /// Side of the tiles, pixels.
    pub side: u32,
    /// The tiles. The picture is also measured tile by tile.
    pub(super) windows: Vec<Window>,
    /// The mean colour, if the range of the samples is so narrow that the picture is this colour with a detail layer.
    pub flat_color: Option<[f32; 4]>,
    pub executor: Executor<'a>,
}

/// Prepares the picture of `source` for a fit in tiles of `side` pixels and encodes it by `encode`: continues hidden
/// colours, leaves out constant channels, and chooses the device.
pub(in crate::encode) fn prepare<T>(
    source: &dyn PixelSource,
    options: &EncodeOptions,
    side: u32,
    mut executor: Executor<'_>,
    progress: &mut dyn FnMut(&Progress) -> ControlFlow<()>,
    encode: impl FnOnce(TiledPicture<'_>) -> Result<T>,
) -> Result<T> {
    check(options)?;
    let mut report = ReportBuilder::new(progress, options.inspector);
    let clock = Clock::new(options.time);
    let device = &Choice::for_tiles(options, source.size(), &executor)?;
    let start = report.seconds();
    let inpainted = InpaintedSource::new(source, options.hidden, || report.stage_progress("survey", 0.0))?;
    if inpainted.is_some() {
        report.note(SkipReason::HiddenColors, 0, 0.0);
    }
    let source = inpainted.as_ref().map_or(source, |inpainted| inpainted as &dyn PixelSource);
    let windows = Grid { size: source.size(), half: side / 2, margin: UNIT }.windows();
    let surveyed = if may_leave_out(options) { &windows[..] } else { &[] };
    let (narrowed, left_out) = Narrowed::new(source, surveyed, || report.stage_progress("survey", 0.0))?;
    if let Some(reason) = left_out {
        report.note(reason, 0, 0.0);
    }
    let blend = options.blend.unwrap_or(Blend::Normalized);
    let may_be_flat = is_possible(options, blend) && narrowed.channels().alpha().is_none();
    let range = if may_be_flat && options.detail != Detail::Off {
        narrow_range(&narrowed, &windows, || report.stage_progress("survey", 0.0))?
    } else {
        None
    };
    let flat_color = match range {
        Some(range) => {
            report.note(SkipReason::Contrasts { levels: range.levels() }, 0, 0.0);
            Some(constant::mean(&narrowed, &windows, || report.stage_progress("survey", 0.0))?)
        }
        None => None,
    };
    report.stage("survey", start);
    let blank = input::empty(source.size(), (narrowed.channels(), source.depth()), blend, options);
    let (channels, settings) = (source.channels(), EffortSettings::from_preset(options.effort));
    encode(TiledPicture {
        state: EncodeState { options, settings, channels, blank, clock, device, report, kept: None, base_factor: None },
        source,
        fitted_source: &narrowed,
        side,
        windows,
        flat_color,
        executor: executor.reborrow(),
    })
}

/// Returns the range of the samples of `source` if it is narrow. Reads `tiles`, which together cover the picture, and
/// calls `on_progress` for each of them.
fn narrow_range(
    source: &dyn PixelSource,
    tiles: &[Window],
    mut on_progress: impl FnMut() -> Result<()>,
) -> Result<Option<UsedRange>> {
    let mut range: Option<UsedRange> = None;
    if source.depth() == Depth::Eight {
        return Ok(None);
    }
    for tile in tiles {
        on_progress()?;
        let Some(found) = UsedRange::of(&source.part(tile.core.bounds())?) else { continue };
        range = Some(range.map_or(found, |range| range.and(found)));
        if range.and_then(UsedRange::if_narrow).is_none() {
            return Ok(None);
        }
    }
    Ok(range)
}

/// Returns an error if `options` ask for something that tiles do not support.
pub(in crate::encode) fn check(options: &EncodeOptions) -> Result<()> {
    let bad = |problem: &str| Err(Error::Parameter { parameter: Parameter::Tiles, problem: problem.into() });
    match options {
        o if !o.recipe.is_own() => bad("another method cannot fit in tiles"),
        _ => Ok(()),
    }
}

impl TiledPicture<'_> {
    /// Returns the integers of the picture if it has only one colour.
    pub(in crate::encode) fn constant(&mut self) -> Result<Option<PackedSplats>> {
        let report = &mut self.state.report;
        let color = constant::color(self.fitted_source, &self.windows, |done| report.stage_progress("survey", done))?;
        Ok(color.map(|color| self.of_color(color)))
    }

    /// Returns the integers of the mean colour of a picture whose samples have a narrow range.
    ///
    /// # Panics
    /// Panics if the range is not narrow.
    pub(in crate::encode) fn flat(&self) -> PackedSplats {
        self.of_color(self.flat_color.expect("the range of the samples is narrow"))
    }

    fn of_color(&self, color: [f32; 4]) -> PackedSplats {
        let mut splats = self.state.blank.clone();
        constant(&mut splats, color);
        splats
    }

    /// Returns the squared error of the decoded picture over the samples of `source`: the caller's picture, or that with
    /// the fitted channels.
    pub(in crate::encode) fn decoded_error(&mut self, source: &dyn PixelSource, splats: &PackedSplats) -> Result<f64> {
        let report = &mut self.state.report;
        let clock = report.seconds();
        let on_progress = &mut |done| report.stage_progress("measure", done);
        let wide = (splats.channels != source.channels()).then(|| widen(splats, source.channels()));
        let error = squared_error(source, &self.windows, wide.as_ref().unwrap_or(splats), on_progress)?;
        report.stage("measure", clock);
        Ok(error)
    }

    /// Scores large pictures tile by tile. Returns the mean of the scores, weighted by the number of pixels.
    #[cfg(feature = "quality-hook")]
    pub(in crate::encode) fn score(&mut self, splats: &PackedSplats) -> Result<f64> {
        let wide = self.state.widened(splats);
        let (mut sum, mut area) = (0.0, 0.0);
        for (i, window) in self.windows.iter().enumerate() {
            self.state.report.stage_progress("measure", i as f32 / self.windows.len() as f32)?;
            let core = &window.core;
            let drawn = drawn_part(&wide, core.bounds(), wide.depth)?;
            let score = ssimulacra2(&self.source.part(core.bounds())?, &drawn)?;
            (sum, area) = (sum + score * core.pixels(), area + core.pixels());
        }
        Ok(sum / area)
    }
}

/// Returns the squared error between a picture that is read in parts and the decoded picture, weighted as
/// [`metrics::psnr`](crate::metrics::psnr) does.
fn squared_error(
    source: &dyn PixelSource,
    parts: &[Window],
    splats: &PackedSplats,
    on_progress: OnProgress<'_>,
) -> Result<f64> {
    let mut error = 0.0;
    for (i, part) in parts.iter().enumerate() {
        on_progress(i as f32 / parts.len() as f32)?;
        let area = part.core.bounds();
        error += decoded_error(&source.part(area)?, &drawn_part(splats, area, splats.depth)?);
    }
    Ok(error)
}
