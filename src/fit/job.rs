//! The description of a fit: problem, number of primitives and schedule.

use crate::fit::method::MethodJob;
use crate::fit::model::problem::Problem;
use crate::fit::plan::Plan;
use crate::instant::Instant;

/// A fit of about `count` primitives to `problem` with the schedule `plan`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Job<'a> {
    pub problem: Problem<'a>,
    pub count: usize,
    pub plan: &'a Plan,
}

impl Job<'_> {
    /// Calls `run` with this job as another method sees it.
    pub(crate) fn given_to<T>(&self, run: impl FnOnce(&MethodJob<'_>) -> T) -> T {
        let Job { problem, count, plan } = *self;
        let start = Instant::now();
        let spent = || plan.spent(start);
        run(&MethodJob { problem, count, iterations: plan.iterations, seed: plan.seed, spent: &spent })
    }
}
