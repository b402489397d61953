//! Where the error is largest, and what shape a new primitive should have there.

use crate::fit::model::field::Field;
use crate::fit::model::problem::{Problem, Scene};
use crate::fit::model::project::Primitive;
use crate::fit::model::ridge::{self, Shape};
use crate::fit::model::rows::RowSet;
use crate::fit::model::sample::{blur, halve};
use crate::gaussian::Blend;
use crate::parallel;

/// A place where a new primitive would help most.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Peak {
    pub mean: [f32; 2],
    /// Standard deviations along and across `rotation`, pixels.
    pub scale: [f32; 2],
    /// Direction of the first, radians.
    pub rotation: f32,
    /// Estimated drop of the squared error.
    pub gain: f32,
    /// Mean residual (target − picture) there, doubled as the peak of a Gaussian of that size.
    pub residual: [f32; 4],
}

impl Peak {
    /// A peak at `mean`, pixels, of a residual that is blurred by `sigma` pixels.
    pub(crate) fn new(mean: [f32; 2], sigma: f32, shape: &Shape) -> Self {
        Peak {
            mean,
            scale: [sigma * shape.aspect, sigma],
            rotation: shape.rotation,
            gain: 4.0 * std::f32::consts::PI * sigma * sigma * shape.score,
            residual: shape.residual.map(|r| 2.0 * r),
        }
    }
}

/// Scale of the largest new primitives, pixels, when `count` are looked for in a picture of `among`.
pub(crate) fn spacing(scene: &Scene, count: usize, among: usize) -> f32 {
    // Where the blend divides by the weights, a primitive larger than those around it would smear what they draw.
    let crowd = match scene.blend {
        Blend::Normalized => among,
        Blend::Sum => count,
    };
    (scene.width as f32 * scene.height as f32 / (std::f32::consts::PI * crowd.max(1) as f32)).sqrt()
}

/// The places where new primitives would help most, best first, at most `count`, for a picture of `among` primitives:
/// peaks of the residual blurred at several scales, and where one is part of a ridge, an elongated peak along it.
pub(crate) fn peaks(problem: &Problem<'_>, field: &Field, rows: RowSet, count: usize, among: usize) -> Vec<Peak> {
    let scene = &problem.scene;
    let spacing = spacing(scene, count, among);
    // Work on cells of `rows.step` pixels: the field has no more rows than that.
    let cell = rows.step as usize;
    let (mut w, mut h) = ((scene.width as usize).div_ceil(cell), rows.count(scene.height));
    let mut planes = residual(problem, field, rows, w, h);
    let mut size = cell as f32;
    let ridges = ridge::all();
    let mut bar = Bar { count, gains: Vec::new() };
    let mut candidates: Vec<(Peak, u32)> = Vec::new();
    // Variance of the blur so far, in pixels².
    let mut variance = 0.0f32;
    for level in 0..12u32 {
        let passes = if level == 0 { 2 } else { 1 };
        for plane in &mut planes {
            for _ in 0..passes {
                *plane = blur(plane, w, h);
            }
        }
        variance += passes as f32 * size * size;
        let sigma = variance.sqrt();
        if level > 0 && sigma > spacing {
            break;
        }
        let score: Vec<f32> = (0..w * h).map(|i| planes.iter().map(|p| p[i] * p[i]).sum()).collect();
        let tops: Vec<(usize, usize)> = parallel::map(h, |y| {
            let is_top = |x: &usize| score[y * w + x] > 0.0 && is_peak(&score, w, h, *x, y);
            (0..w).filter(is_top).map(|x| (x, y)).collect::<Vec<_>>()
        })
        .concat();
        let gain_of = |score: f32| 4.0 * std::f32::consts::PI * variance * score;
        let longest = ridge::longest(spacing, sigma);
        let least = bar.raised(tops.iter().map(|&(x, y)| gain_of(score[y * w + x]))) / longest;
        let tops: Vec<_> = tops.into_iter().filter(|&(x, y)| gain_of(score[y * w + x]) >= least).collect();
        let shapes =
            parallel::map(tops.len(), |i| vec![ridge::shape(&ridges, longest, &planes, [w, h], tops[i].into())])
                .concat();
        for ((x, y), shape) in tops.into_iter().zip(shapes) {
            let mean = [(x as f32 + 0.5) * size, (y as f32 + 0.5) * size];
            candidates.push((Peak::new(mean, sigma, &shape), level));
        }
        if w < 4 || h < 4 {
            break;
        }
        // Half the resolution; the box adds a quarter of a pixel² of variance at the finer size.
        let (nw, nh) = (w.div_ceil(2), h.div_ceil(2));
        for plane in &mut planes {
            *plane = halve(plane, w, h);
        }
        variance += 0.25 * size * size;
        (w, h, size) = (nw, nh, size * 2.0);
    }
    best(candidates, count, scene)
}

/// The least gain among the `count` largest so far: a bar that peaks need not be looked at far below.
struct Bar {
    count: usize,
    gains: Vec<f32>,
}

impl Bar {
    fn raised(&mut self, gains: impl Iterator<Item = f32>) -> f32 {
        self.gains.extend(gains);
        let Some(over) = self.gains.len().checked_sub(self.count).filter(|&over| over < self.gains.len()) else {
            return 0.0;
        };
        let least = *self.gains.select_nth_unstable_by(over, f32::total_cmp).1;
        self.gains.drain(..over);
        least
    }
}

/// The best `count` of candidates with their levels, none near a better one.
pub(crate) fn best(mut candidates: Vec<(Peak, u32)>, count: usize, scene: &Scene) -> Vec<Peak> {
    // Ties are broken by place, so that the order is defined.
    let order = |(a, la): &(Peak, u32), (b, lb): &(Peak, u32)| {
        b.gain
            .total_cmp(&a.gain)
            .then(la.cmp(lb))
            .then(a.mean[1].total_cmp(&b.mean[1]))
            .then(a.mean[0].total_cmp(&b.mean[0]))
    };
    // A large picture has many times as many candidates as are taken: the worst are seldom worth sorting.
    let part = (4 * count).max(1024);
    let (mut next, mut sorted) = (0, 0);
    let candidates = std::iter::from_fn(|| {
        if next == sorted {
            let rest = &mut candidates[sorted..];
            let part = part.min(rest.len());
            if part < rest.len() {
                rest.select_nth_unstable_by(part, order);
            }
            rest[..part].sort_unstable_by(order);
            sorted += part;
        }
        let (peak, _) = *candidates.get(next)?;
        next += 1;
        Some(peak)
    });
    spread(candidates, count, scene)
}

fn residual(problem: &Problem<'_>, field: &Field, rows: RowSet, w: usize, h: usize) -> Vec<Vec<f32>> {
    let Problem { scene, target } = *problem;
    let channels = target.channels.count();
    let cell = rows.step as usize;
    let share = 1.0 / cell as f32;
    (0..channels)
        .map(|k| {
            let mut plane = vec![0.0; w * h];
            parallel::map_chunks(&mut plane, w, |i, out| {
                let t = &target.row(rows.row(i))[k * target.stride..][..scene.width as usize];
                let v = &field.row(i, channels)[k * field.stride..][..scene.width as usize];
                let alpha = target.channels.alpha().filter(|&a| a != k);
                let opacity = alpha.map(|a| &target.row(rows.row(i))[a * target.stride..][..scene.width as usize]);
                let amplitude = target.amplitude(rows.row(i));
                for (x, (t, v)) in t.iter().zip(v).enumerate() {
                    let weight = opacity.map_or(share, |o| o[x] * share) * amplitude.map_or(1.0, |a| a[x]);
                    out[x / cell] += (t - v.clamp(0.0, 1.0)) * weight;
                }
            });
            plane
        })
        .collect()
}

fn is_peak(score: &[f32], w: usize, h: usize, x: usize, y: usize) -> bool {
    let v = score[y * w + x];
    for ny in y.saturating_sub(1)..=(y + 1).min(h - 1) {
        for nx in x.saturating_sub(1)..=(x + 1).min(w - 1) {
            let o = score[ny * w + nx];
            if o > v || (o == v && (ny, nx) < (y, x)) {
                return false;
            }
        }
    }
    true
}

/// Keeps the best peaks that are at least 1.5 of their own scales away from all better ones, in each direction.
fn spread(candidates: impl Iterator<Item = Peak>, count: usize, scene: &Scene) -> Vec<Peak> {
    const CELL: f32 = 8.0;
    const NONE: u32 = u32::MAX;
    let cols = (scene.width as f32 / CELL) as usize + 1;
    let rows = (scene.height as f32 / CELL) as usize + 1;
    // The peak taken last in each cell, and for each peak the one taken before it there.
    let mut last = vec![NONE; cols * rows];
    let mut before: Vec<u32> = Vec::new();
    let place = |m: [f32; 2]| (((m[0] / CELL) as usize).min(cols - 1), ((m[1] / CELL) as usize).min(rows - 1));
    let mut out: Vec<Peak> = Vec::new();
    for p in candidates {
        if out.len() >= count {
            break;
        }
        let reach = 1.5 * p.scale[0];
        let (sin, cos) = p.rotation.sin_cos();
        let (cx, cy) = place(p.mean);
        let r = (reach / CELL).ceil() as usize;
        let near = |q: &Peak| {
            let (dx, dy) = (q.mean[0] - p.mean[0], q.mean[1] - p.mean[1]);
            let (u, v) = ((cos * dx + sin * dy) / p.scale[0], (cos * dy - sin * dx) / p.scale[1]);
            u * u + v * v < 2.25
        };
        let taken = if (2 * r + 1) * (2 * r + 1) > out.len() {
            out.iter().any(near)
        } else {
            (cy.saturating_sub(r)..=(cy + r).min(rows - 1)).any(|y| {
                let cells = &last[y * cols..][cx.saturating_sub(r)..=(cx + r).min(cols - 1)];
                cells.iter().any(|&first| {
                    let mut i = first;
                    while i != NONE {
                        if near(&out[i as usize]) {
                            return true;
                        }
                        i = before[i as usize];
                    }
                    false
                })
            })
        };
        if !taken {
            let cell = &mut last[cy * cols + cx];
            before.push(std::mem::replace(cell, out.len() as u32));
            out.push(p);
        }
    }
    out
}

/// A primitive for a peak.
pub(crate) fn at_peak(peak: &Peak, problem: &Problem<'_>) -> Primitive {
    let Problem { scene, target } = *problem;
    let color = match scene.blend {
        Blend::Normalized => target.at(peak.mean),
        // The residual was weighted to find the peak.
        Blend::Sum => peak.residual.map(|r| r / target.amplitude_at(peak.mean)),
    };
    Primitive { mean: peak.mean, log_scale: peak.scale.map(|s| s.max(0.5).ln()), rotation: peak.rotation, color }
}
