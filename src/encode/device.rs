//! Chooses the device that fits a picture, records the reason, and runs the fit on it.

use std::fmt;
use std::ops::Range;
use std::sync::OnceLock;

use rand_pcg::Pcg64Mcg;

use super::constant::is_constant;
use super::workers::Executor;
use crate::error::{Error, GpuError, Result};
use crate::fit;
use crate::fit::Fitted;
use crate::fit::engine::Watcher;
use crate::fit::job::Job;
use crate::fit::schedule;
use crate::fit::state::State;
use crate::options::{Backend, EncodeOptions};
use crate::parameter::Parameter;
use crate::pixels::{Depth, Pixels};

use crate::constants::encode;
#[cfg(feature = "gpu")]
use crate::fit::engine::Engine;
#[cfg(feature = "gpu")]
use crate::gpu::{Adapters, Device, Fitter};
/// Builds without the feature `gpu` have no such device.
#[cfg(not(feature = "gpu"))]
type Device = std::convert::Infallible;

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
    chosen: Chosen,
    asked: Backend,
    gpu: Option<Device>,
    /// The CPU, once a GPU that was chosen automatically has failed.
    fallback: OnceLock<Chosen>,
}

impl Choice {
    /// Chooses a device as `options` request.
    ///
    /// # Errors
    /// [`Error::Gpu`] if the GPU is requested and not available. The automatic choice falls back to the CPU.
    pub(super) fn new(options: &EncodeOptions, pixels: &Pixels) -> Result<Self> {
        let area = u64::from(pixels.width()) * u64::from(pixels.height());
        if options.backend == Backend::Auto && area >= encode::MIN_GPU_PIXELS && is_constant(pixels) {
            return Ok(Choice::of((None, Chosen::cpu("the picture has a single colour")), options.backend));
        }
        Choice::for_area(options, area)
    }

    /// Chooses a device for a picture of this size that `executor` fits in tiles.
    ///
    /// # Errors
    /// As [`Choice::new`]. Workers of the caller fit on the CPU, and with them [`Error::Parameter`] if the GPU is
    /// requested.
    pub(super) fn for_tiles(options: &EncodeOptions, size: [u32; 2], executor: &Executor<'_>) -> Result<Self> {
        const BY_WORKERS: &str = "workers fit tiles on the CPU";
        match (executor, options.backend) {
            (Executor::External(_), Backend::Gpu) => {
                Err(Error::Parameter { parameter: Parameter::Backend, problem: BY_WORKERS.into() })
            }
            (Executor::External(_), Backend::Auto) => Ok(Choice::of((None, Chosen::cpu(BY_WORKERS)), options.backend)),
            _ => Choice::for_area(options, size.map(u64::from).iter().product()),
        }
    }

    fn for_area(options: &EncodeOptions, area: u64) -> Result<Self> {
        let opened = match options.backend {
            Backend::Cpu => Ok((None, Chosen::cpu("requested"))),
            Backend::Auto if area < encode::MIN_GPU_PIXELS => {
                Ok((None, Chosen::cpu(format!("the picture has fewer than {} pixels", encode::MIN_GPU_PIXELS))))
            }
            asked => open(asked, options),
        };
        match opened {
            Ok(found) => Ok(Choice::of(found, options.backend)),
            Err(e) if options.backend == Backend::Auto => {
                Ok(Choice::of((None, Chosen::cpu(e.to_string())), options.backend))
            }
            Err(e) => Err(e.into()),
        }
    }

    /// Returns the CPU.
    pub(super) fn cpu() -> Self {
        Choice::of((None, Chosen::default()), Backend::Cpu)
    }

    fn of((gpu, chosen): (Option<Device>, Chosen), asked: Backend) -> Self {
        Choice { chosen, asked, gpu, fallback: OnceLock::new() }
    }

    /// Returns the device that fits.
    pub(super) fn chosen(&self) -> &Chosen {
        self.fallback.get().unwrap_or(&self.chosen)
    }

    fn gpu(&self) -> Option<&Device> {
        self.gpu.as_ref().filter(|_| self.fallback.get().is_none())
    }

    /// Returns why no GPU is used, if the choice was automatic.
    pub(super) fn passed_over(&self) -> Option<String> {
        let is_passed_over = self.asked == Backend::Auto && self.gpu().is_none();
        is_passed_over.then(|| self.chosen().reason.clone())
    }

    /// Runs `work` on the GPU. Returns `None` if it is left to the CPU, also because a GPU that was chosen
    /// automatically fails.
    fn on_gpu<T>(&self, work: impl FnOnce(&Device) -> Result<T>) -> Option<Result<T>> {
        match work(self.gpu()?) {
            Err(Error::Gpu(e)) if self.asked == Backend::Auto => {
                // Of several tiles that fail at the same time, the first one is reported.
                let _ = self.fallback.set(Chosen::cpu(format!("{} failed: {e}", self.chosen.device)));
                None
            }
            result => Some(result),
        }
    }

    /// Runs `job`, whose samples have `depth`, on the chosen device. If a GPU that was chosen automatically fails, the
    /// CPU runs the job again.
    pub(super) fn fit(&self, job: &Job<'_>, depth: Depth, watcher: &mut dyn Watcher) -> Result<Fitted<State>> {
        match self.on_gpu(|device| fit_on(device, job, depth, watcher)) {
            Some(fitted) => fitted,
            None => fit::fit_on_cpu(job, watcher),
        }
    }

    /// Takes the steps `steps` of `job`, whose samples have `depth`, from `state` on, on the chosen device. Several
    /// threads may do so at a time. A GPU that fails is replaced as in [`Choice::fit`].
    pub(super) fn steps(
        &self,
        job: &Job<'_>,
        depth: Depth,
        mut state: State,
        (rng, steps): (Pcg64Mcg, Range<u32>),
        watcher: &mut dyn Watcher,
    ) -> Result<State> {
        let schedule = (rng, steps);
        match self.on_gpu(|device| steps_on(device, job, depth, &state, schedule.clone(), watcher)) {
            Some(state) => state,
            None => {
                schedule::run(job, &mut state, schedule, watcher)?;
                Ok(state)
            }
        }
    }
}

/// Returns whether a GPU would fit a large picture.
pub(super) fn takes_gpu(options: &EncodeOptions) -> bool {
    options.backend != Backend::Cpu && open(options.backend, options).is_ok()
}

#[cfg(feature = "gpu")]
fn open(asked: Backend, options: &EncodeOptions) -> Result<(Option<Device>, Chosen), GpuError> {
    if !options.recipe.is_own() {
        return Err(GpuError::Unsupported { what: "another method of fitting" });
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
fn fit_on(device: &Device, job: &Job<'_>, depth: Depth, watcher: &mut dyn Watcher) -> Result<Fitted<State>> {
    fit::fit(job, |start| Fitter::resuming(device, &job.problem, depth, &start), watcher)?.finished()
}

#[cfg(not(feature = "gpu"))]
fn fit_on(device: &Device, _: &Job<'_>, _: Depth, _: &mut dyn Watcher) -> Result<Fitted<State>> {
    match *device {}
}

#[cfg(feature = "gpu")]
fn steps_on(
    device: &Device,
    job: &Job<'_>,
    depth: Depth,
    state: &State,
    schedule: (Pcg64Mcg, Range<u32>),
    watcher: &mut dyn Watcher,
) -> Result<State> {
    let mut fitter = Fitter::resuming(device, &job.problem, depth, state)?;
    schedule::run(job, &mut fitter, schedule, watcher)?;
    // The best state cannot be kept later, because it is on the device.
    fitter.keep_best()?;
    fitter.finish()
}

#[cfg(not(feature = "gpu"))]
fn steps_on(
    device: &Device,
    _: &Job<'_>,
    _: Depth,
    _: &State,
    _: (Pcg64Mcg, Range<u32>),
    _: &mut dyn Watcher,
) -> Result<State> {
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
            let choice = Choice::of((Some(device.clone()), chosen), asked);
            let fitted = choice.fit(&job, Depth::Eight, &mut Unwatched);
            if asked == Backend::Auto {
                assert_eq!(fitted.unwrap().by.primitives, on_cpu.primitives);
                assert!(
                    choice.chosen().to_string().starts_with("CPU: the GPU failed: device lost"),
                    "{}",
                    choice.chosen()
                );
                assert!(choice.passed_over().is_some());
            } else {
                assert!(matches!(fitted, Err(Error::Gpu(GpuError::Lost { .. }))), "{fitted:?}");
            }
        }
    }
}
