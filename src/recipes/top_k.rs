//! The blend of Image-GS: at each pixel the ten Gaussians that are largest there, weighted by their values over their sum.
//!
//! `I = Σ cₖ aₖ / (Σ aₖ + ε)` with `aₖ = exp(−σₖ)`. Which Gaussians a pixel looks at is decided by tiles of 16 × 16 pixels: those
//! whose circle of three times the larger scale meets the tile.

use super::tiles::{Reach, TILE, Tiles};
use crate::fit::model::project::Projected;
use crate::parallel;

/// How many count.
pub(super) const K: usize = 10;
/// Added to the sum of the weights.
const EPSILON: f32 = 1e-4;

/// What a pixel shows.
#[derive(Debug, Clone, Copy)]
struct Pick {
    /// Their numbers.
    ids: [u32; K],
    values: [f32; K],
    used: usize,
}

impl Pick {
    const NONE: Pick = Pick { ids: [0; K], values: [0.0; K], used: 0 };

    /// Takes a Gaussian where there is room, or in the place of the smallest if it is larger. Values are exponents as yet;
    /// `least` is that of the smallest, once there is no room.
    #[inline]
    fn offer(&mut self, id: u32, exponent: f32, least: &mut (usize, f32)) {
        if self.used < K {
            (self.ids[self.used], self.values[self.used]) = (id, exponent);
            self.used += 1;
        } else {
            (self.ids[least.0], self.values[least.0]) = (id, exponent);
        }
        if self.used == K {
            *least = (0, self.values[0]);
            for k in 1..K {
                if self.values[k] < least.1 {
                    *least = (k, self.values[k]);
                }
            }
        }
    }

    /// The inverse of what the values are divided by.
    fn inverse(&self) -> f32 {
        1.0 / (self.values[..self.used].iter().sum::<f32>() + EPSILON)
    }
}

/// A Gaussian and how far its circle reaches, pixels.
#[derive(Debug, Clone, Copy)]
pub(super) struct Circle {
    pub projected: Projected,
    pub radius: f32,
}

/// The sums of [`Slope::from_moments`](super::moments::Slope::from_moments) for one Gaussian, then those of its colour.
pub(super) type Sums = [f32; 9];

/// The pixels of one drawing.
#[derive(Debug, Default)]
pub(super) struct Drawing {
    picks: Vec<Pick>,
}

impl Drawing {
    /// Draws `circles` into `planes`: rows of `channels` planes of `stride` floats and one that is left alone.
    pub(super) fn draw(
        &mut self,
        circles: &[Circle],
        [width, height]: [usize; 2],
        channels: usize,
        (planes, stride): (&mut Vec<f32>, usize),
    ) {
        let row_size = (channels + 1) * stride;
        planes.clear();
        planes.resize(height * row_size, 0.0);
        self.picks.clear();
        self.picks.resize(width * height, Pick::NONE);
        let reach = |c: &Circle| Reach { center: c.projected.center, half: [c.radius; 2] };
        let tiles = Tiles::new(circles.iter().map(reach), [width, height]);
        parallel::map_chunk_pairs((&mut self.picks, TILE * width), (planes, TILE * row_size), |band, picks, planes| {
            for column in 0..tiles.columns {
                let members = tiles.members(band, column);
                for (y, row) in picks.chunks_exact_mut(width).enumerate() {
                    let py = (band * TILE + y) as f32;
                    for x in column * TILE..width.min((column + 1) * TILE) {
                        let pick = &mut row[x];
                        let mut least = (0, f32::NEG_INFINITY);
                        for &id in members {
                            let exponent = exponent(&circles[id as usize].projected, x as f32, py);
                            // As there: what is no number is passed over. The largest exponents are the largest values.
                            if exponent > least.1 && exponent <= 0.0 {
                                pick.offer(id, exponent, &mut least);
                            }
                        }
                        pick.values[..pick.used].iter_mut().for_each(|v| *v = v.exp());
                        let inverse = pick.inverse();
                        for k in 0..pick.used {
                            let weight = pick.values[k] * inverse;
                            let color = &circles[pick.ids[k] as usize].projected.color;
                            for c in 0..channels {
                                planes[y * row_size + c * stride + x] += weight * color[c];
                            }
                        }
                    }
                }
            }
        });
    }

    /// What each of `circles` gets of the gradient `slopes` with respect to the picture `drawn`, both as planes.
    pub(super) fn sums(
        &self,
        circles: &[Circle],
        [width, height]: [usize; 2],
        channels: usize,
        (slopes, drawn, stride): (&[f32], &[f32], usize),
    ) -> Vec<Sums> {
        let row_size = (channels + 1) * stride;
        // Bands do not depend on the number of threads, and neither does the order of sums.
        let bands = parallel::map(height.div_ceil(TILE), |band| {
            let mut places = vec![u32::MAX; circles.len()];
            let mut found: Vec<(u32, Sums)> = Vec::new();
            for y in band * TILE..height.min((band + 1) * TILE) {
                for x in 0..width {
                    let pick = &self.picks[y * width + x];
                    let inverse = pick.inverse();
                    for k in 0..pick.used {
                        let id = pick.ids[k];
                        let p = &circles[id as usize].projected;
                        let weight = pick.values[k] * inverse;
                        let place = &mut places[id as usize];
                        if *place == u32::MAX {
                            *place = found.len() as u32;
                            found.push((id, [0.0; 9]));
                        }
                        let sums = &mut found[*place as usize].1;
                        let mut by_value = 0.0;
                        for c in 0..channels {
                            let at = y * row_size + c * stride + x;
                            by_value += slopes[at] * (p.color[c] - drawn[at]);
                            sums[5 + c] += weight * slopes[at];
                        }
                        let t = weight * by_value;
                        let (dx, dy) = (x as f32 - p.center[0], y as f32 - p.center[1]);
                        for (sum, v) in sums.iter_mut().zip([dx, dy, dx * dx, dx * dy, dy * dy]) {
                            *sum += t * v;
                        }
                    }
                }
            }
            found
        });
        let mut sums = vec![[0.0; 9]; circles.len()];
        for (id, part) in bands.iter().flatten() {
            sums[*id as usize].iter_mut().zip(part).for_each(|(s, v)| *s += v);
        }
        sums
    }
}

/// `−½ xᵀ C x` at a pixel.
fn exponent(p: &Projected, x: f32, y: f32) -> f32 {
    let (dx, dy) = (x - p.center[0], y - p.center[1]);
    let [a, b, c] = p.conic;
    -0.5 * (a * dx * dx + c * dy * dy) - b * dx * dy
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::model::project::Primitive;

    const SIZE: [usize; 2] = [37, 33];
    const STRIDE: usize = 40;

    fn circles(count: u32) -> Vec<Circle> {
        (0..count)
            .map(|i| {
                let f = |k: u32| (f64::from(i) * f64::from(k).sqrt()).fract() as f32;
                let scale = [1.5 + 4.0 * f(2), 1.0 + 3.0 * f(3)];
                let p = Primitive {
                    mean: [37.0 * f(5), 33.0 * f(7)],
                    log_scale: scale.map(f32::ln),
                    rotation: 3.0 * f(11),
                    color: [f(13), f(17), f(19), 0.0],
                };
                Circle { projected: Projected::new(&p, 33), radius: (3.0 * scale[0].max(scale[1])).ceil() }
            })
            .collect()
    }

    fn draw(circles: &[Circle]) -> (Drawing, Vec<f32>) {
        let (mut drawing, mut planes) = (Drawing::default(), Vec::new());
        drawing.draw(circles, SIZE, 3, (&mut planes, STRIDE));
        (drawing, planes)
    }

    #[test]
    fn a_pixel_shows_the_mean_of_its_ten_largest() {
        let circles = circles(90);
        let (_, planes) = draw(&circles);
        let mut full = 0;
        for (x, y) in [(3usize, 4usize), (20, 17), (36, 32), (15, 16), (16, 15)] {
            let tile = [x / TILE, y / TILE].map(|t| (t * TILE) as f32);
            let mut values: Vec<(f32, [f32; 4])> = circles
                .iter()
                .filter(|c| {
                    let center = c.projected.center;
                    (0..2).all(|k| center[k] + c.radius >= tile[k] && center[k] - c.radius < tile[k] + 16.0)
                })
                .map(|c| (exponent(&c.projected, x as f32, y as f32).exp(), c.projected.color))
                .collect();
            values.sort_by(|a, b| b.0.total_cmp(&a.0));
            full += usize::from(values.len() > K);
            values.truncate(K);
            let sum: f32 = values.iter().map(|v| v.0).sum::<f32>() + EPSILON;
            for c in 0..3 {
                let want: f32 = values.iter().map(|v| v.0 * v.1[c]).sum::<f32>() / sum;
                let found = planes[y * 4 * STRIDE + c * STRIDE + x];
                assert!((found - want).abs() < 1e-5, "{x} {y}: {found} {want}");
            }
        }
        assert!(full > 2, "too few Gaussians to choose from");
    }

    #[test]
    fn sums_are_slopes_of_the_picture() {
        use super::super::moments::Slope;
        let circles = circles(40);
        let (drawing, planes) = draw(&circles);
        // The loss is a fixed mixture of all samples.
        let slopes: Vec<f32> = (0..planes.len()).map(|i| ((i * 37 % 101) as f32 - 50.0) / 50.0).collect();
        let loss = |circles: &[Circle]| {
            let planes = draw(circles).1;
            let at = |i: usize| f64::from(planes[i]) * f64::from(slopes[i]);
            (0..33)
                .flat_map(|y| (0..3).flat_map(move |c| (0..37).map(move |x| y * 4 * STRIDE + c * STRIDE + x)))
                .map(at)
                .sum::<f64>()
        };
        let sums = drawing.sums(&circles, SIZE, 3, (&slopes, &planes, STRIDE));
        for i in [3usize, 17, 31] {
            let mut geometry = [0.0; 5];
            geometry.copy_from_slice(&sums[i][..5]);
            let slope = Slope::from_moments(geometry, circles[i].projected.conic, [0.0; 4]);
            let moved = |change: &dyn Fn(&mut Projected)| {
                let mut circles = circles.clone();
                change(&mut circles[i].projected);
                loss(&circles)
            };
            for k in 0..2 {
                let at = |by: f32| moved(&|p: &mut Projected| p.center[k] += by);
                let want = ((at(1e-2) - at(-1e-2)) / 2e-2) as f32;
                assert!((slope.mean[k] - want).abs() < 0.03 * want.abs() + 0.02, "{i} {k}: {} {want}", slope.mean[k]);
            }
            for c in 0..3 {
                let at = |by: f32| moved(&|p: &mut Projected| p.color[c] += by);
                let want = ((at(0.1) - at(-0.1)) / 0.2) as f32;
                assert!((sums[i][5 + c] - want).abs() < 1e-3 * want.abs() + 1e-3, "{i} {c}");
            }
        }
    }
}
