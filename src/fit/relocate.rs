//! Moving the least useful primitives to where the error is largest.

use crate::fit::adam::Memory;
use crate::fit::field::{Field, Output, RowSet, Scene};
use crate::fit::kernel::{self, LANES, RowExponent};
use crate::fit::project::{Primitive, Projected};
use crate::fit::sample::blur;
use crate::fit::target::Target;
use crate::fit::{State, project_all};
use crate::gaussian::{Blend, CUTOFF_WEIGHT};
use crate::parallel;

/// A place where a new primitive would help most.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Peak {
    pub mean: [f32; 2],
    pub scale: f32,
    /// Estimated drop of the squared error.
    pub gain: f32,
    /// Mean residual (target − picture) there, doubled as the peak of a Gaussian of that size.
    pub residual: [f32; 4],
}

/// The rise of the squared error when each primitive is removed, estimated without refitting the others.
///
/// `field` holds [`Output::Picture`] over `rows`; the sums are scaled up by the rows left out.
pub(crate) fn removal_costs(
    scene: &Scene,
    target: &Target,
    field: &Field,
    rows: RowSet,
    projected: &[Projected],
) -> Vec<f32> {
    const CHUNK: usize = 64;
    let arch = pulp::Arch::new();
    let chunks = projected.len().div_ceil(CHUNK);
    parallel::map(chunks, |chunk| {
        let projected = &projected[chunk * CHUNK..projected.len().min((chunk + 1) * CHUNK)];
        match target.channels.count() {
            1 => arch.dispatch(CostTask::<1> { scene, target, field, rows, projected }),
            2 => arch.dispatch(CostTask::<2> { scene, target, field, rows, projected }),
            3 => arch.dispatch(CostTask::<3> { scene, target, field, rows, projected }),
            _ => arch.dispatch(CostTask::<4> { scene, target, field, rows, projected }),
        }
    })
    .concat()
}

/// The costs of a run of primitives; a struct so that `inline(always)` carries the dispatched instruction set inside.
struct CostTask<'a, const C: usize> {
    scene: &'a Scene,
    target: &'a Target,
    field: &'a Field,
    rows: RowSet,
    projected: &'a [Projected],
}

impl<const C: usize> pulp::WithSimd for CostTask<'_, C> {
    type Output = Vec<f32>;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) -> Vec<f32> {
        let mut out = Vec::with_capacity(self.projected.len());
        for p in self.projected {
            out.push(removal_cost::<C>(self.scene, self.target, self.field, self.rows, p));
        }
        out
    }
}

#[inline(always)]
fn removal_cost<const C: usize>(scene: &Scene, target: &Target, field: &Field, rows: RowSet, p: &Projected) -> f32 {
    let stride = field.stride;
    let mut sum = [0.0f32; LANES];
    for index in rows.index(p.rows[0])..rows.index(p.rows[1]) {
        let Some((first, end, dy)) = p.span(rows.row(index), scene.width) else { continue };
        let row = field.row(index, C);
        let exponent = RowExponent::new(p, dy);
        let amplitude = target.amplitude(rows.row(index));
        let mut x = first;
        while x < end {
            let (_, e) = exponent.at(x);
            // Lanes beyond the picture's edge have no sums to be compared with.
            let inside = end - x;
            let w = kernel::lanes(|i| if e[i] > CUTOFF_WEIGHT && i < inside { e[i] - CUTOFF_WEIGHT } else { 0.0 });
            let mut distance = [0.0f32; LANES];
            let mut share = match scene.blend {
                Blend::Normalized => {
                    let all = kernel::load(row, C * stride + x);
                    kernel::lanes(|i| (w[i] / ((all[i] - w[i]).max(0.0) + 0.02)).min(20.0))
                }
                Blend::Sum => w,
            };
            if let Some(a) = amplitude {
                let a = kernel::load(a, x);
                share = kernel::lanes(|i| share[i] * a[i]);
            }
            for k in 0..C {
                match scene.blend {
                    Blend::Normalized => {
                        let v = kernel::load(row, k * stride + x);
                        let d = kernel::lanes(|i| p.color[k] - v[i]);
                        distance = kernel::lanes(|i| distance[i] + d[i] * d[i]);
                    }
                    Blend::Sum => {
                        distance = kernel::lanes(|i| distance[i] + p.color[k] * p.color[k]);
                    }
                }
            }
            sum = kernel::lanes(|i| sum[i] + share[i] * share[i] * distance[i]);
            x += LANES;
        }
    }
    kernel::total(&sum) * rows.step as f32
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

/// Largest blurred residuals at several scales, best first, at most `count`, for a picture of `among` primitives.
pub(crate) fn peaks(
    scene: &Scene,
    target: &Target,
    field: &Field,
    rows: RowSet,
    count: usize,
    among: usize,
) -> Vec<Peak> {
    let channels = target.channels.count();
    let spacing = spacing(scene, count, among);
    // Work on cells of `rows.step` pixels: the field has no more rows than that.
    let cell = rows.step as usize;
    let (mut w, mut h) = ((scene.width as usize).div_ceil(cell), rows.count(scene.height));
    let mut planes = residual(scene, target, field, rows, w, h);
    let mut size = cell as f32;
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
        let found = parallel::map(h, |y| {
            let mut out = Vec::new();
            for x in 0..w {
                let v = score[y * w + x];
                if v > 0.0 && is_peak(&score, w, h, x, y) {
                    out.push((x, y, v));
                }
            }
            out
        });
        for (x, y, v) in found.into_iter().flatten() {
            let mut residual = [0.0; 4];
            for k in 0..channels {
                residual[k] = 2.0 * planes[k][y * w + x];
            }
            let mean = [(x as f32 + 0.5) * size, (y as f32 + 0.5) * size];
            let gain = 4.0 * std::f32::consts::PI * variance * v;
            candidates.push((Peak { mean, scale: sigma, gain, residual }, level));
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

fn residual(scene: &Scene, target: &Target, field: &Field, rows: RowSet, w: usize, h: usize) -> Vec<Vec<f32>> {
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

fn halve(plane: &[f32], w: usize, h: usize) -> Vec<f32> {
    let (nw, nh) = (w.div_ceil(2), h.div_ceil(2));
    let mut out = vec![0.0; nw * nh];
    parallel::map_chunks(&mut out, nw, |y, row| {
        let (a, b) = (&plane[2 * y * w..][..w], &plane[(2 * y + 1).min(h - 1) * w..][..w]);
        for (x, o) in row.iter_mut().enumerate() {
            let (l, r) = (2 * x, (2 * x + 1).min(w - 1));
            *o = 0.25 * (a[l] + a[r] + b[l] + b[r]);
        }
    });
    out
}

/// Keeps the best peaks that are at least 1.5 of their own scales away from all better ones.
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
        let reach = 1.5 * p.scale;
        let (cx, cy) = place(p.mean);
        let r = (reach / CELL).ceil() as usize;
        let near = |q: &Peak| {
            let (dx, dy) = (q.mean[0] - p.mean[0], q.mean[1] - p.mean[1]);
            dx * dx + dy * dy < reach * reach
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

/// A round primitive at a peak.
pub(crate) fn at_peak(peak: &Peak, scene: &Scene, target: &Target) -> Primitive {
    let color = match scene.blend {
        Blend::Normalized => target.at(peak.mean),
        // The residual was weighted to find the peak.
        Blend::Sum => peak.residual.map(|r| r / target.amplitude_at(peak.mean)),
    };
    Primitive { mean: peak.mean, log_scale: [peak.scale.max(0.5).ln(); 2], rotation: 0.3, color }
}

/// Moves at most `count` primitives to peaks, as long as the estimated gain exceeds the removal cost. Returns how many.
pub(crate) fn relocate(scene: &Scene, target: &Target, state: &mut State, rows: RowSet, count: usize) -> usize {
    let costs = costs(scene, target, state, rows);
    let peaks = peaks(scene, target, &state.field, rows, count, state.primitives.len());
    let mut moved = 0;
    for (peak, i) in peaks.iter().zip(cheapest(&costs, count)) {
        if peak.gain < costs[i] {
            break;
        }
        state.primitives[i] = at_peak(peak, scene, target);
        state.memory[i] = Memory::default();
        moved += 1;
    }
    state.sort();
    moved
}

/// Brings the number of primitives to `wanted`, taking the cheapest away or adding at peaks.
pub(crate) fn resize(scene: &Scene, target: &Target, state: &mut State, rows: RowSet, wanted: usize) {
    let costs = costs(scene, target, state, rows);
    let have = state.primitives.len();
    if wanted < have {
        let mut keep = vec![true; have];
        for i in cheapest_first(&costs).into_iter().take(have - wanted) {
            keep[i] = false;
        }
        let mut kept = keep.iter();
        state.primitives.retain(|_| *kept.next().expect("one for each"));
        let mut kept = keep.iter();
        state.memory.retain(|_| *kept.next().expect("one for each"));
    } else {
        for peak in peaks(scene, target, &state.field, rows, wanted - have, wanted) {
            state.primitives.push(at_peak(&peak, scene, target));
            state.memory.push(Memory::default());
        }
    }
    state.sort();
}

/// Leaves the picture in the state's field.
fn costs(scene: &Scene, target: &Target, state: &mut State, rows: RowSet) -> Vec<f32> {
    let projected = project_all(&state.primitives, scene.height);
    state.field.draw(scene, target, &projected, rows, Output::Picture);
    removal_costs(scene, target, &state.field, rows, &projected)
}

/// Indices by rising cost; equal costs by index.
pub(crate) fn cheapest_first(costs: &[f32]) -> Vec<usize> {
    cheapest(costs, costs.len())
}

/// The first `most` of them.
pub(crate) fn cheapest(costs: &[f32], most: usize) -> Vec<usize> {
    let mut order: Vec<usize> = (0..costs.len()).collect();
    let by_cost = |a: &usize, b: &usize| costs[*a].total_cmp(&costs[*b]).then(a.cmp(b));
    if most < order.len() {
        order.select_nth_unstable_by(most, by_cost);
        order.truncate(most);
    }
    order.sort_unstable_by(by_cost);
    order
}
