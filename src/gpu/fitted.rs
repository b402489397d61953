//! Fits pixels on a device and returns a picture in floats, without a file.

use std::fmt;
use std::ops::ControlFlow;
use std::time::Instant;

use super::device::Device;
use super::fit::Fitter;
use crate::depth::Depth;
use crate::error::{Error, Result};
use crate::fit;
use crate::fit::engine::{Engine, Snapshot, Watcher};
use crate::fit::job::Job;
use crate::fit::model::drawing::project::Primitive;
use crate::fit::model::objective::planes::Planes;
use crate::fit::model::objective::rows::RowSet;
use crate::fit::model::problem::{Problem, Scene};
use crate::fit::plan::Plan;
use crate::fit::state::State;
use crate::gaussian::{Blend, Gaussians};
use crate::pixels::Pixels;

/// Result of a fit.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Fitted {
    /// The picture, before any quantization.
    pub picture: Gaussians,
    /// PSNR of its clamped values against the pixels, dB.
    pub psnr: f64,
    /// Seconds before the first step: initialization on the CPU, and copying the data to the device.
    pub setup_seconds: f64,
    /// Seconds of the steps, including relocation but not measurements. Fits of few primitives begin with several
    /// starts on the CPU, whose steps count.
    pub seconds: f64,
    /// Rows of the target per slab, sampled rows per band, and capacity of a band's lists in pairs.
    pub bands: [u32; 3],
}

/// Access to a running fit.
pub struct Look<'a> {
    now: &'a mut dyn Snapshot,
    samples: f64,
    start: Instant,
    /// Seconds spent in measurements.
    looked: &'a mut f64,
    step: u32,
}

impl fmt::Debug for Look<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Look").field("step", &self.step).field("looked", &self.looked).finish_non_exhaustive()
    }
}

impl Look<'_> {
    /// Returns the number of steps so far, including those of the starts on the CPU. A few of them may not have been
    /// submitted yet.
    #[must_use]
    pub fn step(&self) -> u32 {
        self.step
    }

    /// Waits for all steps so far. Returns the PSNR of the clamped picture over all rows, dB, and the seconds that the
    /// steps took, without measurements.
    ///
    /// # Errors
    /// [`Error::Gpu`] if the device fails.
    pub fn psnr(&mut self) -> Result<(f64, f64)> {
        self.now.settle()?;
        let clock = Instant::now();
        let seconds = (clock - self.start).as_secs_f64() - *self.looked;
        let psnr = -10.0 * (self.now.error()? / self.samples).log10();
        *self.looked += clock.elapsed().as_secs_f64();
        Ok((psnr, seconds))
    }
}

/// Calls the caller's closure before each step.
struct Looking<'a> {
    look: &'a mut dyn FnMut(&mut Look<'_>) -> Result<ControlFlow<()>>,
    samples: f64,
    /// Start time of the first step.
    start: Option<Instant>,
    looked: f64,
    step: u32,
}

impl Watcher for Looking<'_> {
    fn step(&mut self, _: f32, now: &mut dyn Snapshot) -> Result<()> {
        let start = *self.start.get_or_insert_with(Instant::now);
        let mut at = Look { now, samples: self.samples, start, looked: &mut self.looked, step: self.step };
        let goes_on = (self.look)(&mut at)?;
        self.step += 1;
        if goes_on.is_break() { Err(Error::Cancelled) } else { Ok(()) }
    }

    fn recount(&mut self, primitives: &[Primitive]) -> Result<usize> {
        Ok(primitives.len())
    }
}

/// Fits `count` primitives to `pixels` in `steps` steps, with the same recipe as the encoder.
///
/// `look` is called before each step. The same arguments give the same bits on the same device.
///
/// # Errors
/// [`Error::Gpu`] if the device fails or does not have enough memory for the picture, [`Error::Cancelled`] if `look`
/// breaks, and the errors of `look`.
pub fn fit(
    device: &Device,
    pixels: &Pixels,
    blend: Blend,
    count: u32,
    steps: u32,
    seed: u64,
    look: &mut dyn FnMut(&mut Look<'_>) -> Result<ControlFlow<()>>,
) -> Result<Fitted> {
    let clock = Instant::now();
    let target = Planes::new(pixels);
    let scene = Scene { width: pixels.width(), height: pixels.height(), blend, background: target.mean };
    let problem = Problem { scene, target: &target };
    let samples = problem.samples(RowSet::ALL);
    let plan = Plan::steps(steps, seed);
    let mut looking = Looking { look, samples, start: None, looked: 0.0, step: 0 };
    let open = |start: State| {
        let mut fitter = Fitter::resuming(device, &problem, pixels.depth(), &start)?;
        // Copying to the device counts as setup, not as part of the first step.
        fitter.settle()?;
        Ok(fitter)
    };
    let fitted = fit::fit(&Job { problem, count: count as usize, plan: &plan }, open, &mut looking)?;
    let mut fitter = fitted.by;
    fitter.settle()?;
    let end = Instant::now();
    let start = looking.start.unwrap_or(end);
    let (setup_seconds, seconds) = ((start - clock).as_secs_f64(), (end - start).as_secs_f64() - looking.looked);
    let psnr = -10.0 * (fitter.error(&problem)? / samples).log10();
    let bands = fitter.sizes();
    let gaussians = fitter.primitives()?.into_iter().map(Primitive::to_gaussian).collect();
    let picture = Gaussians {
        width: scene.width,
        height: scene.height,
        channels: pixels.channels(),
        depth: Depth::Eight,
        blend,
        background: scene.background,
        list: gaussians,
    };
    Ok(Fitted { picture, psnr, setup_seconds, seconds, bands })
}
