//! Chooses the step classes of superblocks. Busy regions get coarser steps, because they mask errors.

use super::residual::TileResidual;
use super::settings::SearchSettings;
use crate::bitstream::detail::levels::{SUPER, SUPERS, TILE};
use crate::constants::detail;
use crate::detail::steps::CLASS_STEPS;
use crate::parallel;
use crate::strict_math::StrictMath;

/// Side of the squares whose moments are computed, pixels.
const SQUARE: usize = 8;
/// Class step that leaves the layer's step unchanged, in 1/64.
const MIDDLE: f32 = 64.0;

/// Returns the activity of each superblock of `tiles`. It is empty if there is only one class, which does not depend on
/// it.
pub(super) fn activities(tiles: &[TileResidual], settings: &SearchSettings) -> Vec<Vec<f32>> {
    match settings.coding.head.classes {
        1 => vec![Vec::new(); tiles.len()],
        _ => parallel::map(tiles.len(), |i| activity(&tiles[i])),
    }
}

/// Returns the activity of each superblock of `tile`: the logarithm of the luma variance around a square, averaged over
/// the squares of the superblock.
fn activity(tile: &TileResidual) -> Vec<f32> {
    let [across, down] = tile.size.map(|side| side.next_multiple_of(SUPER) / SQUARE);
    let mut moments = vec![[0f32; 2]; across * down];
    for (i, moment) in moments.iter_mut().enumerate() {
        let [x, y] = [i % across * SQUARE, i / across * SQUARE];
        for row in y..y + SQUARE {
            for &v in &tile.luma[row * TILE + x..][..SQUARE] {
                moment[0] += v;
                moment[1] += v * v;
            }
        }
        let share = 1.0 / (SQUARE * SQUARE) as f32;
        *moment = moment.map(|m| m * share);
    }
    let blurred = blur(&blur(&moments, [across, down], [1, 0]), [across, down], [0, 1]);
    let log =
        |[mean, square]: [f32; 2]| ((square - mean * mean).max(0.0) + detail::ACTIVITY_VARIANCE_FLOOR).strict_ln();
    let each = SUPER / SQUARE;
    let supers = [across / each, down / each];
    let mut out = vec![0.0; SUPERS * SUPERS];
    for y in 0..supers[1] {
        for x in 0..supers[0] {
            let squares = (0..each * each).map(|i| blurred[(y * each + i / each) * across + x * each + i % each]);
            out[y * SUPERS + x] = squares.map(log).sum::<f32>() / (each * each) as f32;
        }
    }
    out
}

fn blur(moments: &[[f32; 2]], [across, down]: [usize; 2], [dx, dy]: [i32; 2]) -> Vec<[f32; 2]> {
    (0..across * down)
        .map(|i| {
            let [x, y] = [(i % across) as i32, (i / across) as i32];
            let (mut sum, mut weight) = ([0.0; 2], 0.0);
            for (k, &w) in detail::ACTIVITY_KERNEL.iter().enumerate() {
                let [u, v] = [x + dx * (k as i32 - 2), y + dy * (k as i32 - 2)];
                if (0..across as i32).contains(&u) && (0..down as i32).contains(&v) {
                    let m = moments[v as usize * across + u as usize];
                    sum = [sum[0] + w * m[0], sum[1] + w * m[1]];
                    weight += w;
                }
            }
            sum.map(|s| s / weight)
        })
        .collect()
}

/// How the steps of superblocks depend on their activity.
#[derive(Debug, Clone, Copy)]
pub(super) struct Masking {
    /// Mean activity of the picture.
    mean: f32,
    /// Exponent of the variance with which the steps grow.
    power: f32,
    /// Number of classes.
    count: u8,
}

impl Masking {
    /// Returns the rule for a picture whose superblocks have this activity, and a layer with about this step.
    pub(super) fn new(activity: &[Vec<f32>], settings: &SearchSettings, step: f64) -> Masking {
        // Superblocks outside a tile have no activity.
        let there = || activity.iter().flatten().filter(|a| **a > 0.0);
        let mean = there().sum::<f32>() / there().count().max(1) as f32;
        Masking { mean, power: power(settings.powers, step), count: settings.coding.head.classes }
    }

    /// Returns the step classes of the superblocks of each tile.
    pub(super) fn classes(self, activity: &[Vec<f32>]) -> Vec<Vec<u8>> {
        activity.iter().map(|tile| tile.iter().map(|&a| self.class(a)).collect()).collect()
    }

    /// Returns the class of a superblock with this activity.
    fn class(self, activity: f32) -> u8 {
        let wanted = (self.power * (activity - self.mean)).strict_exp() * MIDDLE;
        let far = |k: u8| (CLASS_STEPS[usize::from(k)] as f32 / wanted).strict_ln().abs();
        (0..self.count).min_by(|&a, &b| far(a).total_cmp(&far(b))).unwrap_or(0)
    }
}

/// Returns the exponent for a layer with this step. It grows with the logarithm of the step.
fn power([fine, coarse]: [f32; 2], step: f64) -> f32 {
    let [from, to] = detail::COARSE_LAYER_STEPS.map(f64::strict_ln);
    let share = ((step.strict_ln() - from) / (to - from)).clamp(0.0, 1.0) as f32;
    fine + share * (coarse - fine)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_follow_the_activity_more_closely_in_coarse_layers() {
        let powers = [0.1, 0.2];
        assert_eq!(
            [1.0, detail::COARSE_LAYER_STEPS[0], detail::COARSE_LAYER_STEPS[1], 9000.0].map(|step| power(powers, step)),
            [0.1, 0.1, 0.2, 0.2]
        );
        let middle = power(powers, (detail::COARSE_LAYER_STEPS[0] * detail::COARSE_LAYER_STEPS[1]).sqrt());
        assert!((middle - 0.15).abs() < 1e-6, "{middle}");
        let classes = |power: f32| [3.4, 5.0, 6.6].map(|a| Masking { mean: 5.0, power, count: 4 }.class(a));
        assert_eq!([0.05, 0.5].map(classes), [[1, 1, 2], [0, 1, 3]]);
    }
}
