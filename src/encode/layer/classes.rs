//! Chooses the step classes of superblocks. Busy regions get coarser steps, because they mask errors.

use super::residual::TileResidual;
use crate::bitstream::detail::levels::{SUPER, SUPERS, TILE};
use crate::detail::steps::CLASS_STEPS;
use crate::strict_math::StrictMath;

/// Side of the squares whose moments are computed, pixels.
const SQUARE: usize = 8;
/// Variance of luma that is negligible, code values². It is added to the variance before the logarithm.
const FLOOR: f32 = 30.0;
/// Weights of neighbouring squares along one axis.
const KERNEL: [f32; 5] = [1.0, 3.0, 4.0, 3.0, 1.0];
/// Class step that leaves the layer's step unchanged, in 1/64.
const MIDDLE: f32 = 64.0;

/// Returns the activity of each superblock of `tile`: the logarithm of the luma variance around a square, averaged over
/// the squares of the superblock.
pub(super) fn activity(tile: &TileResidual) -> Vec<f32> {
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
    let log = |[mean, square]: [f32; 2]| ((square - mean * mean).max(0.0) + FLOOR).strict_ln();
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
            for (k, &w) in KERNEL.iter().enumerate() {
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

/// Returns the class of each superblock, given its `activity` and the mean activity `mean` of the picture. The wanted
/// steps grow with the variance to the power `power`.
pub(super) fn classes(activity: &[f32], mean: f32, power: f32, count: u8) -> Vec<u8> {
    let class = |&a: &f32| {
        let wanted = (power * (a - mean)).strict_exp() * MIDDLE;
        let far = |k: u8| (CLASS_STEPS[usize::from(k)] as f32 / wanted).strict_ln().abs();
        (0..count).min_by(|&a, &b| far(a).total_cmp(&far(b))).unwrap_or(0)
    };
    activity.iter().map(class).collect()
}
