//! A complete short fit before the long one. It shows what the picture will lack while there is still time to act on
//! it.
//!
//! Only a fit whose steps have become small can show that: in the middle of a fit, the noise of long steps hides it.
//! The long fit continues from the end of the short one and takes correspondingly fewer steps, so no work is lost.

use crate::constants::fit;
use crate::error::Result;
use crate::fit::engine::{Ending, Engine, Snapshot, Watcher};
use crate::fit::job::Job;
use crate::fit::model::drawing::field::{Field, Output};
use crate::fit::model::drawing::project::{self, Primitive};
use crate::fit::model::objective::planes::Planes;
use crate::fit::model::objective::reweigh;
use crate::fit::model::objective::rows::RowSet;
use crate::fit::multi_start;
use crate::fit::plan::Plan;
use crate::fit::schedule;

/// The result of a probe fit.
pub(super) enum ProbeOutcome {
    /// The reweighted target, and the number of steps taken.
    Reweighted { target: Planes, steps: u32 },
    /// The fit is complete.
    Ended(Ending),
}

/// Runs the short fit and reweights the pixels.
pub(super) fn probe<E: Engine>(job: &Job<'_>, engine: &mut E, watcher: &mut dyn Watcher) -> Result<ProbeOutcome> {
    let all = job.plan.iterations;
    let plan = job.plan.part(fit::PROBE_SHARE);
    let steps = plan.iterations;
    let rng = multi_start::random(&Plan { seed: plan.seed.wrapping_add(1), ..plan.clone() });
    let ending = schedule::run(&Job { plan: &plan, ..*job }, engine, (rng, 0..steps), &mut ProbeWatcher { watcher })?;
    if let Ending::Enough { left } = ending {
        return Ok(ProbeOutcome::Ended(Ending::Enough { left: left + all - steps }));
    }
    let problem = job.problem;
    let primitives = engine.primitives()?;
    let mut field = Field::default();
    field.draw(&problem, &project::all(&primitives, problem.scene.height), RowSet::ALL, Output::Picture);
    let amplitude = reweigh::amplitudes(problem.target, &field, primitives.len());
    Ok(ProbeOutcome::Reweighted { target: problem.target.weighed(amplitude), steps })
}

/// Maps the progress of the short fit to the progress of the whole fit.
struct ProbeWatcher<'a> {
    watcher: &'a mut dyn Watcher,
}

impl Watcher for ProbeWatcher<'_> {
    fn step(&mut self, done: f32, now: &mut dyn Snapshot) -> Result<()> {
        self.watcher.step(fit::PROBE_SHARE * done, now)
    }

    fn recount(&mut self, primitives: &[Primitive]) -> Result<usize> {
        self.watcher.recount(primitives)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::fit_on_cpu;
    use crate::fit::model::objective::masking;
    use crate::fit::model::problem::{Problem, Scene};
    use crate::gaussian::{Blend, Channels};
    use crate::{Pixels, Samples};

    /// Records the progress.
    #[derive(Default)]
    struct ProgressLog(Vec<f32>);

    impl Watcher for ProgressLog {
        fn step(&mut self, done: f32, _: &mut dyn Snapshot) -> Result<()> {
            self.0.push(done);
            Ok(())
        }

        fn recount(&mut self, primitives: &[Primitive]) -> Result<usize> {
            Ok(primitives.len())
        }
    }

    #[test]
    fn a_probe_fit_adds_no_steps_and_progress_never_goes_back() {
        let samples = (0..96 * 64 * 3).map(|i| (i / 3 % 96 * 2 + i * 7919 % 31) as u8).collect();
        let mut target = Planes::new(&Pixels::new(96, 64, Channels::Rgb, Samples::U8(samples)).unwrap());
        target.amplitude = masking::amplitudes(&target, 150);
        let scene = Scene { width: 96, height: 64, blend: Blend::Normalized, background: target.mean };
        let problem = Problem { scene, target: &target };
        for (reweighs, deadline) in [(false, None), (true, None), (true, Some(std::time::Duration::from_secs(3600)))] {
            let fit_deadline = deadline.map(|d| crate::instant::Instant::now() + d);
            let plan = Plan { reweighs, fit_deadline, ..Plan::steps(50, 1) };
            let mut log = ProgressLog::default();
            let fitted = fit_on_cpu(&Job { problem, count: 150, plan: &plan }, &mut log).unwrap();
            assert_eq!(log.0.len(), 50);
            assert!(log.0.is_sorted() && log.0[49] < 1.0, "{:?}", log.0);
            let amplitude = fitted.amplitude.unwrap_or_else(|| target.amplitude.clone());
            assert_eq!(amplitude != target.amplitude, reweighs);
            assert_eq!(amplitude.len(), target.amplitude.len());
        }
    }

    #[test]
    fn a_probe_fit_that_is_good_enough_ends_the_fit() {
        let target = Planes::new(&Pixels::new(40, 30, Channels::Grey, Samples::U8(vec![77; 1200])).unwrap());
        let scene = Scene { width: 40, height: 30, blend: Blend::Normalized, background: target.mean };
        let plan = Plan { reweighs: true, enough: 1e-4, ..Plan::steps(100, 0) };
        let job = Job { problem: Problem { scene, target: &target }, count: 130, plan: &plan };
        let fitted = fit_on_cpu(&job, &mut ProgressLog::default()).unwrap();
        let Ending::Enough { left } = fitted.ending else { panic!("{:?}", fitted.ending) };
        assert!((71..100).contains(&left), "{left}");
        assert_eq!(fitted.amplitude, None);
    }
}
