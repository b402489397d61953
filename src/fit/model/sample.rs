//! Where the fit starts: primitives spread by local detail along a Hilbert curve.

use rand::RngExt;
use rand_pcg::Pcg64Mcg;

use crate::fit::model::planes::Planes;
use crate::fit::model::project::Primitive;
use crate::parallel;

/// Share of the primitives that follow detail; the rest is spread evenly.
const DETAIL: f64 = 0.8;
/// Initial scales in units of `1/√(π·density)`.
const SPREAD: f32 = 0.7;

/// `count` round primitives whose density follows the square root of the blurred gradient.
pub(crate) fn by_detail(target: &Planes, count: usize, rng: &mut Pcg64Mcg) -> Vec<Primitive> {
    let area = f64::from(target.width) * f64::from(target.height);
    // Cells well below the mean distance of primitives, so that a stratum rarely shares one.
    let spacing = (area / count.max(1) as f64).sqrt();
    let cell = (spacing / 4.0).clamp(1.0, 64.0) as u32;
    let (cols, rows) = (target.width.div_ceil(cell), target.height.div_ceil(cell));
    let mut density = blur(&detail(target, cell, cols, rows), cols as usize, rows as usize);
    for d in &mut density {
        *d = d.max(1e-6).sqrt();
    }
    let total: f64 = density.iter().map(|&d| f64::from(d)).sum();
    let even = (1.0 - DETAIL) / density.len() as f64;
    let scaled: Vec<f64> = density.iter().map(|&d| f64::from(d) / total * DETAIL + even).collect();

    let order = cols.max(rows).next_power_of_two().trailing_zeros();
    let mut cells: Vec<(u64, u32)> = (0..cols * rows).map(|i| (hilbert_index(order, i % cols, i / cols), i)).collect();
    cells.sort_unstable();

    let mut out = Vec::with_capacity(count);
    let mut sum = 0.0;
    for &(_, i) in &cells {
        let share = scaled[i as usize] * count as f64;
        let before = sum;
        sum += share;
        // One primitive whenever the cumulated density passes the middle of its stratum.
        while out.len() < count && (out.len() as f64 + 0.5) < sum {
            debug_assert!(before <= out.len() as f64 + 0.5 || share > 1.0);
            let jitter: [f32; 2] = [rng.random(), rng.random()];
            let x = ((i % cols) as f32 + jitter[0]) * cell as f32;
            let y = ((i / cols) as f32 + jitter[1]) * cell as f32;
            let mean = [x.min(target.width as f32), y.min(target.height as f32)];
            let per_pixel = share as f32 / (cell * cell) as f32;
            let scale = (SPREAD / (std::f32::consts::PI * per_pixel).sqrt()).max(0.4).ln();
            let rotation = rng.random::<f32>() * std::f32::consts::PI;
            out.push(Primitive { mean, log_scale: [scale; 2], rotation, color: target.at(mean) });
        }
    }
    // Rounding may leave the last stratum open.
    while out.len() < count {
        let mean = [rng.random::<f32>() * target.width as f32, rng.random::<f32>() * target.height as f32];
        let scale = (SPREAD * spacing as f32 / std::f32::consts::PI.sqrt()).max(0.4).ln();
        out.push(Primitive { mean, log_scale: [scale; 2], rotation: 0.0, color: target.at(mean) });
    }
    out
}

/// Mean magnitude of the colour gradient in each cell.
fn detail(target: &Planes, cell: u32, cols: u32, rows: u32) -> Vec<f32> {
    let (w, stride, count) = (target.width, target.stride, target.channels.count());
    parallel::map(rows as usize, |r| {
        let mut sums = vec![0.0f32; cols as usize];
        let first = r as u32 * cell;
        let last = (first + cell).min(target.height);
        for y in first..last {
            let (row, below) = (target.row(y), target.row((y + 1).min(target.height - 1)));
            for x in 0..w as usize {
                let next = (x + 1).min(w as usize - 1);
                let mut g = 0.0;
                for k in 0..count {
                    let v = row[k * stride + x];
                    let (dx, dy) = (row[k * stride + next] - v, below[k * stride + x] - v);
                    g += dx * dx + dy * dy;
                }
                sums[x / cell as usize] += g.sqrt();
            }
        }
        sums
    })
    .concat()
}

/// Binomial blur (1 4 6 4 1)/16 in both directions, borders repeated.
pub(crate) fn blur(plane: &[f32], width: usize, height: usize) -> Vec<f32> {
    const TAPS: [f32; 5] = [0.0625, 0.25, 0.375, 0.25, 0.0625];
    let mut across = vec![0.0; plane.len()];
    parallel::map_chunks(&mut across, width, |y, out| {
        let row = &plane[y * width..][..width];
        for x in 0..width {
            out[x] = if x >= 2 && x + 2 < width {
                let r: &[f32; 5] = row[x - 2..x + 3].try_into().expect("five long");
                TAPS[0] * (r[0] + r[4]) + TAPS[1] * (r[1] + r[3]) + TAPS[2] * r[2]
            } else {
                (0..5).map(|t| TAPS[t] * row[(x + t).saturating_sub(2).min(width - 1)]).sum()
            };
        }
    });
    let mut out = vec![0.0; plane.len()];
    parallel::map_chunks(&mut out, width, |y, out| {
        let rows: [&[f32]; 5] =
            std::array::from_fn(|t| &across[(y + t).saturating_sub(2).min(height - 1) * width..][..width]);
        for x in 0..width {
            out[x] = TAPS[0] * (rows[0][x] + rows[4][x]) + TAPS[1] * (rows[1][x] + rows[3][x]) + TAPS[2] * rows[2][x];
        }
    });
    out
}

/// Means of 2 × 2 values, borders repeated.
pub(crate) fn halve(plane: &[f32], w: usize, h: usize) -> Vec<f32> {
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

/// Position of `(x, y)` along the Hilbert curve over a square of side `2^order`.
pub(crate) fn hilbert_index(order: u32, mut x: u32, mut y: u32) -> u64 {
    let mut index = 0u64;
    for level in (0..order).rev() {
        let (rx, ry) = (x >> level & 1, y >> level & 1);
        index = index << 2 | u64::from(3 * rx ^ ry);
        // Turn the quadrant so that the curve enters and leaves at the right corners.
        if ry == 0 {
            if rx == 1 {
                let mask = (1u32 << level) - 1;
                (x, y) = (!x & mask, !y & mask);
            }
            std::mem::swap(&mut x, &mut y);
        }
    }
    index
}
