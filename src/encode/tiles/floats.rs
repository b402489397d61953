//! The float fit of a tile: first alone, then together with the primitives around it.

use super::global::GlobalContext;
use super::grid::{Shift, Window};
use super::mosaic::{Placed, TileResult, WindowPrimitives};
use crate::bitstream;
use crate::bitstream::splats::PackedSplats;
use crate::constants::rate_control;
use crate::constants::tiles;
use crate::encode::primitive_count::excess;
use crate::error::Result;
use crate::fit::engine::{Engine, Snapshot, Watcher};
use crate::fit::job::Job;
use crate::fit::model::adam::Bounds;
use crate::fit::model::drawing::field::{Field, Output, error_within};
use crate::fit::model::drawing::project::{self, Primitive};
use crate::fit::model::objective::rows::RowSet;
use crate::fit::model::placing::peaks::{at_peak, peaks};
use crate::fit::model::placing::removal;
use crate::fit::model::problem::Problem;
use crate::fit::multi_start::{self, Start};
use crate::fit::state::State;
use crate::rdo::rounded::Rounded;

/// The later passes: the fraction of the iterations at which each of them ends, and the position of its tiles.
pub(super) const JOINED: [(f32, Shift); 3] = {
    let [first, second, last] = tiles::JOINED_UNTIL;
    [(first, Shift::Half), (second, Shift::None), (last, Shift::Half)]
};

/// Progress callback. It receives the fraction of the work that is done; an error stops the work.
pub(super) type OnProgress<'a> = &'a mut dyn FnMut(f32) -> Result<()>;

/// Fits a tile alone.
pub(super) fn begin(
    global: &GlobalContext<'_>,
    window: &Window,
    on_progress: OnProgress<'_>,
) -> Result<TileResult<Primitive>> {
    let target = global.planes(&window.padded)?;
    let problem = Problem { scene: global.scene(&window.padded), target: &target };
    let (count, plan) = (global.count_of(&target), global.plan_of(window));
    let job = Job { problem, count, plan: &plan };
    let Start { state, rng, from } = multi_start::scattered(&target, count, &plan);
    let price = Some(Price {
        problem,
        draft: global.draft(&window.padded),
        bits: count as f64 * rate_control::CODED_BITS * excess(global.settings.count),
    });
    let mut watcher = TileFitWatcher {
        on_progress,
        from: 0.0,
        to: tiles::ALONE_SHARE,
        price: price.filter(|_| global.settings.is_priced),
    };
    let range = from..share(tiles::ALONE_SHARE, plan.iterations);
    let state = global.device.steps(&job, global.source.depth(), state, (rng, range), &mut watcher)?;
    Ok(appraise(&problem, &state.primitives, window))
}

fn share(of: f32, iterations: u32) -> u32 {
    (iterations as f32 * of) as u32
}

/// Returns the primitives of a tile with their costs, candidate primitives with their estimated gains, and the error of
/// the tile.
fn appraise(problem: &Problem<'_>, primitives: &[Primitive], window: &Window) -> TileResult<Primitive> {
    let projected = project::all(primitives, problem.scene.height);
    let mut field = Field::default();
    field.draw(problem, &projected, RowSet::ALL, Output::Picture);
    let costs = removal::costs(problem, &field, RowSet::ALL, &projected);
    let count = (primitives.len() as f32 * tiles::CANDIDATE_SHARE) as usize;
    let candidates = peaks(problem, &field, RowSet::ALL, count, primitives.len());
    let placed = |p: Primitive, cost: f32| Placed { primitive: moved(p, window.padded.origin()), cost };
    let is_own = |p: &Placed<Primitive>| window.core.holds(p.primitive.mean);
    TileResult {
        own: primitives.iter().zip(costs).map(|(p, cost)| placed(*p, cost)).filter(is_own).collect(),
        candidates: candidates.iter().map(|peak| placed(at_peak(peak, problem), peak.gain)).filter(is_own).collect(),
        error: error_within(problem, &projected, window.own(), Output::Picture),
    }
}

/// Continues the fit of a tile in pass `pass` of [`JOINED`]. Only the `own` primitives move; `neighbours` stay fixed.
pub(super) fn join(
    global: &GlobalContext<'_>,
    (pass, window): (usize, &Window),
    WindowPrimitives { own, neighbours }: WindowPrimitives<Primitive>,
    on_progress: OnProgress<'_>,
) -> Result<TileResult<Primitive>> {
    let target = global.planes(&window.padded)?;
    let problem = Problem { scene: global.scene(&window.padded), target: &target };
    let plan = global.plan_of(window);
    let job = Job { problem, count: own.len(), plan: &plan };
    let local = |all: Vec<Primitive>| -> Vec<Primitive> {
        all.into_iter().map(|p| moved(p, window.padded.origin().map(|v| -v))).collect()
    };
    let mut state = State::new(local(own), Bounds::new(window.padded.size[0], window.padded.size[1]));
    state.frozen = local(neighbours);
    let from = if pass > 0 { JOINED[pass - 1].0 } else { tiles::ALONE_SHARE };
    let to = JOINED[pass].0;
    let mut watcher = TileFitWatcher { on_progress, from, to, price: None };
    let rng = multi_start::random(&plan);
    let range = share(from, plan.iterations)..share(to, plan.iterations);
    let mut state = global.device.steps(&job, global.source.depth(), state, (rng, range), &mut watcher)?;
    state.keep_best()?;
    let all = [&state.primitives[..], &state.frozen].concat();
    let error = error_within(&problem, &project::all(&all, problem.scene.height), window.own(), Output::Picture);
    let placed = |p: &Primitive| Placed { primitive: moved(*p, window.padded.origin()), cost: 0.0 };
    Ok(TileResult { own: state.primitives.iter().map(placed).collect(), candidates: Vec::new(), error })
}

/// Returns the primitive, moved `by` pixels.
pub(super) fn moved(p: Primitive, by: [f32; 2]) -> Primitive {
    Primitive { mean: [p.mean[0] + by[0], p.mean[1] + by[1]], ..p }
}

/// Reports the progress of the fit of a tile, and corrects its number of primitives if bits have a price.
struct TileFitWatcher<'a> {
    on_progress: OnProgress<'a>,
    /// Start and end of the part of the schedule that this fit runs, as fractions of the schedule.
    from: f32,
    to: f32,
    price: Option<Price<'a>>,
}

/// The bits allowed for a tile, with the data to estimate the bits per primitive.
struct Price<'a> {
    problem: Problem<'a>,
    /// A file of the tile without primitives.
    draft: PackedSplats,
    bits: f64,
}

impl Price<'_> {
    /// Returns the number of primitives that fit into the allowed bits, given the average coded size of `primitives`.
    fn count(&mut self, primitives: &[Primitive]) -> Result<usize> {
        let fixed = bitstream::to_bytes(&self.draft)?.len();
        let rounded = Rounded::nearest(&self.problem, self.draft.layout, primitives);
        (self.draft.steps, self.draft.gaussians) = (rounded.steps, rounded.gaussians);
        let all = bitstream::to_bytes(&self.draft)?.len();
        self.draft.gaussians.clear();
        let each = 8.0 * (all - fixed.min(all)) as f64 / primitives.len().max(1) as f64;
        Ok((self.bits / each.max(4.0)) as usize)
    }
}

impl Watcher for TileFitWatcher<'_> {
    fn step(&mut self, done: f32, _: &mut dyn Snapshot) -> Result<()> {
        (self.on_progress)(((done - self.from) / (self.to - self.from)).clamp(0.0, 1.0))
    }

    fn recount(&mut self, primitives: &[Primitive]) -> Result<usize> {
        match &mut self.price {
            Some(price) => Ok(price.count(primitives)?.clamp(primitives.len().min(1), 2 * primitives.len())),
            None => Ok(primitives.len()),
        }
    }
}
