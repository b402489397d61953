//! Measures how fast this machine computes at the moment, so that the time of an encode can be estimated.
//!
//! On kodim05, 13, 15 and 23 with `--ratio 50 --time 1`, on two busy cores, the measurement gains 7.8 points of
//! SSIMULACRA2, and the encode ends after 1.9 instead of 4.3 s; with `--time 0.3` it gains 0.4 points. `python
//! lab/constants.py encode::REFERENCE_SPEED_SECONDS 1000 --options "--time 1" --pictures PICTURES` measures encodes
//! without it, which assume the machine of the measurements.

use std::hint::black_box;

use crate::constants::encode;
use crate::instant::Instant;
use crate::parallel;
use crate::simd::{self, LANES, Lanes, Simd, Task};

/// Sums that a measurement accumulates, which fit into the first-level cache, and how many times it does so.
const SUMS: usize = 512;
const ROUNDS: usize = 200;
/// Measurements for each thread in a batch, and the number of batches, of which the fastest counts. The first also
/// starts the threads.
const COUNT: usize = 5;
const BATCHES: usize = 4;

/// Returns how many times longer than on the reference machine a computation takes at the moment, with all threads; at
/// least 1. It takes 5 to 10 milliseconds. In WebAssembly, which may have no clock, it returns 1.
pub(super) fn slowness() -> f64 {
    if cfg!(target_family = "wasm") {
        return 1.0;
    }
    let count = COUNT * parallel::threads().max(1);
    let seconds = (0..BATCHES).map(|_| {
        let start = Instant::now();
        parallel::map(count, |_| black_box(simd::dispatch(Exponentials)));
        start.elapsed().as_secs_f64()
    });
    (seconds.fold(f64::INFINITY, f64::min) / (COUNT as f64 * encode::REFERENCE_SPEED_SECONDS)).max(1.0)
}

/// Sums exponentials, which take most of the time of a fit.
struct Exponentials;

impl Task for Exponentials {
    type Output = f32;

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> f32 {
        let mut sums = [Lanes([0.0; LANES]); SUMS];
        for round in 0..ROUNDS {
            let step = simd.splat(-0.001 * black_box(round) as f32);
            for (i, sums) in sums.iter_mut().enumerate() {
                let x = simd.mul(simd.add(simd.splat(i as f32), simd.index()), step);
                simd.store(sums, simd.add(simd.load(sums), simd.exp2(x)));
            }
        }
        sums.iter().map(|sums| simd.sum(simd.load(sums))).sum()
    }
}
