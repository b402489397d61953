//! Tests of the fit on stiff and extreme cases: gradients compared with f64, the state after every iteration, learning
//! rates, long runs, and the condition number of a joint solve of the colours. Prints rows for the table of `ssplat-lab
//! report --stability`.

// Shared with the end-to-end tests.
#[path = "../stiff/mod.rs"]
mod stiff;

use super::engine::Unwatched;
use super::engine::{Snapshot, Watcher};
use super::fit_on_cpu;
use super::job::Job;
use super::model::adam::Bounds;
use super::model::drawing::field::{Field, Output, float_error, squared_error};
use super::model::drawing::project::{self, Primitive, Projected};
use super::model::objective::planes::Planes;
use super::model::objective::rows::RowSet;
use super::model::problem::{Problem, Scene};
use super::plan::Plan;
use super::schedule::RATES;
use super::state::State;
use crate::constants::fit;
use crate::depth::Depth;
use crate::effort::EffortSettings;
use crate::error::Result;
use crate::gaussian::{Blend, Channels, Gaussians};
use crate::pixels::Pixels;
use crate::raster::reference;
use crate::target::Target as EncodeTarget;
use stiff::{Bound, Row};

const BLENDS: [Blend; 2] = [Blend::Normalized, Blend::Sum];

fn check(rows: &[Row]) {
    rows.iter().for_each(|r| println!("{}", r.line()));
    let failed: Vec<_> = rows.iter().filter(|r| !r.holds()).collect();
    assert!(failed.is_empty(), "{failed:#?}");
}

fn row(group: &str, case: String, worst: f64, bound: Bound, guard: &str) -> Row {
    Row { group: group.into(), case, worst, bound, guard: guard.into() }
}

/// Returns a picture of a few waves. The opacity, if there is one, is at least one half.
fn waves(width: u32, height: u32, channels: Channels) -> Pixels {
    let value = |x: u32, y: u32, k: usize| {
        let v = 0.5 + 0.4 * (f64::from(x * (k as u32 + 1) + 2 * y) / 6.0).sin();
        if channels.alpha() == Some(k) { 0.5 + 0.5 * v } else { v }
    };
    stiff::picture(width, height, channels, value)
}

fn scene(pixels: &Pixels, blend: Blend, background: [f32; 4]) -> Scene {
    Scene { width: pixels.width(), height: pixels.height(), blend, background }
}

/// Half the squared error to which the gradients belong, in f64 and without the clamp. The gradient passes through the
/// clamp unchanged, and the test points are within its range. Opacity weights the errors of colours.
fn loss(scene: &Scene, pixels: &Pixels, primitives: &[Exact]) -> f64 {
    let channels = pixels.channels();
    let count = channels.count();
    let mut sum = 0.0;
    for y in 0..scene.height {
        for x in 0..scene.width {
            let v = color(scene, primitives, f64::from(x) + 0.5, f64::from(y) + 0.5);
            let first = (y * scene.width + x) as usize * count;
            let opacity = channels.alpha().map_or(1.0, |a| f64::from(pixels.value(first + a)));
            for k in 0..count {
                let weight = if channels.alpha() == Some(k) { 1.0 } else { opacity };
                let weight = weight * f64::from(CHANNEL_AMPLITUDE[k]).powi(2);
                sum += 0.5 * weight * (v[k] - f64::from(pixels.value(first + k))).powi(2);
            }
        }
    }
    sum
}

/// Factors of the errors in each channel, all different.
const CHANNEL_AMPLITUDE: [f32; 4] = [0.9, 1.3, 0.6, 1.1];

/// A primitive in f64: mean, logarithms of the scales, rotation, colour.
type Exact = [f64; 9];

fn exact(p: &Primitive) -> Exact {
    let [x, y] = p.mean.map(f64::from);
    let [a, b] = p.log_scale.map(f64::from);
    let c = p.color.map(f64::from);
    [x, y, a, b, f64::from(p.rotation), c[0], c[1], c[2], c[3]]
}

fn color(scene: &Scene, primitives: &[Exact], x: f64, y: f64) -> [f64; 4] {
    let edge = (-0.5 * f64::from(crate::gaussian::CUTOFF).powi(2)).exp();
    let (mut sum, mut total) = ([0.0; 4], 0.0);
    for p in primitives {
        let (sin, cos) = p[4].sin_cos();
        let (dx, dy) = (x - p[0], y - p[1]);
        let (u, v) = ((dx * cos + dy * sin) / p[2].exp(), (dy * cos - dx * sin) / p[3].exp());
        let w = ((-0.5 * (u * u + v * v)).exp() - edge).max(0.0);
        total += w;
        (0..4).for_each(|k| sum[k] += w * p[5 + k]);
    }
    let (epsilon, b) = (f64::from(crate::gaussian::EPSILON), scene.background.map(f64::from));
    std::array::from_fn(|k| match scene.blend {
        Blend::Normalized => (sum[k] + epsilon * b[k]) / (total + epsilon),
        Blend::Sum => b[k] + sum[k],
    })
}

/// Returns `p`, moved by `step` along parameter `j` of its whitened frame.
fn moved(p: &Exact, j: usize, step: f64) -> Exact {
    let mut p = *p;
    let (sin, cos) = p[4].sin_cos();
    match j {
        0 => (p[0], p[1]) = (p[0] + cos * step * p[2].exp(), p[1] + sin * step * p[2].exp()),
        1 => (p[0], p[1]) = (p[0] - sin * step * p[3].exp(), p[1] + cos * step * p[3].exp()),
        _ => p[j] += step,
    }
    p
}

/// Returns the worst error of each kind of parameter (mean, scales, rotation, colour), relative to the largest gradient
/// in the same units.
fn gradient_errors(scene: &Scene, pixels: &Pixels, primitives: &[Primitive]) -> [f64; 4] {
    const STEP: f64 = 1e-4;
    const KINDS: [usize; 9] = [0, 0, 1, 1, 2, 3, 3, 3, 3];
    let mut target = Planes::new(pixels);
    target.channel_amplitude = CHANNEL_AMPLITUDE;
    let count = target.channels.count();
    let projected = project::all(primitives, scene.height);
    let mut field = Field::default();
    field.draw(&Problem { scene: *scene, target: &target }, &projected, RowSet::ALL, Output::Gradient);
    let exacts: Vec<Exact> = primitives.iter().map(exact).collect();
    let (mut errors, mut largest) = ([0.0f64; 4], [1e-6f64; 4]);
    for (i, (p, q)) in primitives.iter().zip(&projected).enumerate() {
        let g = gathered(&field, scene.width, (i, q), p, count);
        for j in 0..5 + count {
            let at = |step: f64| {
                let mut all = exacts.clone();
                all[i] = moved(&exacts[i], j, step);
                loss(scene, pixels, &all)
            };
            let want = (at(STEP) - at(-STEP)) / (2.0 * STEP);
            let error = (f64::from(g[j]) - want).abs();
            errors[KINDS[j]] = if error.is_nan() { f64::INFINITY } else { errors[KINDS[j]].max(error) };
            largest[KINDS[j]] = largest[KINDS[j]].max(want.abs());
        }
    }
    // Gradients of mean, scales and rotation have the same units, so any one of them may be close to 0.
    let shape = largest[0].max(largest[1]).max(largest[2]);
    std::array::from_fn(|k| errors[k] / if k < 3 { shape } else { largest[k] })
}

fn gathered(field: &Field, width: u32, (i, q): (usize, &Projected), p: &Primitive, count: usize) -> [f32; 9] {
    let g = field.gather(count, RowSet::ALL, width, (i, &[*q]), &[*p])[0];
    let [c0, c1, c2, c3] = g.color;
    [g.mean[0], g.mean[1], g.log_scale[0], g.log_scale[1], g.rotation, c0, c1, c2, c3]
}

fn primitive(mean: [f32; 2], scale: [f32; 2], rotation: f32, level: f32) -> Primitive {
    // Sums of a few such colours on the background stay between black and white.
    let color = [0.10, 0.14, 0.06, 0.08].map(|c| c * level);
    Primitive { mean, log_scale: scale.map(f32::ln), rotation, color }
}

#[test]
fn gradients_match_f64_finite_differences_at_ordinary_and_stiff_points() {
    let ordinary = vec![
        primitive([9.3, 8.1], [4.0, 2.5], 0.4, 1.0),
        primitive([22.7, 12.4], [3.1, 5.2], 1.3, -0.5),
        primitive([15.2, 20.9], [6.0, 2.0], 2.6, 0.7),
        primitive([30.1, 5.5], [2.2, 2.0], 0.1, 0.9),
    ];
    let points: [(&str, Vec<Primitive>, f64); 8] = [
        ("ordinary", ordinary, 1e-4),
        (
            "smallest scales, 0.3 px",
            vec![primitive([10.5, 10.5], [0.3, 0.3], 0.0, 1.0), primitive([20.0, 12.0], [0.3, 0.4], 0.7, -0.6)],
            1e-4,
        ),
        (
            "needles, 100 : 1",
            vec![primitive([16.2, 13.1], [30.0, 0.3], 0.61, 1.0), primitive([12.4, 15.3], [0.4, 40.0], 0.2, -0.5)],
            2e-3,
        ),
        (
            "needles along the axes",
            vec![
                primitive([16.5, 13.5], [40.0, 0.4], 0.0, 1.0),
                primitive([16.5, 13.5], [40.0, 0.4], std::f32::consts::FRAC_PI_2, 0.7),
            ],
            2e-3,
        ),
        ("wider than the picture by 30", vec![primitive([16.0, 13.0], [1000.0, 900.0], 0.3, 1.0)], 2e-3),
        ("coincident", vec![primitive([16.2, 12.7], [5.0, 3.0], 0.5, 0.4); 5], 1e-4),
        (
            "centres on the picture's corners",
            vec![primitive([0.0, 0.0], [6.0, 4.0], 0.5, 1.0), primitive([32.0, 27.0], [5.0, 5.0], 0.0, -0.5)],
            1e-4,
        ),
        ("barely covered pixels", vec![primitive([16.1, 13.2], [2.0, 1.5], 0.9, 1.0)], 1e-4),
    ];
    let mut rows = Vec::new();
    for (name, primitives, tolerance) in points {
        let mut worst = [0.0f64; 4];
        for blend in BLENDS {
            // Averages may lie anywhere between black and white, sums only near the background.
            let primitives: Vec<Primitive> = match blend {
                Blend::Normalized => {
                    primitives.iter().map(|p| Primitive { color: p.color.map(|c| 0.5 + 3.0 * c), ..*p }).collect()
                }
                Blend::Sum => primitives.clone(),
            };
            for channels in [Channels::Grey, Channels::GreyAlpha, Channels::Rgb, Channels::Rgba] {
                let pixels = waves(32, 27, channels);
                let scene = scene(&pixels, blend, [0.45, 0.5, 0.4, 0.6]);
                let errors = gradient_errors(&scene, &pixels, &primitives);
                (0..4).for_each(|k| worst[k] = worst[k].max(errors[k]));
            }
        }
        for (k, kind) in ["mean", "scales", "rotation", "colour"].into_iter().enumerate() {
            let guard = "analytic, in each one's own frame; no clamp in the way";
            rows.push(row("gradient", format!("{name}: {kind}"), worst[k], Bound::Relative(tolerance), guard));
        }
    }
    check(&rows);
}

fn is_finite(projected: &[Projected]) -> bool {
    projected.iter().all(|p| {
        let all = p.center.iter().chain(&p.conic).chain(&p.color).chain([&p.shear, &p.rest, &p.inv_a]);
        all.copied().all(f32::is_finite)
    })
}

fn decibels(error: f64, pixels: &Pixels) -> f64 {
    let samples = f64::from(pixels.width()) * f64::from(pixels.height()) * pixels.channels().count() as f64;
    (-10.0 * (error / samples).log10()).min(99.0)
}

/// Quality gained and kept by a fit, in decibels. NaN if any state was not finite.
struct Watched {
    /// Final quality relative to a picture of the mean colour.
    gain: f64,
    /// Final quality relative to the best state since whole rows are used. Differences that rounding to code values
    /// hides do not count.
    kept: f64,
}

/// Inspects every iteration.
struct Every {
    pixels: Pixels,
    finite: bool,
    best: f64,
}

impl Watcher for Every {
    fn step(&mut self, done: f32, now: &mut dyn Snapshot) -> Result<()> {
        self.finite &= is_finite(&now.drawing()?.1);
        if done >= fit::SAMPLED_UNTIL {
            self.best = self.best.max(decibels(now.error()?, &self.pixels));
        }
        Ok(())
    }

    fn recount(&mut self, primitives: &[Primitive]) -> Result<usize> {
        Ok(primitives.len())
    }
}

/// Fits and inspects every iteration.
fn watched(pixels: &Pixels, blend: Blend, count: usize, plan: &Plan) -> Watched {
    let target = Planes::new(pixels);
    let problem = Problem { scene: scene(pixels, blend, target.mean), target: &target };
    let constant = decibels(squared_error(&problem, &[]), pixels);
    let mut every = Every { pixels: pixels.clone(), finite: true, best: f64::NEG_INFINITY };
    let state = fit_on_cpu(&Job { problem, count, plan }, &mut every).expect("the watcher never stops the fit").by;
    let Every { finite, best, .. } = every;
    let end = decibels(float_error(&problem, &state.primitives), pixels);
    let known = |v: f64| if finite { v } else { f64::NAN };
    // A fit may end before that point.
    let best = if best.is_finite() { best } else { end };
    let shown = |v: f64| v.min(-10.0 * pixels.depth().rounding_error().log10());
    Watched { gain: known(end - constant), kept: known(shown(end) - shown(best)) }
}

/// Returns the smaller value, or NaN if either is NaN.
fn worse(a: f64, b: f64) -> f64 {
    if a.is_nan() || b.is_nan() { f64::NAN } else { a.min(b) }
}

fn short(iterations: u32) -> Plan {
    Plan { iterations, ..Plan::new(&EffortSettings::from_preset(2).fit, 5500, 0, None, 1) }
}

#[test]
fn every_iteration_of_every_extreme_fit_is_finite_and_the_best_state_is_kept() {
    let mut rows = Vec::new();
    for case in stiff::fits() {
        // The large cases are fitted completely elsewhere. Here, a few iterations execute the same code.
        let large = u64::from(case.pixels.width()) * u64::from(case.pixels.height()) > 1 << 20;
        let count = match case.target {
            EncodeTarget::Gaussians(n) => n as usize,
            _ if large => 8,
            _ => 40,
        };
        let plan = if large { short(4) } else { Plan::new(&EffortSettings::from_preset(2).fit, count, 0, None, 1) };
        let worst = BLENDS.map(|b| watched(&case.pixels, b, count, &plan).kept).into_iter().fold(f64::INFINITY, worse);
        let guard = "log-scales, bounded aspect, ε, gradients that are not finite count as 0; best state kept";
        rows.push(row("every iteration", case.name, worst, Bound::Gain(-0.1), guard));
    }
    check(&rows);
}

#[test]
fn learning_rates_ten_times_off_stay_finite_and_beat_a_constant() {
    let pixels = waves(64, 64, Channels::Rgb);
    let mut rows = Vec::new();
    for blend in BLENDS {
        for rate in [0.1, 1.0, 10.0] {
            let plan = Plan { rate, ..short(300) };
            let worst = watched(&pixels, blend, 60, &plan).gain;
            let guard = "steps in units of each one's own scales; bounds after every step";
            let case = format!("learning rates × {rate}, {blend:?}").to_lowercase();
            rows.push(row("rates", case, worst, Bound::Gain(0.0), guard));
        }
    }
    check(&rows);
}

#[test]
fn a_hundred_thousand_iterations_do_not_drift() {
    let pixels = waves(12, 11, Channels::Grey);
    let target = Planes::new(&pixels);
    let mut rows = Vec::new();
    for blend in BLENDS {
        let scene = scene(&pixels, blend, target.mean);
        let plan = short(500);
        let problem = Problem { scene, target: &target };
        let fitted = fit_on_cpu(&Job { problem, count: 6, plan: &plan }, &mut Unwatched);
        let mut state = State::new(fitted.expect("the watcher never stops the fit").by.primitives, Bounds::new(12, 11));
        let (mut early, mut late) = (0.0, 0.0);
        for i in 0..100_000 {
            let error = state.descend(&problem, RowSet::ALL, RATES.scaled(fit::LAST_RATE));
            assert!(error.is_finite(), "{i}");
            early += if i < 10_000 { error } else { 0.0 };
            late += if i >= 90_000 { error } else { 0.0 };
        }
        // These are means: the steps do not shrink, so the error of a single iteration is noisy.
        let worst = 10.0 * f64::log10(early / late);
        let case = format!("100 000 iterations at the last rate, {blend:?}").to_lowercase();
        rows.push(row("long run", case, worst, Bound::Gain(-0.2), "second moments forget; no state but the moments"));
    }
    check(&rows);
}

/// Returns the ratio of the largest to the smallest eigenvalue of a positive semidefinite matrix, by Jacobi rotations.
fn condition(mut a: Vec<Vec<f64>>) -> f64 {
    let n = a.len();
    for _ in 0..60 {
        for p in 0..n {
            for q in p + 1..n {
                if a[p][q].abs() < 1e-300 {
                    continue;
                }
                let theta = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
                let t = theta.signum() / (theta.abs() + (theta * theta + 1.0).sqrt());
                let c = 1.0 / (t * t + 1.0).sqrt();
                let s = t * c;
                for k in 0..n {
                    (a[k][p], a[k][q]) = (c * a[k][p] - s * a[k][q], s * a[k][p] + c * a[k][q]);
                }
                for k in 0..n {
                    (a[p][k], a[q][k]) = (c * a[p][k] - s * a[q][k], s * a[p][k] + c * a[q][k]);
                }
            }
        }
    }
    let values = || (0..n).map(|i| a[i][i].abs());
    values().fold(0.0, f64::max) / values().fold(f64::INFINITY, f64::min).max(f64::MIN_POSITIVE)
}

#[test]
fn a_singular_joint_colour_solve_does_not_affect_the_fit() {
    let pixels = waves(32, 27, Channels::Grey);
    let mut rows = Vec::new();
    let mut add = |name: &str, blend: Blend, primitives: &[Primitive]| {
        let gaussians: Vec<_> = primitives.iter().map(|p| p.to_gaussian()).collect();
        let n = gaussians.len();
        let mut normal = vec![vec![0.0; n]; n];
        let picture = Gaussians {
            width: 32,
            height: 27,
            channels: Channels::Grey,
            depth: Depth::Eight,
            blend,
            background: [0.0; 4],
            list: gaussians,
        };
        for i in 0..32 * 27 {
            let (x, y) = (f64::from(i % 32) + 0.5, f64::from(i / 32) + 0.5);
            let w: Vec<f64> = picture.list.iter().map(|g| reference::weight(g, x, y)).collect();
            let total = match blend {
                Blend::Normalized => w.iter().sum::<f64>() + f64::from(crate::gaussian::EPSILON),
                Blend::Sum => 1.0,
            };
            for a in 0..n {
                for b in 0..n {
                    normal[a][b] += w[a] * w[b] / (total * total);
                }
            }
        }
        let case = format!("{name}, {blend:?}").to_lowercase();
        let guard = "colours are found one primitive at a time: no system is solved";
        rows.push(row("condition of the colours", case, condition(normal), Bound::Reported, guard));
    };
    let target = Planes::new(&pixels);
    for blend in BLENDS {
        let problem = Problem { scene: scene(&pixels, blend, target.mean), target: &target };
        for (name, count) in [("12 fitted", 12), ("60 fitted, crowded", 60)] {
            let fitted = fit_on_cpu(&Job { problem, count, plan: &short(120) }, &mut Unwatched);
            add(name, blend, &fitted.expect("the watcher never stops the fit").by.primitives);
        }
        let coincident = vec![primitive([16.0, 13.0], [5.0, 3.0], 0.4, 1.0); 3];
        add("3 coincident", blend, &coincident);
    }
    check(&rows);
    // A singular system still gives a fit.
    for blend in BLENDS {
        let mut state = State::new(vec![primitive([16.0, 13.0], [5.0, 3.0], 0.4, 1.0); 3], Bounds::new(32, 27));
        let problem = Problem { scene: scene(&pixels, blend, target.mean), target: &target };
        let errors: Vec<f64> = (0..200).map(|_| state.descend(&problem, RowSet::ALL, RATES.scaled(0.2))).collect();
        assert!(errors.iter().all(|e| e.is_finite()) && errors[199] < errors[0]);
    }
}
