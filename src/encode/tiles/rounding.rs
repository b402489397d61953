//! From the fitted floats of all tiles to integers of a requested file size.

use super::fit::{FittedTiles, ProgressRange, TiledFit};
use super::grid::{Shift, Window};
use super::mosaic::{Mosaic, Placed, TileResult};
use super::picture::TiledPicture;
use super::task::IntegerWork;
use crate::bitstream::splats::{PackedGaussian, PackedSplats};
use crate::constants::rdo;
use crate::constants::tiles;
use crate::encode::file;
use crate::encode::state::{FitRequest, Outcome};
use crate::error::Result;
use crate::fit::model::drawing::project::Primitive;
use crate::rdo::size::{Correction, Size, correction};
use crate::rdo::size_loop::{IntegerSet, SizeSchedule, bring_to_size, trim};

/// Rounds Gaussians to a file of the requested size without a detail layer.
///
/// # Errors
/// [`Error::TooSmall`](crate::Error::TooSmall) if the file cannot be that small.
pub(in crate::encode) fn quantize<'a>(
    picture: &mut TiledPicture<'a>,
    fitted: FittedTiles<'a>,
    request: &FitRequest,
) -> Result<Outcome> {
    let clock = picture.state.report.seconds();
    let FittedTiles { primitives, error: float_error, grid, global, until } = fitted;
    let fixed = picture.state.fixed()?;
    let mut fit = TiledFit { picture, grid, global, size: request.size, fixed, until };
    let sample = primitives.iter().copied().step_by(primitives.len() / tiles::MAX_SAMPLED_PRIMITIVES + 1);
    let quantizer = fit.set_steps(&sample.collect::<Vec<Primitive>>(), float_error);
    let to_gaussian = |p: &PackedGaussian| quantizer.dequantize(p);
    let mut mosaic = Mosaic::new(&grid, &to_gaussian);
    for p in &primitives {
        mosaic.insert(Placed { primitive: quantizer.quantize(&p.to_gaussian()), cost: 0.0 });
    }
    drop(primitives);
    // The size of a base is not corrected, because the detail layer takes all remaining bytes.
    let (size, limit) = match request.under_layer {
        Some(layer) => (Size::Free, Size::Bytes(layer.max_bytes)),
        None => (request.size, request.size),
    };
    let sweeps = fit.global.plan().sweeps.max(rdo::MIN_SWEEPS);
    let schedule = SizeSchedule { size, sweeps, descends: true, enough: 0.0, deadline: until };
    let progress = ProgressRange { stage: "finish", from: 0.0, to: 0.0 };
    let mut integers = TiledIntegers {
        fit: &mut fit,
        mosaic,
        progress,
        shift: Shift::None,
        candidates: None,
        error: None,
        length: None,
    };
    bring_to_size(&mut integers, schedule)?;
    if let Size::Bytes(max_bytes) = limit {
        let length = integers.bytes()?;
        trim(&mut integers, length, max_bytes)?;
    }
    let (bytes, splats) = integers.write()?;
    picture.state.report.stage("finish", clock);
    match limit {
        Size::Bytes(max_bytes) if bytes.len() as u64 > max_bytes => {
            Err(picture.state.too_small(max_bytes, bytes.len() as u64))
        }
        _ => Ok(Outcome { bytes, splats, float_error, quality: None, pruned_bytes: 0 }),
    }
}

/// The integers of a picture in tiles.
struct TiledIntegers<'f, 'm, 's, 'a, 'g> {
    fit: &'f mut TiledFit<'s, 'a, 'g>,
    mosaic: Mosaic<'m, PackedGaussian>,
    /// The part of the progress that the current round covers.
    progress: ProgressRange,
    /// Position of the tiles in the next sweep.
    shift: Shift,
    /// Candidates that could be added. `None` means that neither they nor the costs in `mosaic` are known.
    candidates: Option<Vec<Placed<PackedGaussian>>>,
    /// The squared error, if it is known.
    error: Option<f64>,
    /// The length of the file, if it is known.
    length: Option<u64>,
}

impl TiledIntegers<'_, '_, '_, '_, '_> {
    /// Writes the file. Returns its bytes and its integers, without the constant channels.
    fn write(&self) -> Result<(Vec<u8>, PackedSplats)> {
        let state = &self.fit.picture.state;
        let mut splats = self.splats();
        let bytes = file::smallest(&mut splats, state.options.levels)?;
        let bytes = if state.fits_all_channels() { bytes } else { state.file(&splats)? };
        Ok((bytes, splats))
    }

    fn splats(&self) -> PackedSplats {
        let gaussians = self.mosaic.all().map(|p| p.primitive).collect();
        PackedSplats { gaussians, ..self.fit.global.blank.clone() }
    }

    /// Runs `work` on all tiles, none of which depends on another. Returns the results.
    fn measure(&mut self, work: IntegerWork) -> Result<Vec<(Window, TileResult<PackedGaussian>)>> {
        let windows = self.fit.grid.windows();
        let progress = ProgressRange { to: self.progress.from, ..self.progress };
        let results = self.fit.turn(progress, &windows, work, &self.mosaic)?;
        Ok(windows.into_iter().zip(results).collect())
    }

    fn total_cost(&self) -> f64 {
        self.mosaic.all().map(|p| f64::from(p.cost)).sum()
    }

    /// Records a change of the primitives.
    fn changed(&mut self, error: Option<f64>) {
        (self.error, self.length) = (error, None);
    }
}

impl<'m> IntegerSet for TiledIntegers<'_, 'm, '_, '_, '_> {
    type Snapshot = Mosaic<'m, PackedGaussian>;

    fn start_round(&mut self, round: u32, rounds: u32) -> Result<()> {
        self.progress = ProgressRange::part("finish", round as usize, rounds as usize);
        Ok(())
    }

    fn is_empty(&self) -> bool {
        self.mosaic.count() == 0
    }

    fn bytes(&mut self) -> Result<u64> {
        let length = match self.length {
            Some(length) => length,
            None => self.write()?.0.len() as u64,
        };
        self.length = Some(length);
        Ok(length)
    }

    /// Returns the error as the last sweep measured it, with the estimated effect of the primitives that were added or
    /// removed since. Measures it before the first sweep.
    fn error(&mut self) -> Result<f64> {
        let error = match self.error {
            Some(error) => error,
            None => self.measure(IntegerWork::Weigh)?.iter().map(|(_, result)| result.error).sum(),
        };
        self.error = Some(error);
        Ok(error)
    }

    /// Sweeps over the tiles of one position, in turns. The positions alternate.
    fn sweep(&mut self, lambda: f64) -> Result<Option<f64>> {
        let before = self.error.zip(self.length);
        let (candidates, error) =
            self.fit.pass((self.progress, self.shift), IntegerWork::Sweep(lambda), &mut self.mosaic)?;
        self.shift = match self.shift {
            Shift::None => Shift::Half,
            Shift::Half => Shift::None,
        };
        // The number of primitives under a detail layer is not corrected, so their costs are not measured.
        self.candidates = (!self.fit.global.settings.is_base).then_some(candidates);
        self.changed(Some(error));
        let length = self.bytes()?;
        // The length of the file is not known between a correction and a sweep.
        Ok(before.map(|(e, l)| e - error + 8.0 * lambda * (l as f64 - length as f64)))
    }

    fn resize(&mut self, bytes: u64, max_bytes: u64) -> Result<()> {
        if self.candidates.is_none() {
            let mut placed = Vec::new();
            let mut candidates = Vec::new();
            for (window, result) in self.measure(IntegerWork::Appraise)? {
                placed.push((window.core, result.own));
                candidates.extend(result.candidates);
            }
            self.mosaic.replace(placed);
            self.candidates = Some(candidates);
        }
        let (count, cost) = (self.mosaic.count(), self.total_cost());
        let wanted = match correction(count, bytes.saturating_sub(self.fit.fixed), bytes, max_bytes) {
            Correction::Remove(cheapest) => count.saturating_sub(cheapest),
            Correction::Add(more) => count + more,
        };
        if let Some(candidates) = &mut self.candidates {
            self.mosaic.balance(candidates, wanted, 0);
        }
        let change = cost - self.total_cost();
        self.changed(self.error.map(|error| (error + change).max(0.0)));
        Ok(())
    }

    fn snapshot(&self) -> Self::Snapshot {
        self.mosaic.clone()
    }

    fn restore(&mut self, snapshot: Self::Snapshot) {
        self.mosaic = snapshot;
        self.candidates = None;
        self.changed(None);
    }
}
