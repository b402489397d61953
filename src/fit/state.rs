//! The state of a fit: primitives and the optimizer's moments.

use crate::fit::model::adam::{self, AdamMoments, Bounds, Rates};
use crate::fit::model::drawing::field::{Field, Output};
use crate::fit::model::drawing::project::{self, Primitive, Projected};
use crate::fit::model::drawing::strips;
use crate::fit::model::objective::rows::RowSet;
use crate::fit::model::placing::peaks::Scratch;
use crate::fit::model::placing::removal;
use crate::fit::model::problem::Problem;
use crate::parallel;

/// The state of a fit.
#[derive(Debug)]
pub(crate) struct State {
    pub primitives: Vec<Primitive>,
    /// Frozen primitives that are rendered together with these.
    pub frozen: Vec<Primitive>,
    pub(super) memory: Vec<AdamMoments>,
    pub bounds: Bounds,
    pub field: Field,
    /// Scratch memory for the search for peaks of the error.
    pub(super) scratch: Scratch,
    /// The price of size, based on the most recently measured error: see [`adam::price`].
    pub price: f32,
    /// Whether the objective includes a price of size.
    pub(super) is_priced: bool,
    pub(super) iteration: u32,
    /// The size of the picture that the steps work on, relative to full size.
    pub(super) scale: f32,
    /// The smallest error over all rows with this number of primitives, and the primitives that achieved it.
    pub(super) best: Option<(f64, Vec<Primitive>)>,
    /// The most recently measured error over all rows.
    pub(super) latest: f64,
}

/// What a fit has accumulated besides its primitives. Another engine needs it to take the same steps from there on.
#[allow(dead_code, reason = "only a GPU continues a fit, or hands one back")]
#[derive(Debug)]
pub(crate) struct Progress {
    /// Moments of each primitive that moves.
    pub moments: Vec<AdamMoments>,
    pub iteration: u32,
    pub price: f32,
    pub is_priced: bool,
}

impl State {
    /// Returns the state of a fit at full size that another engine has brought to this point.
    #[allow(dead_code, reason = "only a GPU continues a fit, or hands one back")]
    pub(crate) fn resumed(
        primitives: Vec<Primitive>,
        frozen: Vec<Primitive>,
        bounds: Bounds,
        progress: Progress,
    ) -> Self {
        let Progress { moments, iteration, price, is_priced } = progress;
        let mut state = State { frozen, iteration, price, is_priced, ..State::unsorted(primitives, bounds) };
        state.memory = moments;
        state.sort();
        state
    }

    /// Returns what another engine needs besides the primitives to continue this fit.
    #[allow(dead_code, reason = "only a GPU continues a fit, or hands one back")]
    pub(crate) fn progress(&self) -> Progress {
        let State { iteration, price, is_priced, .. } = *self;
        Progress { moments: self.memory.clone(), iteration, price, is_priced }
    }

    pub(crate) fn new(primitives: Vec<Primitive>, bounds: Bounds) -> Self {
        let mut state = State::unsorted(primitives, bounds);
        state.sort();
        state
    }

    fn unsorted(mut primitives: Vec<Primitive>, bounds: Bounds) -> Self {
        for p in &mut primitives {
            bounds.apply(p);
        }
        let memory = vec![AdamMoments::default(); primitives.len()];
        State {
            primitives,
            frozen: Vec::new(),
            memory,
            bounds,
            field: Field::default(),
            scratch: Scratch::default(),
            price: 0.0,
            is_priced: true,
            iteration: 0,
            scale: 1.0,
            best: None,
            latest: 0.0,
        }
    }

    /// Takes one step on the error over `rows`. Returns the error before the step.
    pub(crate) fn descend(&mut self, problem: &Problem<'_>, rows: RowSet, rates: Rates) -> f64 {
        let projected = self.projected(problem.scene.height);
        let error = self.field.draw(problem, &projected, rows, Output::Gradient);
        self.step(problem, rows, &projected, rates);
        error
    }

    /// Returns all visible primitives in a picture of `height` rows: first the movable ones, then the frozen ones.
    pub(super) fn projected(&self, height: u32) -> Vec<Projected> {
        let mut projected = project::all(&self.primitives, height);
        projected.extend(project::all(&self.frozen, height));
        projected
    }

    /// Gathers every primitive's gradient from the field, adds the gradient of the [`adam::price`] and takes one step.
    fn step(&mut self, problem: &Problem<'_>, rows: RowSet, projected: &[Projected], rates: Rates) {
        const CHUNK: usize = strips::PRIMITIVES_PER_PART;
        let (width, channels) = (problem.scene.width, problem.target.channels.count());
        let price = self.price / rows.step as f32;
        let corrections = adam::corrections(rates.decay, self.iteration);
        let (field, bounds) = (&self.field, &self.bounds);
        let (primitives, memory) = (&mut self.primitives[..], &mut self.memory[..]);
        parallel::map_chunk_pairs((primitives, CHUNK), (memory, CHUNK), |chunk, primitives, memory| {
            let start = chunk * CHUNK;
            let projected = &projected[start..][..primitives.len()];
            let mut gradients = field.gather(channels, rows, width, (start, projected), primitives);
            for ((p, m), gradient) in primitives.iter_mut().zip(memory).zip(&mut gradients) {
                let [a, b] = gradient.frame.scale;
                let growth = price * a * b;
                gradient.log_scale = gradient.log_scale.map(|g| g + growth);
                adam::update(p, m, gradient, bounds, rates, corrections);
            }
        });
        self.iteration += 1;
    }

    pub(super) fn keep(&mut self, error: f64, primitives: Vec<Primitive>) {
        self.latest = error;
        if self.best.as_ref().is_none_or(|b| error < b.0) {
            self.best = Some((error, primitives));
        }
    }

    /// Sorts the primitives so that neighbours in the picture are adjacent in memory.
    pub(super) fn sort(&mut self) {
        let mut order: Vec<u32> = (0..self.primitives.len() as u32).collect();
        order.sort_by_key(|&i| {
            let [x, y] = self.primitives[i as usize].mean;
            ((y / 64.0) as u32, x as u32, i)
        });
        self.primitives = order.iter().map(|&i| self.primitives[i as usize]).collect();
        self.memory = order.iter().map(|&i| self.memory[i as usize]).collect();
    }

    /// Returns the cost of removing each primitive. Leaves the picture in the field, and updates the price by its
    /// error.
    pub(crate) fn survey(&mut self, problem: &Problem<'_>, rows: RowSet) -> Vec<f32> {
        let scene = &problem.scene;
        let projected = self.projected(scene.height);
        let error = self.field.draw(problem, &projected, rows, Output::Picture);
        if self.is_priced {
            self.price = adam::price(error, [scene.width, scene.height], rows, projected.len());
        }
        removal::costs(problem, &self.field, rows, &projected[..self.primitives.len()])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::model::adam::price;
    use crate::fit::model::objective::planes::Planes;
    use crate::fit::model::problem::Scene;
    use crate::fit::schedule::RATES;
    use crate::gaussian::{Blend, Channels};
    use crate::pixels::{Pixels, Samples};

    #[test]
    fn the_price_shrinks_primitives_whose_size_gains_nothing() {
        // Noise without a slope: the mean is the best fit for any size of Gaussian.
        let samples = (0..96 * 80usize).map(|i| 120 + (i * 7919 % 251 % 16) as u8).collect();
        let target = Planes::new(&Pixels::new(96, 80, Channels::Grey, Samples::U8(samples)).unwrap());
        let scene = Scene { width: 96, height: 80, blend: Blend::Normalized, background: target.mean };
        let problem = Problem { scene, target: &target };
        let primitives: Vec<Primitive> = (0..60u32)
            .map(|i| {
                let f = |k: u32| (f64::from(i) * f64::from(k).sqrt()).fract() as f32;
                Primitive {
                    mean: [96.0 * f(2), 80.0 * f(3)],
                    log_scale: [3.0 + f(5), 2.5 + f(7)],
                    rotation: 3.0 * f(11),
                    color: [target.mean[0], 0.0, 0.0, 0.0],
                }
            })
            .collect();
        let fitted = |priced: bool| {
            let mut state = State::new(primitives.clone(), Bounds::new(96, 80));
            let before =
                State::descend(&mut state, &problem, RowSet::ALL, RATES.scaled(crate::constants::fit::LAST_RATE));
            state.price = if priced { price(before, [96, 80], RowSet::ALL, primitives.len()) } else { 0.0 };
            let mut after = 0.0;
            for i in 0..200 {
                let rows = RowSet { step: 2, phase: i % 2 };
                after = State::descend(&mut state, &problem, rows, RATES.scaled(0.3));
            }
            let area: f32 = state.primitives.iter().map(|p| (p.log_scale[0] + p.log_scale[1]).exp()).sum();
            (2.0 * after / before, area)
        };
        let ((error, area), (free_error, free_area)) = (fitted(true), fitted(false));
        // About 40 supports cover each pixel, each priced at 0.1 % of its error, so size is worth at most 4 % of the
        // error.
        assert!(area < 0.5 * free_area, "{area} {free_area}");
        assert!(error < 1.04 * free_error, "{error} {free_error}");
    }
}
