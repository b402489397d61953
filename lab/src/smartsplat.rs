//! The SmartSplat pipeline (AAAI 2026): its initialization in parts that can be omitted, its loss and its optimizer.
//!
//! Where the paper and the published program differ, this code follows the program: rates of 0.05 pixels for scales and
//! 0.005 for colours (the paper has them the other way round), and a weight of 0.8 for the absolute error in the loss
//! (paper: 0.9). The fit returns its best state, not its last one.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use rstar::RTree;

use ssplat::Result;
use ssplat::unstable::fit::engine::{StaticSnapshot, Watcher};
use ssplat::unstable::fit::method::{FitMethod, MethodJob};
use ssplat::unstable::fit::model::adam::Bounds;
use ssplat::unstable::fit::model::drawing::field::{Field, Gradient, Output};
use ssplat::unstable::fit::model::drawing::project::{self, Primitive};
use ssplat::unstable::fit::model::objective::planes::Planes;
use ssplat::unstable::fit::model::objective::rows::RowSet;
use ssplat::unstable::fit::model::problem::Problem;
use ssplat::unstable::parallel;

use crate::loss::Loss;

/// Share of the primitives that follow gradient and variance. The rest is distributed evenly.
const GUIDED_SHARE: f64 = 0.7;
/// Share of the gradient in the weight of a pixel. The rest is the variance.
const GRADIENT_SHARE: f32 = 0.9;
/// Side of the tiles that are sampled independently, pixels.
const TILE: usize = 1024;
/// Half the side of the square over which the variance is taken, pixels.
const VARIANCE_REACH: usize = 2;
/// Number of neighbours that determine the scale of an evenly distributed primitive.
const NEIGHBOURS: usize = 3;
/// Minimum weight of a pixel, so that flat tiles can be sampled.
const MIN_WEIGHT: f32 = 1e-8;
/// Weight of the absolute error in the loss. The rest is structural similarity.
const ABSOLUTE_WEIGHT: f32 = 0.8;

/// Constant step sizes: means in half sides of the picture, scales in pixels, rotations in logits of the fraction of a
/// full turn.
const MEAN_RATE: f32 = 1e-4;
const SCALE_RATE: f32 = 5e-2;
const ROTATION_RATE: f32 = 1e-3;
const COLOR_RATE: f32 = 5e-3;
const BETA1: f32 = 0.9;
const BETA2: f32 = 0.999;

/// Fraction of the iterations after which the number of primitives is corrected and the fit restarts. The paper counts
/// seven bytes per primitive; the actual number of bytes is known only for fitted primitives.
const RECOUNT_AT: f32 = 0.25;

/// Which parts of SmartSplat's initialization are used, in the order of the paper's ablation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Ablation {
    /// Random means, uniform scales, random colours.
    Random,
    /// Means by feature-guided and exclusion-based sampling.
    Means,
    /// Scales by the paper's rule as well.
    Scales,
    /// Gaussian-weighted median colours as well: the whole initialization.
    Colors,
}

/// All steps of the ablation, in its order.
pub static ABLATION: [Ablation; 4] = [Ablation::Random, Ablation::Means, Ablation::Scales, Ablation::Colors];

impl FitMethod for Ablation {
    fn start(&self, job: &MethodJob<'_>, rng: &mut Pcg64Mcg) -> Vec<Primitive> {
        initial(job.problem.target, job.count, *self, rng)
    }

    /// Fits like SmartSplat. `watcher` corrects the number of primitives once.
    fn fit(&self, job: &MethodJob<'_>, watcher: &mut dyn Watcher) -> Result<Vec<Primitive>> {
        let MethodJob { problem, count, iterations, seed, spent } = *job;
        let Problem { scene, target } = problem;
        let bounds = Bounds::new(target.width, target.height);
        let mut loss = Loss::new(target, ABSOLUTE_WEIGHT);
        let mut run = Run::new(target, count, *self, seed, &bounds);
        let mut is_recounted = false;
        for iteration in 0..iterations {
            // With a time budget, the clock may be ahead of the iterations.
            let done = (iteration as f32 / iterations as f32).max(spent());
            if done >= 1.0 || run.state.primitives.is_empty() {
                break;
            }
            let project = || project::all(&run.state.primitives, scene.height);
            watcher.step(done, &mut StaticSnapshot { problem: &problem, project: &project })?;
            if !is_recounted && done >= RECOUNT_AT {
                is_recounted = true;
                let wanted = watcher.recount(&run.state.primitives)?;
                if wanted != run.state.primitives.len() {
                    run = Run::new(target, wanted, *self, seed, &bounds);
                }
            }
            run.step(&problem, &mut loss, &bounds);
        }
        run.keep_best(&problem);
        Ok(run.best.primitives)
    }
}

/// One fit from one initialization.
struct Run {
    state: Parameters,
    memory: Vec<Memory>,
    field: Field,
    iteration: i32,
    best: Parameters,
}

/// The primitives of the fit and their squared error.
#[derive(Clone)]
struct Parameters {
    primitives: Vec<Primitive>,
    error: f64,
}

/// Moments of one primitive's gradient.
#[derive(Clone, Copy, Default)]
struct Memory {
    first: [f32; 9],
    second: [f32; 9],
}

impl Run {
    fn new(target: &Planes, count: usize, parts: Ablation, seed: u64, bounds: &Bounds) -> Self {
        let mut primitives = initial(target, count, parts, &mut Pcg64Mcg::seed_from_u64(seed));
        for p in &mut primitives {
            bounds.apply(p);
        }
        let state = Parameters { primitives, error: f64::INFINITY };
        let memory = vec![Memory::default(); state.primitives.len()];
        Run { best: state.clone(), state, memory, field: Field::default(), iteration: 0 }
    }

    /// Updates the best state and leaves the picture in the field.
    fn keep_best(&mut self, problem: &Problem<'_>) {
        let projected = project::all(&self.state.primitives, problem.scene.height);
        self.state.error = self.field.draw(problem, &projected, RowSet::ALL, Output::Picture);
        if self.state.error < self.best.error {
            self.best.clone_from(&self.state);
        }
    }

    fn step(&mut self, problem: &Problem<'_>, loss: &mut Loss, bounds: &Bounds) {
        const CHUNK: usize = 64;
        let (scene, target) = (&problem.scene, problem.target);
        self.keep_best(problem);
        loss.gradient(problem, &mut self.field);
        self.iteration += 1;
        let corrections = [1.0 - BETA1.powi(self.iteration), 1.0 - BETA2.powi(self.iteration)];
        let projected = project::all(&self.state.primitives, scene.height);
        let (field, channels) = (&self.field, target.channels.count());
        let halves = bounds.size.map(|s| 0.5 * s);
        parallel::map_chunk_pairs(
            (&mut self.state.primitives, CHUNK),
            (&mut self.memory, CHUNK),
            |c, primitives, memory| {
                let projected = &projected[c * CHUNK..][..primitives.len()];
                let drawn = (c * CHUNK, projected);
                let gradients = field.gather(channels, RowSet::ALL, scene.width, drawn, primitives);
                for ((p, m), g) in primitives.iter_mut().zip(memory).zip(&gradients) {
                    update(p, m, g, halves, corrections);
                    bounds.apply(p);
                }
            },
        );
    }
}

/// Takes one Adam step on means, scales, rotation and colour.
fn update(p: &mut Primitive, m: &mut Memory, g: &Gradient, halves: [f32; 2], corrections: [f32; 2]) {
    let [sx, sy] = p.log_scale.map(f32::exp);
    let (sin, cos) = p.rotation.sin_cos();
    // From the primitive's own frame to that of the picture.
    let (u, v) = (g.mean[0] / sx, g.mean[1] / sy);
    let turn = (p.rotation / std::f32::consts::TAU).rem_euclid(1.0).clamp(1e-4, 1.0 - 1e-4);
    let slope = std::f32::consts::TAU * turn * (1.0 - turn);
    let [r, s, t, a] = g.color;
    let gradient = [
        (cos * u - sin * v) * halves[0],
        (sin * u + cos * v) * halves[1],
        g.log_scale[0] / sx,
        g.log_scale[1] / sy,
        g.rotation * slope,
        r,
        s,
        t,
        a,
    ];
    let mut d = [0.0f32; 9];
    for j in 0..9 {
        let v = if gradient[j].is_finite() { gradient[j] } else { 0.0 };
        m.first[j] = BETA1 * m.first[j] + (1.0 - BETA1) * v;
        m.second[j] = BETA2 * m.second[j] + (1.0 - BETA2) * v * v;
        d[j] = -(m.first[j] / corrections[0]) / ((m.second[j] / corrections[1]).sqrt() + 1e-15);
    }
    p.mean[0] += MEAN_RATE * d[0] * halves[0];
    p.mean[1] += MEAN_RATE * d[1] * halves[1];
    // A scale that passes 0 is reflected, as in the published program, which takes the absolute value.
    p.log_scale = [(sx + SCALE_RATE * d[2]).abs().ln(), (sy + SCALE_RATE * d[3]).abs().ln()];
    let logit = (turn / (1.0 - turn)).ln() + ROTATION_RATE * d[4];
    p.rotation = std::f32::consts::TAU / (1.0 + (-logit).exp());
    for k in 0..4 {
        p.color[k] = (p.color[k] + COLOR_RATE * d[5 + k]).clamp(-4.0, 4.0);
    }
}

/// Returns the initial primitives, with the parts of the initialization in `parts`.
fn initial(target: &Planes, count: usize, parts: Ablation, rng: &mut Pcg64Mcg) -> Vec<Primitive> {
    let area = f64::from(target.width) * f64::from(target.height);
    // A third of the radius at which `count` circles would cover the picture, because the support is three scales.
    let base = ((area / (std::f64::consts::PI * count.max(1) as f64)).sqrt() / 3.0) as f32;
    let mut places = if parts >= Ablation::Means {
        spread(target, count, base, rng)
    } else {
        (0..count).map(|_| Placement { mean: anywhere(target, rng), scale: base }).collect()
    };
    if parts < Ablation::Scales {
        places.iter_mut().for_each(|p| p.scale = base);
    }
    let mut primitives: Vec<Primitive> = places
        .iter()
        .map(|p| Primitive {
            mean: p.mean,
            log_scale: [p.scale.ln(); 2],
            rotation: rng.random::<f32>() * std::f32::consts::TAU,
            color: std::array::from_fn(|_| rng.random()),
        })
        .collect();
    if parts >= Ablation::Colors {
        parallel::map_chunks(&mut primitives, 64, |chunk, primitives| {
            for (p, place) in primitives.iter_mut().zip(&places[chunk * 64..]) {
                p.color = median_color(target, place);
            }
        });
    }
    primitives
}

/// The initial position and scale of a primitive, pixels.
#[derive(Debug, Clone, Copy)]
struct Placement {
    mean: [f32; 2],
    scale: f32,
}

fn anywhere(target: &Planes, rng: &mut Pcg64Mcg) -> [f32; 2] {
    [rng.random::<f32>() * target.width as f32, rng.random::<f32>() * target.height as f32]
}

/// Places primitives by gradient and variance, then evenly in the remaining area.
fn spread(target: &Planes, count: usize, base: f32, rng: &mut Pcg64Mcg) -> Vec<Placement> {
    let mut places = guided(target, (count as f64 * GUIDED_SHARE).round() as usize, base, rng);
    let mut scales: Vec<f32> = places.iter().map(|p| p.scale).collect();
    scales.sort_by(f32::total_cmp);
    let radius = scales.get(scales.len() / 2).map_or(base, |&median| base.max(median));
    let taken = RTree::bulk_load(places.iter().map(|p| p.mean).collect());
    let first_even = places.len();
    while places.len() < count {
        // The circles around existing places cover less than a tenth of the picture, so few candidates are rejected.
        let free = (0..64)
            .map(|_| anywhere(target, rng))
            .find(|m| taken.locate_within_distance(*m, radius * radius).next().is_none());
        let mean = free.unwrap_or_else(|| anywhere(target, rng));
        places.push(Placement { mean, scale: base });
    }
    let all = RTree::bulk_load(places.iter().map(|p| p.mean).collect());
    parallel::map_chunks(&mut places[first_even..], 64, |_, even| {
        for p in even {
            // The nearest neighbour is the place itself.
            let squares = all.nearest_neighbor_iter(p.mean).skip(1).take(NEIGHBOURS).map(|q| {
                let [dx, dy] = [q[0] - p.mean[0], q[1] - p.mean[1]];
                dx * dx + dy * dy
            });
            let (sum, found) = squares.fold((0.0, 0), |(sum, found), d| (sum + d, found + 1));
            if sum > 0.0 {
                p.scale = (sum / found as f32).sqrt();
            }
        }
    });
    places
}

/// Draws pixels by gradient and variance without replacement, the same number in each tile.
fn guided(target: &Planes, count: usize, base: f32, rng: &mut Pcg64Mcg) -> Vec<Placement> {
    let columns = tiles(target.width as usize);
    let rows = tiles(target.height as usize);
    let number = columns.len() * rows.len();
    let mut places = Vec::with_capacity(count);
    for (i, (y, x)) in rows.iter().flat_map(|y| columns.iter().map(move |x| (y, x))).enumerate() {
        let wanted = count / number + usize::from(i < count % number);
        let weights = weights(target, x.clone(), y.clone());
        // The smallest exponential variables divided by their weights are a weighted sample without replacement
        // (Efraimidis and Spirakis, 2006).
        let mut keys: Vec<(f32, usize)> =
            weights.iter().enumerate().map(|(i, w)| (-(1.0 - rng.random::<f32>()).ln() / w, i)).collect();
        let by_key = |a: &(f32, usize), b: &(f32, usize)| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1));
        if wanted < keys.len() {
            keys.select_nth_unstable_by(wanted, by_key);
            keys.truncate(wanted);
        }
        keys.sort_unstable_by_key(|k| k.1);
        places.extend(keys.iter().map(|&(_, i)| Placement {
            mean: [(x.start + i % x.len()) as f32 + 0.5, (y.start + i / x.len()) as f32 + 0.5],
            scale: base * (-0.5 * weights[i]).exp(),
        }));
    }
    places
}

/// Returns evenly placed tiles along a side. The last one ends with the picture; tiles overlap where necessary.
fn tiles(side: usize) -> Vec<std::ops::Range<usize>> {
    let count = side.div_ceil(TILE);
    let stride = if count > 1 { (side - TILE) as f64 / (count - 1) as f64 } else { 0.0 };
    let start = |i: usize| ((i as f64 * stride) as usize).min(side.saturating_sub(TILE));
    (0..count).map(|i| start(i)..(start(i) + TILE).min(side)).collect()
}

/// Returns the weight of each pixel of a tile: gradient and variance, each relative to its maximum in the tile.
fn weights(target: &Planes, columns: std::ops::Range<usize>, rows: std::ops::Range<usize>) -> Vec<f32> {
    let width = columns.len();
    let mut gradients = vec![0.0f32; width * rows.len()];
    let mut variances = vec![0.0f32; width * rows.len()];
    let largest =
        parallel::map_chunk_pairs((&mut gradients, width), (&mut variances, width), |y, gradients, variances| {
            let mut largest = [1e-8f32; 2];
            for (x, (g, v)) in gradients.iter_mut().zip(variances).enumerate() {
                (*g, *v) = (
                    gradient(target, columns.start + x, rows.start + y),
                    variance(target, columns.start + x, rows.start + y),
                );
                largest = [largest[0].max(*g), largest[1].max(*v)];
            }
            largest
        });
    let [gradient, variance] = largest.iter().fold([0.0f32; 2], |a, b| [a[0].max(b[0]), a[1].max(b[1])]);
    gradients
        .iter()
        .zip(&variances)
        .map(|(g, v)| (GRADIENT_SHARE * g / gradient + (1.0 - GRADIENT_SHARE) * v / variance).max(MIN_WEIGHT))
        .collect()
}

/// Returns the mean over the channels of the Sobel gradient's magnitude. Borders are repeated.
fn gradient(target: &Planes, x: usize, y: usize) -> f32 {
    let rows = around(y, 1, target.height as usize).map(|y| target.row(y as u32));
    let columns = around(x, 1, target.width as usize);
    let count = target.channels.count();
    let sum: f32 = (0..count)
        .map(|k| {
            let at = |i: usize, j: usize| rows[i][k * target.stride + columns[j]];
            let dx = at(0, 2) + 2.0 * at(1, 2) + at(2, 2) - at(0, 0) - 2.0 * at(1, 0) - at(2, 0);
            let dy = at(2, 0) + 2.0 * at(2, 1) + at(2, 2) - at(0, 0) - 2.0 * at(0, 1) - at(0, 2);
            (dx * dx + dy * dy).sqrt()
        })
        .sum();
    sum / count as f32
}

/// Returns the two neighbours of `i` in `0..size`, and `i` itself.
fn around(i: usize, reach: usize, size: usize) -> [usize; 3] {
    [i.saturating_sub(reach), i, (i + reach).min(size - 1)]
}

/// Returns the mean over the channels of the variance in the square around a pixel.
fn variance(target: &Planes, x: usize, y: usize) -> f32 {
    let [left, _, right] = around(x, VARIANCE_REACH, target.width as usize);
    let [top, _, bottom] = around(y, VARIANCE_REACH, target.height as usize);
    let number = ((right - left + 1) * (bottom - top + 1)) as f32;
    let count = target.channels.count();
    let sum: f32 = (0..count)
        .map(|k| {
            let (mut sum, mut squares) = (0.0f32, 0.0f32);
            for y in top..=bottom {
                for v in &target.row(y as u32)[k * target.stride + left..=k * target.stride + right] {
                    sum += v;
                    squares += v * v;
                }
            }
            (squares / number - (sum / number) * (sum / number)).max(0.0)
        })
        .sum();
    sum / count as f32
}

/// Returns the median of the pixels within one scale of a place, weighted by a Gaussian of that scale.
fn median_color(target: &Planes, place: &Placement) -> [f32; 4] {
    let Placement { mean, scale } = *place;
    // Pixel centres are at half-integer coordinates.
    let range = |m: f32, side: u32| {
        let first = (m - 0.5 - scale).ceil().max(0.0) as u32;
        first..((m - 0.5 + scale).floor() + 1.0).clamp(0.0, side as f32) as u32
    };
    let mut pixels: Vec<(f32, u32, u32)> = Vec::new();
    for y in range(mean[1], target.height) {
        for x in range(mean[0], target.width) {
            let (dx, dy) = (x as f32 + 0.5 - mean[0], y as f32 + 0.5 - mean[1]);
            let square = dx * dx + dy * dy;
            if square <= scale * scale {
                pixels.push(((-0.5 * square / (scale * scale)).exp(), x, y));
            }
        }
    }
    let mut color = target.at(mean);
    if pixels.is_empty() {
        return color;
    }
    let half = 0.5 * pixels.iter().map(|p| p.0).sum::<f32>();
    let mut values = Vec::with_capacity(pixels.len());
    for (k, c) in color.iter_mut().enumerate().take(target.channels.count()) {
        values.clear();
        values.extend(pixels.iter().map(|&(w, x, y)| (target.row(y)[k * target.stride + x as usize], w)));
        values.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut below = 0.0;
        for &(v, w) in &values {
            below += w;
            *c = v;
            if below >= half {
                break;
            }
        }
    }
    color
}

#[cfg(test)]
mod tests {
    use ssplat::unstable::bitstream;
    use ssplat::unstable::fit::engine::Snapshot;
    use ssplat::unstable::fit::model::drawing::field::float_error;
    use ssplat::unstable::fit::model::problem::Scene;
    use ssplat::unstable::{EncodeOptions, Recipe, encode};
    use ssplat::{Backend, Blend, Channels, Limits, Pixels, Samples, Target, Tune};

    use super::*;

    const BASE: f32 = 2.0;

    /// The left half is flat, the right half is noise.
    fn half_busy(width: u32, height: u32) -> Planes {
        let noise = |i: u32| (i.wrapping_mul(2_654_435_761) >> 24) as u8;
        let at = |i: u32| if i % width < width / 2 { 100 } else { noise(i) };
        let samples = (0..width * height).map(at).collect();
        Planes::new(&Pixels::new(width, height, Channels::Grey, Samples::U8(samples)).unwrap())
    }

    fn rng() -> Pcg64Mcg {
        Pcg64Mcg::seed_from_u64(7)
    }

    #[test]
    fn tiles_have_one_size_and_cover_every_pixel() {
        for side in (1..=TILE + 2).chain([2 * TILE - 1, 2 * TILE, 2 * TILE + 1, 5 * TILE - 300]) {
            let tiles = tiles(side);
            assert!(tiles.iter().all(|t| t.len() == side.min(TILE)));
            assert_eq!((tiles[0].start, tiles.last().unwrap().end), (0, side));
            assert!(tiles.windows(2).all(|t| t[1].start <= t[0].end), "{side}");
            let steps = || tiles.windows(2).map(|t| t[1].start - t[0].start);
            assert!(steps().max().unwrap_or(0) - steps().min().unwrap_or(0) <= 1, "{side}");
        }
    }

    #[test]
    fn guided_places_are_distinct_and_follow_detail_with_smaller_scales() {
        let places = guided(&half_busy(64, 64), 300, BASE, &mut rng());
        assert_eq!(places.len(), 300);
        let mut means: Vec<[u32; 2]> = places.iter().map(|p| p.mean.map(f32::to_bits)).collect();
        means.sort_unstable();
        means.dedup();
        assert_eq!(means.len(), 300);
        let busy = places.iter().filter(|p| p.mean[0] > 29.0).count();
        assert!(busy > 295, "{busy}");
        assert!(places.iter().all(|p| p.scale <= BASE && p.scale >= BASE * (-0.5f32).exp()));
    }

    #[test]
    fn evenly_spread_places_keep_away_from_guided_ones() {
        let places = spread(&half_busy(64, 64), 200, BASE, &mut rng());
        let (guided, even) = places.split_at(140);
        let apart = |a: &Placement, b: &Placement| (a.mean[0] - b.mean[0]).hypot(a.mean[1] - b.mean[1]);
        for p in even {
            assert!(guided.iter().all(|q| apart(p, q) >= BASE));
            let mut near: Vec<f32> = places.iter().map(|q| apart(p, q)).filter(|&d| d > 0.0).collect();
            near.sort_by(f32::total_cmp);
            let rms = (near[..3].iter().map(|d| d * d).sum::<f32>() / 3.0).sqrt();
            assert!((p.scale - rms).abs() < 1e-3, "{} {rms}", p.scale);
        }
    }

    #[test]
    fn the_median_color_ignores_outliers_and_weights_the_centre() {
        let mut samples = vec![90u8; 81];
        samples[40] = 255;
        samples[0] = 0;
        let target = Planes::new(&Pixels::new(9, 9, Channels::Grey, Samples::U8(samples)).unwrap());
        let at = |scale| median_color(&target, &Placement { mean: [4.5, 4.5], scale })[0];
        assert_eq!(at(3.0), 90.0 / 255.0);
        assert_eq!(at(0.4), 1.0);
    }

    #[test]
    fn each_part_of_the_initialization_can_be_omitted() {
        let target = half_busy(64, 64);
        let of = |parts| initial(&target, 100, parts, &mut rng());
        let one_scale = |p: &[Primitive]| p.iter().all(|q| q.log_scale == p[0].log_scale);
        let left = |p: &[Primitive]| p.iter().filter(|q| q.mean[0] < 29.0).count();
        let stored = |p: &[Primitive]| p.iter().all(|q| (q.color[0] * 255.0).fract().abs() < 1e-3);
        let (random, means, scales, colors) =
            (of(Ablation::Random), of(Ablation::Means), of(Ablation::Scales), of(Ablation::Colors));
        assert!(one_scale(&random) && one_scale(&means) && !one_scale(&scales));
        assert!(left(&random) > 30 && left(&means) < 30);
        assert!(!stored(&scales) && stored(&colors));
        assert!(scales.iter().zip(&colors).all(|(a, b)| (a.mean, a.log_scale) == (b.mean, b.log_scale)));
    }

    /// Records the error of every step.
    struct Errors(Vec<f64>);

    impl Watcher for Errors {
        fn step(&mut self, _: f32, now: &mut dyn Snapshot) -> Result<()> {
            self.0.push(now.error()?);
            Ok(())
        }

        fn recount(&mut self, primitives: &[Primitive]) -> Result<usize> {
            Ok(primitives.len())
        }
    }

    #[test]
    fn the_fit_improves_and_returns_its_best_state() {
        let target = half_busy(48, 40);
        for blend in [Blend::Sum, Blend::Normalized] {
            let scene = Scene { width: 48, height: 40, blend, background: [0.0; 4] };
            let problem = Problem { scene, target: &target };
            let mut seen = Errors(Vec::new());
            let job = MethodJob { problem, count: 40, iterations: 150, seed: 3, spent: &|| 0.0 };
            let primitives = Ablation::Colors.fit(&job, &mut seen).unwrap();
            let seen = seen.0;
            let error = |p: &[Primitive]| float_error(&problem, p);
            let end = error(&primitives);
            assert!(end < 0.95 * seen[0], "{blend:?}: {} {end}", seen[0]);
            let best = seen.iter().copied().fold(f64::INFINITY, f64::min);
            // Sorting the primitives changes the order of summation.
            assert!(end <= best * (1.0 + 1e-5), "{blend:?}: {end} {best}");
        }
    }

    /// Returns a picture of waves and squares.
    fn picture(width: u32, height: u32) -> Pixels {
        let wave = |x: u32, y: u32, k: u32| (x as f32 * 0.3 + k as f32).sin() * (y as f32 * 0.23).cos();
        let square = |x: u32, y: u32| if (x / 16 + y / 12).is_multiple_of(2) { 30.0 } else { 0.0 };
        let value = |x, y, k| (128.0 + 70.0 * wave(x, y, k) + square(x, y)) as u8;
        let samples = (0..width * height * 3).map(|i| value(i / 3 % width, i / 3 / width, i % 3)).collect();
        Pixels::new(width, height, Channels::Rgb, Samples::U8(samples)).unwrap()
    }

    fn options(recipe: Recipe) -> EncodeOptions {
        let mut options = EncodeOptions::default();
        (options.recipe, options.effort, options.target) = (recipe, 1, Target::Bytes(600));
        options
    }

    #[test]
    fn all_parts_have_an_effect_and_fill_the_size() {
        let pixels = picture(96, 64);
        let mut all = Vec::new();
        for parts in &ABLATION {
            let encoded = encode(&pixels, &options(Recipe::Other(parts))).unwrap();
            assert!((540..=600).contains(&encoded.bytes.len()), "{parts:?} {}", encoded.bytes.len());
            let file = bitstream::read(&encoded.bytes[..], &Limits::default()).unwrap();
            assert_eq!(file.blend, Blend::Sum);
            all.push(encoded.bytes);
        }
        all.sort();
        all.dedup();
        assert_eq!(all.len(), 4);
    }

    #[test]
    fn bytes_do_not_depend_on_the_number_of_threads() {
        let pixels = picture(64, 100);
        let with = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| encode(&pixels, &options(Recipe::Other(&Ablation::Colors))).unwrap().bytes)
        };
        assert!(with(1) == with(2));
    }

    #[test]
    fn a_time_budget_ends_the_fit() {
        let mut options = options(Recipe::Other(&Ablation::Colors));
        options.effort = 9;
        options.time = Some(std::time::Duration::from_millis(300));
        let encoded = encode(&picture(400, 300), &options).unwrap();
        assert!(encoded.bytes.len() <= 600 && encoded.report.psnr.is_finite());
    }

    #[test]
    fn another_method_is_tuned_to_squared_error_and_works_neither_in_tiles_nor_on_a_gpu() {
        let mut options = options(Recipe::Other(&Ablation::Colors));
        assert_eq!(options.favoured(), Tune::Psnr);
        options.tiles = Some(128);
        let refused = encode(&picture(200, 32), &options).unwrap_err();
        assert!(refused.to_string().contains("another method"), "{refused}");
        options.tiles = None;
        options.backend = Backend::Gpu;
        assert!(encode(&picture(32, 32), &options).is_err());
    }
}
