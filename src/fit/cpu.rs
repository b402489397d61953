//! The fitting engine on the CPU.

use crate::constants::fit;
use crate::error::Result;
use crate::fit::engine::Engine;
use crate::fit::model::adam::{AdamMoments, Bounds, Rates};
use crate::fit::model::drawing::field::{Output, float_error};
use crate::fit::model::drawing::project::{self, Primitive};
use crate::fit::model::objective::rows::RowSet;
use crate::fit::model::placing::peaks::{Scratch, at_peak};
use crate::fit::model::placing::removal;
use crate::fit::model::problem::Problem;
use crate::fit::state::State;

impl Engine for State {
    const REMEMBERS_WHOLE_STEPS: bool = true;

    fn count(&self) -> usize {
        self.primitives.len()
    }

    fn primitives(&mut self) -> Result<Vec<Primitive>> {
        Ok(self.primitives.clone())
    }

    fn settle(&mut self) -> Result<()> {
        Ok(())
    }

    fn error(&mut self, whole: &Problem<'_>) -> Result<f64> {
        if self.scale != 1.0 {
            let visible = [&self.primitives[..], &self.frozen].concat();
            return Ok(float_error(whole, &project::zoomed(visible, self.scale.recip())));
        }
        let projected = self.projected(whole.scene.height);
        Ok(self.field.error(whole, &projected, Output::Picture))
    }

    fn descend(&mut self, problem: &Problem<'_>, rows: RowSet, rates: Rates) -> Result<Option<f64>> {
        // A step on all rows returns the error of the state before it.
        let before = (rows == RowSet::ALL).then(|| self.primitives.clone());
        let error = State::descend(self, problem, rows, rates);
        if let Some(before) = before {
            self.keep(error, before);
        }
        Ok(Some(error))
    }

    /// Moves primitives while the estimated gain exceeds the removal cost.
    fn relocate(&mut self, problem: &Problem<'_>, rows: RowSet, max_count: usize) -> Result<usize> {
        let costs = self.survey(problem, rows);
        let peaks = self.scratch.peaks(problem, &self.field, rows, [max_count, self.primitives.len()]);
        let mut moved = 0;
        for (peak, i) in peaks.iter().zip(removal::cheapest(&costs, max_count)) {
            if peak.gain < costs[i] {
                break;
            }
            self.primitives[i] = at_peak(peak, problem);
            self.memory[i] = AdamMoments::default();
            moved += 1;
        }
        self.sort();
        Ok(moved)
    }

    fn resize(&mut self, problem: &Problem<'_>, rows: RowSet, wanted: usize) -> Result<()> {
        let costs = self.survey(problem, rows);
        let have = self.primitives.len();
        if wanted < have {
            let mut keep = vec![true; have];
            for i in removal::cheapest_first(&costs).into_iter().take(have - wanted) {
                keep[i] = false;
            }
            let mut kept = keep.iter();
            self.primitives.retain(|_| *kept.next().expect("one flag for each primitive"));
            let mut kept = keep.iter();
            self.memory.retain(|_| *kept.next().expect("one flag for each primitive"));
        } else {
            for peak in self.scratch.peaks(problem, &self.field, rows, [wanted - have, wanted]) {
                self.primitives.push(at_peak(&peak, problem));
                self.memory.push(AdamMoments::default());
            }
        }
        self.sort();
        // Errors with different numbers of primitives are not comparable.
        self.best.take_if(|(_, primitives)| primitives.len() != wanted);
        Ok(())
    }

    fn end_searches(&mut self) {
        self.scratch = Scratch::default();
    }

    fn remember(&mut self, problem: &Problem<'_>) -> Result<()> {
        let error = self.error(problem)?;
        self.keep(error, self.primitives.clone());
        Ok(())
    }

    /// Restores the best state if the final one is clearly worse. A fit of few primitives can lose decibels in its
    /// first steps on all rows, because those steps are long and the optimizer's moments still contain the noise of row
    /// sampling.
    fn keep_best(&mut self) -> Result<()> {
        if let Some((error, primitives)) = self.best.take()
            && self.latest > fit::CLEARLY_WORSE * error
        {
            let frozen = std::mem::take(&mut self.frozen);
            let (price, is_priced) = (self.price, self.is_priced);
            *self = State { price, is_priced, frozen, ..State::new(primitives, self.bounds) };
        }
        Ok(())
    }

    fn zoom(&mut self, problem: &Problem<'_>, by: f32) -> Result<()> {
        // Gradients scale with the picture's size, so the moments of the previous size would mislead the optimizer.
        let bounds = Bounds::new(problem.scene.width, problem.scene.height);
        let zoomed = State::new(project::zoomed(std::mem::take(&mut self.primitives), by), bounds);
        let frozen = project::zoomed(std::mem::take(&mut self.frozen), by);
        let (iteration, price, is_priced, scale) = (self.iteration, self.price, self.is_priced, self.scale * by);
        let (field, scratch) = (std::mem::take(&mut self.field), std::mem::take(&mut self.scratch));
        *self = State { iteration, price, is_priced, scale, frozen, field, scratch, ..zoomed };
        Ok(())
    }

    fn reweigh(&mut self, _: &Problem<'_>) -> Result<()> {
        self.best = None;
        Ok(())
    }

    fn finish(self) -> Result<State> {
        Ok(self)
    }
}
