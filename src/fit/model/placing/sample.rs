//! Initial placement: primitives distributed by local detail along a Hilbert curve.

use rand::RngExt;
use rand_pcg::Pcg64Mcg;

use crate::constants::fit;
use crate::fit::model::drawing::project::Primitive;
use crate::fit::model::objective::blur::blur;
use crate::fit::model::objective::planes::Planes;
use crate::parallel;
use crate::strict_math::StrictMath;

/// Returns `count` primitives, stretched along edges. Their density follows the square root of the blurred gradient.
pub(crate) fn by_detail(target: &Planes, count: usize, rng: &mut Pcg64Mcg) -> Vec<Primitive> {
    let area = f64::from(target.width) * f64::from(target.height);
    // The cells are well below the mean distance of primitives, so that two of them rarely share one.
    let spacing = (area / count.max(1) as f64).sqrt();
    let cell = (spacing / 4.0).clamp(1.0, 64.0) as u32;
    let (cols, rows) = (target.width.div_ceil(cell), target.height.div_ceil(cell));
    let detail = Detail::new(target, cell, [cols, rows]);
    let density: Vec<f32> = detail.strength.iter().map(|d| d.max(1e-6).sqrt()).collect();
    let total: f64 = density.iter().map(|&d| f64::from(d)).sum();
    let even = (1.0 - fit::DETAIL_SHARE) / density.len() as f64;
    let scaled: Vec<f64> = density.iter().map(|&d| f64::from(d) / total * fit::DETAIL_SHARE + even).collect();

    let order = cols.max(rows).next_power_of_two().trailing_zeros();
    let mut cells: Vec<(u64, u32)> = (0..cols * rows).map(|i| (hilbert_index(order, i % cols, i / cols), i)).collect();
    cells.sort_unstable();

    let mut out = Vec::with_capacity(count);
    let mut sum = 0.0;
    for &(_, i) in &cells {
        let share = scaled[i as usize] * count as f64;
        let before = sum;
        sum += share;
        // Place a primitive whenever the cumulated density passes the middle of its stratum.
        while out.len() < count && (out.len() as f64 + 0.5) < sum {
            debug_assert!(before <= out.len() as f64 + 0.5 || share > 1.0);
            let jitter: [f32; 2] = [rng.random(), rng.random()];
            let x = ((i % cols) as f32 + jitter[0]) * cell as f32;
            let y = ((i / cols) as f32 + jitter[1]) * cell as f32;
            let mean = [x.min(target.width as f32), y.min(target.height as f32)];
            let per_pixel = share as f32 / (cell * cell) as f32;
            let scale = (fit::INITIAL_SCALE / (std::f32::consts::PI * per_pixel).sqrt()).max(0.4).strict_ln();
            let (stretch, along) = detail.stretch(i as usize);
            let log_scale = [scale + 0.5 * stretch, scale - 0.5 * stretch];
            // Avoid rotations exactly parallel to an axis, where gradients would stay 0.
            let rotation = along + fit::ANGLE_JITTER * (rng.random::<f32>() - 0.5);
            out.push(Primitive { mean, log_scale, rotation, color: target.at(mean) });
        }
    }
    // Rounding may leave the last stratum empty.
    while out.len() < count {
        let mean = [rng.random::<f32>() * target.width as f32, rng.random::<f32>() * target.height as f32];
        let scale = (fit::INITIAL_SCALE * spacing as f32 / std::f32::consts::PI.sqrt()).max(0.4).strict_ln();
        out.push(Primitive { mean, log_scale: [scale; 2], rotation: 0.0, color: target.at(mean) });
    }
    out
}

/// Returns the amount of detail in a part of a picture, which determines the density of primitives there. `pixels_each`
/// is the number of pixels per primitive.
pub(crate) fn detail(target: &Planes, pixels_each: f64) -> f64 {
    let cell = (pixels_each.sqrt() / 4.0).clamp(1.0, 64.0) as u32;
    let detail = Detail::new(target, cell, [target.width.div_ceil(cell), target.height.div_ceil(cell)]);
    detail.strength.iter().map(|d| f64::from(d.max(1e-6).sqrt())).sum()
}

/// Strength and direction of the colour gradient in each cell.
struct Detail {
    /// Mean magnitude of the gradient.
    strength: Vec<f32>,
    /// Structure tensor of the gradient: means of `gₓ²`, `gₓ·g_y` and `g_y²`.
    tensor: [Vec<f32>; 3],
}

impl Detail {
    fn new(target: &Planes, cell: u32, [cols, rows]: [u32; 2]) -> Self {
        let (w, stride, count) = (target.width as usize, target.stride, target.channels.count());
        let cells = parallel::map(rows as usize, |r| {
            let mut sums = vec![[0.0f32; 4]; cols as usize];
            let first = r as u32 * cell;
            for y in first..(first + cell).min(target.height) {
                let (row, below) = (target.row(y), target.row((y + 1).min(target.height - 1)));
                for x in 0..w {
                    let next = (x + 1).min(w - 1);
                    let [mut xx, mut xy, mut yy] = [0.0; 3];
                    for k in 0..count {
                        let v = row[k * stride + x];
                        let (dx, dy) = (row[k * stride + next] - v, below[k * stride + x] - v);
                        xx += dx * dx;
                        xy += dx * dy;
                        yy += dy * dy;
                    }
                    let sums = &mut sums[x / cell as usize];
                    for (sum, v) in sums.iter_mut().zip([(xx + yy).sqrt(), xx, xy, yy]) {
                        *sum += v;
                    }
                }
            }
            sums
        })
        .concat();
        let plane = |k: usize, times: u32| {
            let plane: Vec<f32> = cells.iter().map(|c| c[k]).collect();
            (0..times).fold(plane, |p, _| blur(&p, cols as usize, rows as usize))
        };
        Detail { strength: plane(0, 1), tensor: [1, 2, 3].map(|k| plane(k, 2)) }
    }

    /// Returns by how much a primitive in cell `i` is stretched, as the logarithm of its aspect ratio, and the angle of
    /// the stretch: along the edge, if there is one.
    fn stretch(&self, i: usize) -> (f32, f32) {
        let [a, b, c] = [0, 1, 2].map(|k| self.tensor[k][i]);
        let (difference, sum) = ((a - c).strict_hypot(2.0 * b), a + c);
        let coherence = difference / (sum + 1e-6);
        let aspect = 1.0 + fit::EDGE_STRETCH * coherence * coherence;
        (aspect.strict_ln(), 0.5 * (2.0 * b).strict_atan2(a - c) + std::f32::consts::FRAC_PI_2)
    }
}

/// Returns the means of 2 × 2 values. Borders are repeated.
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

/// Returns the position of `(x, y)` along the Hilbert curve over a square of side `2^order`.
pub(crate) fn hilbert_index(order: u32, mut x: u32, mut y: u32) -> u64 {
    let mut index = 0u64;
    for level in (0..order).rev() {
        let (rx, ry) = (x >> level & 1, y >> level & 1);
        index = index << 2 | u64::from(3 * rx ^ ry);
        // Rotate the quadrant so that the curve enters and leaves at the right corners.
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

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;
    use crate::gaussian::Channels;
    use crate::pixels::{Pixels, Samples};

    #[test]
    fn primitives_start_stretched_along_edges_and_round_elsewhere() {
        let start = |value: &dyn Fn(f32, f32) -> f32| {
            let samples = (0..96 * 80u32).map(|i| value((i % 96) as f32, (i / 96) as f32) as u8).collect();
            let pixels = Pixels::new(96, 80, Channels::Grey, Samples::U8(samples)).unwrap();
            by_detail(&Planes::new(&pixels), 60, &mut Pcg64Mcg::seed_from_u64(1))
        };
        for angle in [0.4f32, 1.3, 2.5] {
            let (sin, cos) = angle.sin_cos();
            for p in start(&|x, y| 128.0 + 90.0 * (0.5 * (cos * y - sin * x)).sin()) {
                // At the borders, the gradient includes repeated pixels.
                if !(10.0..86.0).contains(&p.mean[0]) || !(10.0..70.0).contains(&p.mean[1]) {
                    continue;
                }
                let turn = (p.rotation - angle).sin().abs();
                let stretch = p.log_scale[0] - p.log_scale[1];
                assert!(turn < 0.2 && stretch > 1.8f32.ln(), "{angle}: {p:?}");
            }
        }
        for p in start(&|_, _| 77.0) {
            assert_eq!(p.log_scale[0], p.log_scale[1]);
        }
    }
}
