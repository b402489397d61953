//! The interface of other methods of fitting, which the lab compares with that of this crate.

use rand_pcg::Pcg64Mcg;

use crate::error::Result;
use crate::fit::engine::Watcher;
use crate::fit::model::drawing::project::Primitive;
use crate::fit::model::problem::Problem;

/// What another method fits.
#[cfg_attr(not(feature = "unstable"), allow(dead_code, reason = "tools bring other methods"))]
pub struct MethodJob<'a> {
    pub problem: Problem<'a>,
    /// Number of primitives.
    pub count: usize,
    /// Number of steps.
    pub iterations: u32,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Returns the fraction of the time limit that is spent; 0 without a limit.
    pub spent: &'a dyn Fn() -> f32,
}

/// Another method of fitting.
#[cfg_attr(not(feature = "unstable"), allow(dead_code, reason = "tools bring other methods"))]
pub trait FitMethod: std::fmt::Debug + std::panic::RefUnwindSafe + Sync {
    /// Returns the primitives at which its fit starts. The fit goes on with `rng`.
    fn start(&self, job: &MethodJob<'_>, rng: &mut Pcg64Mcg) -> Vec<Primitive>;

    /// Returns the fitted primitives. `watcher` follows the progress, and may correct the number of primitives once.
    ///
    /// # Errors
    /// Returns an error of the watcher.
    fn fit(&self, job: &MethodJob<'_>, watcher: &mut dyn Watcher) -> Result<Vec<Primitive>>;
}
