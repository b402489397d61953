//! Chooses the device that fits a picture, records the reason, and runs the fit on it.

use std::fmt;

use super::constant::is_constant;
use crate::error::{Error, GpuError, Result};
use crate::fit;
use crate::fit::Fitted;
use crate::fit::engine::Watcher;
use crate::fit::job::Job;
use crate::fit::state::State;
use crate::options::{Backend, EncodeOptions};
use crate::pixels::Pixels;

#[cfg(feature = "gpu")]
use crate::gpu::{Adapters, Device, Fitter};
#[cfg(feature = "gpu")]
use crate::options::Recipe;
/// Builds without the feature `gpu` have no such device.
#[cfg(not(feature = "gpu"))]
type Device = std::convert::Infallible;

/// Minimum number of pixels that [`Backend::Auto`] fits on a GPU. For smaller pictures, starting a GPU would take too
/// much of the time.
const MIN_GPU_PIXELS: u64 = 1 << 18;

/// The device that fitted a picture.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct Chosen {
    /// [`Backend::Cpu`] or [`Backend::Gpu`].
    pub backend: Backend,
    /// The name of the device. On a GPU, the name of the adapter.
    pub device: String,
    /// Reason for the choice.
    pub reason: String,
}

impl Chosen {
    /// Returns the CPU, which always fits tiles.
    pub(super) fn for_tiles(asked: Backend) -> Self {
        Chosen::cpu(if asked == Backend::Cpu { "requested" } else { "tiles are fitted on the CPU" })
    }
}

impl Default for Chosen {
    fn default() -> Self {
        Chosen::cpu("requested")
    }
}

impl fmt::Display for Chosen {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.device, self.reason)
    }
}

impl Chosen {
    fn cpu(reason: impl Into<String>) -> Self {
        Chosen { backend: Backend::Cpu, device: "CPU".to_owned(), reason: reason.into() }
    }
}

/// The device chosen for an encode.
#[derive(Debug)]
pub(super) struct Choice {
    pub chosen: Chosen,
    asked: Backend,
    gpu: Option<Device>,
}

impl Choice {
    /// Chooses a device as `options` request.
    ///
    /// # Errors
    /// [`Error::Gpu`] if the GPU is requested and not available. The automatic choice falls back to the CPU.
    pub(super) fn new(options: &EncodeOptions, pixels: &Pixels) -> Result<Self> {
        let area = u64::from(pixels.width()) * u64::from(pixels.height());
        let opened = match options.backend {
            Backend::Cpu => Ok((None, Chosen::cpu("requested"))),
            Backend::Auto if area < MIN_GPU_PIXELS => {
                Ok((None, Chosen::cpu(format!("the picture has fewer than {MIN_GPU_PIXELS} pixels"))))
            }
            Backend::Auto if is_constant(pixels) => Ok((None, Chosen::cpu("the picture has a single colour"))),
            asked => open(asked, options),
        };
        let (gpu, chosen) = match opened {
            Ok(found) => found,
            Err(e) if options.backend == Backend::Auto => (None, Chosen::cpu(e.to_string())),
            Err(e) => return Err(e.into()),
        };
        Ok(Choice { chosen, asked: options.backend, gpu })
    }

    /// Returns why no GPU is used, if the choice was automatic.
    pub(super) fn passed_over(&self) -> Option<String> {
        let is_passed_over = self.asked == Backend::Auto && self.gpu.is_none();
        is_passed_over.then(|| self.chosen.reason.clone())
    }

    /// Runs `job`, whose picture is `pixels`, on the chosen device. If a GPU that was chosen automatically fails, the
    /// CPU runs the job again.
    pub(super) fn fit(&mut self, job: &Job<'_>, pixels: &Pixels, watcher: &mut dyn Watcher) -> Result<Fitted<State>> {
        if let Some(device) = &self.gpu {
            match fit_on(device, job, pixels, watcher) {
                Err(Error::Gpu(e)) if self.asked == Backend::Auto => {
                    self.chosen = Chosen::cpu(format!("{} failed: {e}", self.chosen.device));
                    self.gpu = None;
                }
                fitted => return fitted,
            }
        }
        fit::fit_on_cpu(job, watcher)
    }
}

/// Returns whether a GPU would fit a large picture.
pub(super) fn takes_gpu(options: &EncodeOptions) -> bool {
    options.backend != Backend::Cpu && open(options.backend, options).is_ok()
}

#[cfg(feature = "gpu")]
fn open(asked: Backend, options: &EncodeOptions) -> Result<(Option<Device>, Chosen), GpuError> {
    if options.recipe != Recipe::Ssplat {
        return Err(GpuError::Unsupported { what: "the recipe smartsplat" });
    }
    // A caller that requests the GPU explicitly may want a software adapter.
    let adapters = if asked == Backend::Gpu { Adapters::Any } else { Adapters::Hardware };
    let device = Device::open(adapters).map_err(|e| match e {
        Error::Gpu(e) => e,
        e => GpuError::Refused { problem: e.to_string() },
    })?;
    let why = if asked == Backend::Gpu { "requested, " } else { "" };
    let reason = format!("{why}{}", device.reason());
    let chosen = Chosen { backend: Backend::Gpu, device: device.name().to_owned(), reason };
    Ok((Some(device), chosen))
}

#[cfg(not(feature = "gpu"))]
fn open(_: Backend, _: &EncodeOptions) -> Result<(Option<Device>, Chosen), GpuError> {
    Err(GpuError::NotBuilt)
}

#[cfg(feature = "gpu")]
fn fit_on(device: &Device, job: &Job<'_>, pixels: &Pixels, watcher: &mut dyn Watcher) -> Result<Fitted<State>> {
    let open = |start: State| Fitter::new(device, &job.problem, pixels, &start.primitives, &start.bounds);
    fit::fit(job, open, watcher)?.finished()
}

#[cfg(not(feature = "gpu"))]
fn fit_on(device: &Device, _: &Job<'_>, _: &Pixels, _: &mut dyn Watcher) -> Result<Fitted<State>> {
    match *device {}
}

#[cfg(all(test, feature = "gpu"))]
mod gpu_tests {
    use super::*;
    use crate::fit::engine::Unwatched;
    use crate::fit::model::objective::planes::Planes;
    use crate::fit::model::problem::{Problem, Scene};
    use crate::fit::plan::Plan;
    use crate::gaussian::{Blend, Channels};
    use crate::pixels::Samples;

    #[test]
    fn auto_falls_back_to_the_cpu_and_reports_it_if_the_gpu_is_lost() {
        let Some(device) = crate::gpu::tests::own_device() else { return };
        let samples = (0..40 * 30 * 3).map(|i| (i * 7 % 251) as u8).collect();
        let pixels = Pixels::new(40, 30, Channels::Rgb, Samples::U8(samples)).unwrap();
        let target = Planes::new(&pixels);
        let scene = Scene { width: 40, height: 30, blend: Blend::Normalized, background: target.mean };
        let plan = Plan::steps(20, 0);
        let job = Job { problem: Problem { scene, target: &target }, count: 30, plan: &plan };
        let on_cpu = fit::fit_on_cpu(&job, &mut Unwatched).unwrap().by;
        device.wgpu().0.destroy();
        for asked in [Backend::Auto, Backend::Gpu] {
            let chosen = Chosen { backend: Backend::Gpu, device: "the GPU".to_owned(), reason: String::new() };
            let mut choice = Choice { chosen, asked, gpu: Some(device.clone()) };
            let fitted = choice.fit(&job, &pixels, &mut Unwatched);
            if asked == Backend::Auto {
                assert_eq!(fitted.unwrap().by.primitives, on_cpu.primitives);
                assert!(choice.chosen.to_string().starts_with("CPU: the GPU failed: device lost"), "{}", choice.chosen);
                assert!(choice.passed_over().is_some());
            } else {
                assert!(matches!(fitted, Err(Error::Gpu(GpuError::Lost { .. }))), "{fitted:?}");
            }
        }
    }
}
