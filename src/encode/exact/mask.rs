//! Decides which cells of a picture the exact layer covers: all but those of photographs.

use super::survey::Survey;
use crate::bitstream::exact::CELL;
use crate::bitstream::exact::tile::Shape;
use crate::constants::exact;
use crate::gaussian::Channels;
use crate::pixels::{Pixels, Samples};
use crate::strict_math::StrictMath;

/// Returns the basis functions of the discrete cosine transform, by frequency.
fn basis() -> [[f32; CELL]; CELL] {
    std::array::from_fn(|k| {
        let scale = if k == 0 { (1.0 / CELL as f64).sqrt() } else { (2.0 / CELL as f64).sqrt() };
        std::array::from_fn(|i| {
            let angle = std::f64::consts::PI / CELL as f64 * (i as f64 + 0.5) * k as f64;
            (scale * crate::angle::sin_cos(angle).1) as f32
        })
    })
}

/// Returns the values of a pixel's planes in 8-bit code values: luma, two colour differences and alpha, of which unused
/// ones are 0.
fn planes(samples: &Samples, shape: &Shape, at: usize) -> [f32; 4] {
    let count = shape.channels.count();
    let value = |k: usize| match samples {
        Samples::U8(v) => f32::from(v[at * count + k]),
        Samples::U16(v) => f32::from(v[at * count + k]) / 257.0,
    };
    match shape.channels {
        Channels::Grey => [value(0), 0.0, 0.0, 0.0],
        Channels::GreyAlpha => [value(0), 0.0, 0.0, value(1)],
        Channels::Rgb | Channels::Rgba => {
            let [r, g, b] = [value(0), value(1), value(2)];
            let alpha = if count == 4 { value(3) } else { 0.0 };
            [0.25 * r + 0.5 * g + 0.25 * b, r - b, g - 0.5 * (r + b), alpha]
        }
    }
}

/// Returns the bits of the cells that are not covered in a transform with about the quality of `tolerance`. The means of
/// the cells are not counted.
fn transform_bits(samples: &Samples, shape: &Shape, cells: &[bool], tolerance: f32) -> f64 {
    let [width, height] = shape.size;
    let basis = basis();
    let across = width.div_ceil(CELL);
    let used: &[usize] = match shape.channels {
        Channels::Grey => &[0],
        Channels::GreyAlpha => &[0, 3],
        Channels::Rgb => &[0, 1, 2],
        Channels::Rgba => &[0, 1, 2, 3],
    };
    let step = exact::STEP_OF_TOLERANCE * tolerance;
    let bits = |cell: usize| {
        let corner = [cell % across * CELL, cell / across * CELL];
        // Cells at the edges repeat the last column and row.
        let values: [[f32; 4]; CELL * CELL] = std::array::from_fn(|i| {
            let x = (corner[0] + i % CELL).min(width - 1);
            let y = (corner[1] + i / CELL).min(height - 1);
            planes(samples, shape, y * width + x)
        });
        let mut bits = 0.0;
        for &plane in used {
            let first = values[0][plane];
            if values.iter().all(|v| v[plane] == first) {
                continue;
            }
            let step = if plane == 1 || plane == 2 { exact::MASK_CHROMA_STEP * step } else { step };
            let mut rows = [[0.0f32; CELL]; CELL];
            for (y, row) in rows.iter_mut().enumerate() {
                for (k, sum) in row.iter_mut().enumerate() {
                    *sum = (0..CELL).map(|x| basis[k][x] * (values[y * CELL + x][plane] - first)).sum();
                }
            }
            for k in 0..CELL {
                for i in 0..CELL {
                    if k + i > 0 {
                        let c: f32 = (0..CELL).map(|y| basis[i][y] * rows[y][k]).sum();
                        let ratio = c / step;
                        bits += exact::BITS_PER_OCTAVE * (1.0 + ratio * ratio).strict_log2();
                    }
                }
            }
        }
        bits
    };
    (0..cells.len()).filter(|&cell| !cells[cell]).map(|cell| f64::from(bits(cell))).sum()
}

/// Returns which cells are those of photographs. There, most pixels differ from their neighbours. In smooth parts fewer
/// of them do, but the contrast is low. Letters have smooth edges as well, but on flat ground.
fn natural(samples: &Samples, shape: &Shape) -> Vec<bool> {
    let counts = shape.size.map(|side| side.div_ceil(CELL));
    let unlike = unlike(samples, shape);
    let contrast = contrast(samples, shape);
    let is_certain = |i: usize| {
        unlike[i] >= exact::MIN_UNLIKE_SHARE
            || unlike[i] >= exact::MIN_SMOOTH_UNLIKE_SHARE && contrast[i] <= exact::MAX_SMOOTH_RANGE
    };
    let mut natural: Vec<bool> = (0..unlike.len()).map(is_certain).collect();
    for _ in 0..exact::MASK_ROUNDS {
        let near = around(&natural.iter().map(|&is_natural| f32::from(is_natural)).collect::<Vec<_>>(), counts, 2);
        let is_natural = |i: usize| match natural[i] {
            true => near[i] >= exact::MIN_KEPT_SHARE,
            false => unlike[i] >= exact::MIN_SMOOTH_UNLIKE_SHARE && near[i] >= exact::MIN_JOINED_SHARE,
        };
        natural = (0..natural.len()).map(is_natural).collect();
    }
    natural
}

/// Returns the share of the pixels in each cell and around it that differ from all their neighbours above and to the
/// left.
fn unlike(samples: &Samples, shape: &Shape) -> Vec<f32> {
    let [width, height] = shape.size;
    let [across, down] = shape.size.map(|side| side.div_ceil(CELL));
    let count = shape.channels.count();
    fn is_equal<T: PartialEq>(v: &[T], a: usize, b: usize, count: usize) -> bool {
        v[a * count..][..count] == v[b * count..][..count]
    }
    let equal = |a: usize, b: usize| match samples {
        Samples::U8(v) => is_equal(v, a, b, count),
        Samples::U16(v) => is_equal(v, a, b, count),
    };
    let mut unlike = vec![0.0f32; across * down];
    for y in 0..height {
        for x in 0..width {
            let at = y * width + x;
            let is_like = x > 0 && equal(at, at - 1)
                || y > 0 && equal(at, at - width)
                || x > 0 && y > 0 && equal(at, at - width - 1)
                || x + 1 < width && y > 0 && equal(at, at - width + 1);
            unlike[y / CELL * across + x / CELL] += f32::from(!is_like);
        }
    }
    let side = |i: usize, length: usize| CELL.min(length - i * CELL);
    for (i, sum) in unlike.iter_mut().enumerate() {
        *sum /= (side(i % across, width) * side(i / across, height)) as f32;
    }
    around(&unlike, [across, down], 1)
}

/// Returns the range of luma or, if that is larger, of alpha in each cell and around it, in 8-bit code values.
fn contrast(samples: &Samples, shape: &Shape) -> Vec<f32> {
    let [width, height] = shape.size;
    let [across, down] = shape.size.map(|side| side.div_ceil(CELL));
    const NOTHING: [[f32; 2]; 2] = [[f32::INFINITY, f32::NEG_INFINITY]; 2];
    let joined = |a: [[f32; 2]; 2], b: [[f32; 2]; 2]| [0, 1].map(|k| [a[k][0].min(b[k][0]), a[k][1].max(b[k][1])]);
    let mut ranges = vec![NOTHING; across * down];
    for y in 0..height {
        for x in 0..width {
            let [luma, _, _, alpha] = planes(samples, shape, y * width + x);
            let ranges = &mut ranges[y / CELL * across + x / CELL];
            *ranges = joined(*ranges, [[luma; 2], [alpha; 2]]);
        }
    }
    let range = |i: usize| {
        let near = neighbourhood(i, [across, down], 1).map(|other| ranges[other]);
        near.fold(NOTHING, joined).map(|[low, high]| high - low).into_iter().fold(0.0, f32::max)
    };
    (0..across * down).map(range).collect()
}

/// Returns the share of the visible pixels of a picture with alpha that lie in `cells`.
fn visible_share(samples: &Samples, shape: &Shape, cells: &[bool]) -> f64 {
    let [width, height] = shape.size;
    let (mut within, mut all) = (0u64, 0u64);
    for y in 0..height {
        for x in 0..width {
            if planes(samples, shape, y * width + x)[3] > 0.0 {
                all += 1;
                within += u64::from(cells[y / CELL * width.div_ceil(CELL) + x / CELL]);
            }
        }
    }
    within as f64 / all.max(1) as f64
}

/// Returns the mean over each cell and those up to `reach` cells away.
fn around(values: &[f32], counts: [usize; 2], reach: usize) -> Vec<f32> {
    let mean = |i: usize| {
        let (sum, n) =
            neighbourhood(i, counts, reach).fold((0.0, 0.0), |(sum, n), other| (sum + values[other], n + 1.0));
        sum / n
    };
    (0..values.len()).map(mean).collect()
}

/// Returns the cells up to `reach` cells away from cell `i`, and cell `i`.
fn neighbourhood(i: usize, [across, down]: [usize; 2], reach: usize) -> impl Iterator<Item = usize> {
    let near = |i: usize, count: usize| i.saturating_sub(reach)..(i + reach + 1).min(count);
    let columns = near(i % across, across);
    near(i / across, down).flat_map(move |y| columns.clone().map(move |x| y * across + x))
}

/// The cells that the exact layer covers: all but those of photographs.
pub(super) struct Mask {
    /// Whether each cell is covered, row by row.
    cells: Vec<bool>,
    /// Width of the picture, pixels.
    width: usize,
    /// Bytes that a transform takes for the others at each of [`TOLERANCES`].
    transform: [f64; TOLERANCES.len()],
}

/// Tolerances at which the bytes of a transform are estimated.
const TOLERANCES: [f32; 6] = [1.0, 3.0, 8.0, 16.0, 32.0, 48.0];

/// What an exact layer can cover of a picture.
pub(super) enum Cover {
    All,
    /// The cells of a mask.
    Some(Mask),
    /// Next to nothing, because the picture is a photograph.
    Nothing,
}

/// Returns what an exact layer can cover of a picture. Colours under alpha 0 are kept or black.
pub(super) fn cover(survey: &Survey, pixels: &Pixels) -> Cover {
    let size = survey.size.map(|side| side as usize);
    let shape = Shape { size, channels: survey.channels, depth: survey.depth };
    let cells: Vec<bool> = natural(pixels.samples(), &shape).into_iter().map(|is_natural| !is_natural).collect();
    let others = cells.iter().filter(|&&is_covered| !is_covered).count();
    match survey.channels.alpha() {
        None if others as f64 > exact::MAX_PHOTOGRAPH_SHARE * cells.len() as f64 => return Cover::Nothing,
        // Soft shadows and smooth logos look like photographs, and a mask of transparent cells brings nothing.
        Some(_) if visible_share(pixels.samples(), &shape, &cells) < exact::MIN_VISIBLE_SHARE => return Cover::All,
        _ => {}
    }
    if others < exact::MIN_PHOTOGRAPH_CELLS {
        return Cover::All;
    }
    let transform = TOLERANCES.map(|tolerance| {
        let bits = transform_bits(pixels.samples(), &shape, &cells, tolerance);
        bits / 8.0
    });
    Cover::Some(Mask { cells, width: size[0], transform })
}

impl Mask {
    /// Returns the estimated bytes of the cells that are not covered at a tolerance.
    pub(super) fn transform_bytes(&self, tolerance: f32) -> f64 {
        let next = TOLERANCES.iter().position(|&t| t >= tolerance).unwrap_or(TOLERANCES.len() - 1).max(1);
        let [from, to] = [TOLERANCES[next - 1], TOLERANCES[next]].map(|t| f64::from(t).strict_ln());
        let at = (f64::from(tolerance).strict_ln() - from) / (to - from);
        self.transform[next - 1] + at * (self.transform[next] - self.transform[next - 1])
    }

    /// Returns a lower bound of the bytes of a layer that covers the photographs as well, without loss.
    pub(super) fn min_exact_bytes(&self, survey: &Survey) -> f64 {
        let others = self.cells.iter().filter(|&&is_covered| !is_covered).count();
        (others * CELL * CELL * survey.channels.count()) as f64 * exact::MIN_SAMPLE_BYTES
    }

    /// Returns the share of the cells that are covered.
    pub(super) fn share(&self) -> f64 {
        self.cells.iter().filter(|&&is_covered| is_covered).count() as f64 / self.cells.len() as f64
    }

    /// Returns whether a pixel is covered.
    pub(super) fn covers(&self, [x, y]: [usize; 2]) -> bool {
        self.cells[y / CELL * self.width.div_ceil(CELL) + x / CELL]
    }
}
