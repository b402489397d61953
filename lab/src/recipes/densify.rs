//! Growth and pruning of 3D Gaussian Splatting (Kerbl et al. 2023, section 5.2), after `densify_and_prune`,
//! `reset_opacity` and `train.py` of github.com/graphdeco-inria/gaussian-splatting.
//!
//! Up to iteration 15 000 of 30 000, the norms of the gradients with respect to positions are averaged, in units of
//! half the picture's sides and of the mean loss. After iteration 500, every 100 iterations, each Gaussian with an
//! average of 0.0002 or more is cloned if its larger scale is at most 0.01 of the scene's extent, and split otherwise:
//! it is replaced by two samples from it with 1/1.6 of its scales. Then Gaussians with an opacity below 0.005 are
//! removed. Every 3000 iterations, opacities are reduced to at most 0.01. New Gaussians come last in the order, with
//! empty moments of the optimizer, which takes no step in such an iteration. Radii in the picture do not prune
//! anything, because the program reads them after it has cleared them.
//!
//! Differences from the published program: nothing is pruned for its size. There, once opacities have been reset,
//! Gaussians with a scale above 0.1 of the extent are removed. With a few hundred Gaussians, that is the distance to
//! the next one, and hardly any would remain. There are never more Gaussians than requested. If more would grow, those
//! with the largest averages do. One always remains.

use rand::RngExt;
use rand_pcg::Pcg64Mcg;

use super::optimizer::{Adam, NUMBERS};

/// Iterations of the published program; all iteration counts here are relative to these.
const ITERATIONS: u32 = 30_000;
const FROM: u32 = 500;
const UNTIL: u32 = 15_000;
const EVERY: u32 = 100;
const RESET: u32 = 3000;
const THRESHOLD: f32 = 2e-4;
const MIN_ALPHA: f32 = 5e-3;
const LOWERED: f32 = 0.01;
/// Scale, relative to the extent, above which a Gaussian is split.
const SPLIT_SCALE: f32 = 0.01;
/// Divisor of the scales when a Gaussian is split into two.
const SHRINK: f32 = 1.6;

/// The Gaussians and the optimizer's state of them.
pub(super) struct Population {
    pub numbers: Vec<[f32; NUMBERS]>,
    pub adam: Adam,
}

/// Actions that are due after an iteration.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Due {
    watches: bool,
    grows: bool,
    resets: bool,
}

impl Due {
    /// Returns the actions after `iteration` (counted from 1) of `iterations`.
    pub(super) fn after(iteration: u32, iterations: u32) -> Self {
        let steps = |published: u32| {
            (f64::from(published) * f64::from(iterations) / f64::from(ITERATIONS)).ceil().max(1.0) as u32
        };
        let watches = iteration < steps(UNTIL);
        Due {
            watches,
            grows: watches && iteration > steps(FROM) && iteration.is_multiple_of(steps(EVERY)),
            resets: watches && iteration.is_multiple_of(steps(RESET)),
        }
    }
}

/// Averages of the gradients, and the rules.
pub(super) struct Growth {
    rng: Pcg64Mcg,
    /// The scene's extent, pixels.
    extent: f32,
    /// Half the sides, pixels, over the samples of the loss.
    units: [f32; 2],
    most: usize,
    /// Sums of the norms, and the number of norms in each.
    seen: Vec<(f32, u32)>,
}

impl Growth {
    /// For a picture of `size` with this many samples, and `most` Gaussians at the end.
    pub(super) fn new(rng: Pcg64Mcg, size: [f32; 2], samples: f32, (extent, most): (f32, usize)) -> Self {
        Growth { rng, extent, units: size.map(|s| 0.5 * s / samples), most, seen: Vec::new() }
    }

    /// Processes the gradients of an iteration (of a sum over all samples, with respect to pixels) and whether each
    /// Gaussian was visible. Grows and prunes when due. Returns whether the optimizer takes its step.
    pub(super) fn passes(
        &mut self,
        population: &mut Population,
        found: impl Iterator<Item = ([f32; 2], bool)>,
        due: Due,
    ) -> bool {
        if due.watches {
            self.seen.resize(population.numbers.len(), (0.0, 0));
            for ((sum, times), (gradient, is_inside)) in self.seen.iter_mut().zip(found) {
                let norm = (gradient[0] * self.units[0]).hypot(gradient[1] * self.units[1]);
                if is_inside && norm.is_finite() {
                    (*sum, *times) = (*sum + norm, *times + 1);
                }
            }
        }
        if due.grows {
            self.grow(population);
            prune(population);
            self.seen.clear();
        }
        if due.resets {
            let lowered = logit(LOWERED);
            population.numbers.iter_mut().for_each(|n| n[8] = n[8].min(lowered));
            population.adam.forget(8);
        }
        !due.grows
    }

    /// Clones and splits.
    fn grow(&mut self, population: &mut Population) {
        let mean = |&(sum, times): &(f32, u32)| if times > 0 { sum / times as f32 } else { 0.0 };
        let means: Vec<f32> = self.seen.iter().map(mean).collect();
        let mut chosen: Vec<usize> = (0..means.len()).filter(|&i| means[i] >= THRESHOLD).collect();
        chosen.sort_by(|&a, &b| means[b].total_cmp(&means[a]).then(a.cmp(&b)));
        chosen.truncate(self.most.saturating_sub(population.numbers.len()));
        chosen.sort_unstable();
        let (mut clones, mut parts, mut kept) = (Vec::new(), Vec::new(), vec![true; population.numbers.len()]);
        for i in chosen {
            let n = population.numbers[i];
            if n[2].max(n[3]).exp() <= SPLIT_SCALE * self.extent {
                clones.push(n);
            } else {
                kept[i] = false;
                parts.extend([self.part(&n), self.part(&n)]);
            }
        }
        clones.append(&mut parts);
        population.keep(&kept);
        population.adam.add(clones.len());
        population.numbers.append(&mut clones);
    }

    /// Returns one of the two Gaussians into which a Gaussian is split.
    fn part(&mut self, n: &[f32; NUMBERS]) -> [f32; NUMBERS] {
        // Two normally distributed numbers at once (Box and Muller, 1958).
        let (radius, turn) = ((-2.0 * (1.0 - self.rng.random::<f32>()).ln()).sqrt(), self.rng.random::<f32>());
        let (v, u) = (std::f32::consts::TAU * turn).sin_cos();
        let [u, v] = [u * radius * n[2].exp(), v * radius * n[3].exp()];
        let (sin, cos) = n[4].sin_cos();
        let mut part = *n;
        (part[0], part[1]) = (n[0] + cos * u - sin * v, n[1] + sin * u + cos * v);
        (part[2], part[3]) = (n[2] - SHRINK.ln(), n[3] - SHRINK.ln());
        part
    }
}

/// Removes nearly transparent Gaussians.
fn prune(population: &mut Population) {
    let least = logit(MIN_ALPHA);
    let mut kept: Vec<bool> = population.numbers.iter().map(|n| n[8] >= least).collect();
    if !kept.contains(&true) {
        kept[0] = true;
    }
    population.keep(&kept);
}

impl Population {
    fn keep(&mut self, kept: &[bool]) {
        let mut each = kept.iter();
        self.numbers.retain(|_| each.next().is_some_and(|k| *k));
        self.adam.keep(kept);
    }
}

/// Returns the logit of `v`, the inverse of the sigmoid.
pub(super) fn logit(v: f32) -> f32 {
    (v / (1.0 - v)).ln()
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;

    const EXTENT: f32 = 384.0;

    fn gaussian(scale: f32, opacity: f32) -> [f32; NUMBERS] {
        [100.0, 80.0, scale.ln(), (0.25 * scale).ln(), 0.6, 0.1, 0.2, 0.3, logit(opacity)]
    }

    fn population(numbers: Vec<[f32; NUMBERS]>) -> Population {
        Population { adam: Adam::new(numbers.len()), numbers }
    }

    /// A picture of 768 × 512 in colour.
    fn growth(most: usize) -> Growth {
        let rng = Pcg64Mcg::seed_from_u64(5);
        Growth::new(rng, [768.0, 512.0], 3.0 * 768.0 * 512.0, (EXTENT, most))
    }

    const GROWS: Due = Due { watches: true, grows: true, resets: false };

    /// Returns a gradient along x or y whose norm is `norm` in the published units: of the mean loss, and of half a
    /// side.
    fn along(k: usize, norm: f32) -> [f32; 2] {
        let mut g = [0.0; 2];
        g[k] = norm * 3.0 * 768.0 * 512.0 / [384.0, 256.0][k];
        g
    }

    #[test]
    fn small_ones_are_cloned_and_large_ones_split_where_gradients_are_large() {
        // A hundredth of the extent is 3.84 pixels.
        let [small, large] = [gaussian(3.8, 0.5), gaussian(3.9, 0.5)];
        let mut population = population(vec![small, large, small, large]);
        let gradients = [along(0, 2.1e-4), along(1, 2.1e-4), along(1, 1.9e-4), along(0, 1.9e-4)];
        assert!(!growth(100).passes(&mut population, gradients.map(|g| (g, true)).into_iter(), GROWS));
        let n = &population.numbers;
        assert_eq!(n.len(), 6);
        assert_eq!(n[..4], [small, small, large, small]);
        for part in &n[4..] {
            assert_eq!(part[4..], large[4..]);
            assert!((0..2).all(|k| (part[2 + k] - (large[2 + k] - 1.6f32.ln())).abs() < 1e-6), "{part:?}");
            assert!(part[..2] != large[..2]);
        }
    }

    #[test]
    fn parts_are_drawn_from_what_is_split() {
        let (mut growth, n) = (growth(1), gaussian(8.0, 0.5));
        let offsets: Vec<[f32; 2]> = (0..4000)
            .map(|_| {
                let part = growth.part(&n);
                let [dx, dy] = [part[0] - n[0], part[1] - n[1]];
                let (sin, cos) = n[4].sin_cos();
                [cos * dx + sin * dy, cos * dy - sin * dx]
            })
            .collect();
        for (k, scale) in [8.0f32, 2.0].into_iter().enumerate() {
            let mean = offsets.iter().map(|o| o[k]).sum::<f32>() / 4000.0;
            let deviation = (offsets.iter().map(|o| o[k] * o[k]).sum::<f32>() / 4000.0).sqrt();
            assert!(mean.abs() < 0.06 * scale && (deviation / scale - 1.0).abs() < 0.05, "{k}: {mean} {deviation}");
        }
    }

    #[test]
    fn averages_are_over_the_iterations_in_which_a_gaussian_was_in_the_picture() {
        let watches = Due { grows: false, ..GROWS };
        let small = gaussian(2.0, 0.5);
        for (is_inside, count) in [(true, 1), (false, 2)] {
            let (mut growth, mut population) = (growth(100), population(vec![small]));
            assert!(growth.passes(&mut population, [(along(0, 0.0), is_inside)].into_iter(), watches));
            growth.passes(&mut population, [(along(0, 3e-4), true)].into_iter(), GROWS);
            assert_eq!(population.numbers.len(), count, "{is_inside}");
        }
    }

    #[test]
    fn there_are_never_more_than_asked_for_and_the_largest_gradients_come_first() {
        let all: Vec<_> = (0..5).map(|i| gaussian(1.0 + i as f32 * 0.1, 0.5)).collect();
        let mut population = population(all.clone());
        let gradients = [3e-4, 9e-4, 4e-4, 8e-4, 5e-4].map(|g| (along(0, g), true));
        growth(7).passes(&mut population, gradients.into_iter(), GROWS);
        assert_eq!(population.numbers, [&all[..], &[all[1], all[3]]].concat());
    }

    #[test]
    fn the_faint_are_pruned_but_never_all() {
        let all = vec![gaussian(2.0, 0.0051), gaussian(2.0, 0.0049), gaussian(60.0, 0.5)];
        let none = || [(along(0, 0.0), true); 3].into_iter();
        let mut some = population(all.clone());
        growth(100).passes(&mut some, none(), GROWS);
        assert_eq!(some.numbers, [all[0], all[2]]);
        let mut faint = population(vec![all[1]; 3]);
        growth(100).passes(&mut faint, none(), GROWS);
        assert_eq!(faint.numbers.len(), 1);
    }

    #[test]
    fn a_reset_lowers_opacities_to_a_hundredth_and_forgets_their_moments() {
        let mut population = population(vec![gaussian(2.0, 0.7), gaussian(2.0, 0.006)]);
        let mut pushed = population.numbers.clone();
        population.adam.step(&mut pushed, &[[1.0; NUMBERS]; 2], [0.1; NUMBERS]);
        let resets = Due { grows: false, resets: true, ..GROWS };
        assert!(growth(100).passes(&mut population, [(along(0, 0.0), true); 2].into_iter(), resets));
        let opacity = |n: &[f32; NUMBERS]| 1.0 / (1.0 + (-n[8]).exp());
        assert!(
            (opacity(&population.numbers[0]) - 0.01).abs() < 1e-6
                && (opacity(&population.numbers[1]) - 0.006).abs() < 1e-6
        );
        // Without a gradient, only Gaussians with moments move.
        let before = population.numbers.clone();
        population.adam.step(&mut population.numbers, &[[0.0; NUMBERS]; 2], [0.1; NUMBERS]);
        for (n, b) in population.numbers.iter().zip(&before) {
            assert!(n[8] == b[8] && n[0] < b[0], "{n:?} {b:?}");
        }
    }

    #[test]
    fn everything_is_due_when_the_program_does_it_or_at_the_same_share() {
        let when = |iterations: u32, is: fn(&Due) -> bool| -> Vec<u32> {
            (1..=iterations).filter(|&i| is(&Due::after(i, iterations))).collect()
        };
        let grows = when(30_000, |d| d.grows);
        assert_eq!((grows[0], grows[1], grows.len(), grows[143]), (600, 700, 144, 14_900));
        assert_eq!(when(30_000, |d| d.resets), [3000, 6000, 9000, 12_000]);
        assert_eq!(when(3000, |d| d.grows)[..2], [60, 70]);
        assert_eq!(when(3000, |d| d.resets), [300, 600, 900, 1200]);
    }
}
