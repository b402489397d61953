//! The description of a fit: problem, number of primitives and schedule.

use crate::fit::model::problem::Problem;
use crate::fit::plan::Plan;

/// A fit of about `count` primitives to `problem` with the schedule `plan`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Job<'a> {
    pub problem: Problem<'a>,
    pub count: usize,
    pub plan: &'a Plan,
}
