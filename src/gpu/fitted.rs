//! A fit without a file: pixels to a picture in floats, on a device.

use std::ops::ControlFlow;
use std::time::Instant;

use super::device::Device;
use super::fit::Fitter;
use crate::error::{Error, Result};
use crate::fit::model::field::Scene;
use crate::fit::model::planes::Target;
use crate::fit::model::project::Primitive;
use crate::fit::plan::Plan;
use crate::gaussian::{Blend, Picture};
use crate::pixels::Pixels;

/// What a fit came to.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Fitted {
    /// The picture, before any quantization.
    pub picture: Picture,
    /// PSNR of its clamped values against the pixels, dB.
    pub psnr: f64,
    /// Seconds before the first step: the start on the CPU, and bringing everything to the device.
    pub setup_seconds: f64,
    /// Seconds of the steps, relocation included, looks not.
    pub seconds: f64,
    /// Rows of the target that are bound at a time, sampled rows of a band, and pairs that a band's lists hold.
    pub bands: [u32; 3],
}

/// A fit on its way.
#[derive(Debug)]
pub struct Look<'a> {
    fitter: &'a Fitter,
    scene: &'a Scene,
    samples: f64,
    start: Instant,
    /// Seconds that looks took.
    looked: f64,
    step: u32,
}

impl Look<'_> {
    /// Steps asked for so far; a few of them may not be taken yet.
    #[must_use]
    pub fn step(&self) -> u32 {
        self.step
    }

    /// Waits for all steps asked for; returns the PSNR of the clamped picture over all rows, dB, and the seconds that
    /// the steps took so far, looks not counted.
    ///
    /// # Errors
    /// [`Error::Gpu`] when the device fails.
    pub fn psnr(&mut self) -> Result<(f64, f64)> {
        self.fitter.settle()?;
        let clock = Instant::now();
        let seconds = (clock - self.start).as_secs_f64() - self.looked;
        let psnr = -10.0 * (self.fitter.error(self.scene)? / self.samples).log10();
        self.looked += clock.elapsed().as_secs_f64();
        Ok((psnr, seconds))
    }
}

/// Fits `count` primitives to `pixels` in `steps` steps of the recipe that [`encode`](crate::encode()) follows.
///
/// `look` is called before each step. The same arguments give the same bits on the same device.
///
/// # Errors
/// [`Error::Gpu`] when the device fails or cannot hold the picture, [`Error::Cancelled`] when `look` breaks, and the
/// errors of `look`.
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
    let target = Target::new(pixels);
    let scene = Scene { width: pixels.width(), height: pixels.height(), blend, background: target.mean };
    let plan = Plan::steps(steps, seed);
    let (state, rng) = crate::fit::start(&target, count as usize, &plan);
    let fitter = Fitter::new(device, &scene, pixels, &state.primitives, &state.bounds)?;
    device.wait()?;
    let setup_seconds = clock.elapsed().as_secs_f64();
    let samples = f64::from(scene.width) * f64::from(scene.height) * pixels.channels().count() as f64;
    let mut at = Look { fitter: &fitter, scene: &scene, samples, start: Instant::now(), looked: 0.0, step: 0 };
    crate::fit::run(&scene, &target, &mut &fitter, rng, &plan, 0, &mut |_| Ok(count as usize), &mut |_, _| {
        let goes_on = look(&mut at)?;
        at.step += 1;
        if goes_on.is_break() { Err(Error::Cancelled) } else { Ok(()) }
    })?;
    fitter.keep_best()?;
    let (psnr, seconds) = at.psnr()?;
    let bands = fitter.bands();
    let gaussians = fitter.finish()?.into_iter().map(Primitive::to_gaussian).collect();
    let picture = Picture {
        width: scene.width,
        height: scene.height,
        channels: pixels.channels(),
        blend,
        background: scene.background,
        gaussians,
    };
    Ok(Fitted { picture, psnr, setup_seconds, seconds, bands })
}
