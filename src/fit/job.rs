//! The job of a fit.

use crate::fit::model::problem::Problem;
use crate::fit::plan::Plan;

/// A problem to solve with about `count` primitives and as much work as `plan` spends.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Job<'a> {
    pub problem: Problem<'a>,
    pub count: usize,
    pub plan: &'a Plan,
}
