//! Integer functions of the exact layer: hashes, and the logistic function and its inverse as tables (spec §12.3).

use std::sync::OnceLock;

use crate::bitstream::coder::spread;

/// Multipliers of the hashes, odd and without structure.
const FIRST: u64 = 0x9e37_79b9_7f4a_7c15;
const SECOND: u64 = 0xd6e8_feb8_6659_fd93;

/// Returns a hash of 64 bits.
#[inline(always)]
pub(super) fn hash(value: u64) -> u64 {
    let mixed = value.wrapping_mul(FIRST);
    (mixed ^ mixed >> 29).wrapping_mul(SECOND)
}

/// Returns the number of a colour in the sums of contexts.
#[inline(always)]
pub(super) fn key(color: u64) -> u32 {
    (color.wrapping_mul(FIRST) >> 32) as u32
}

/// Largest magnitude of a logit, in 1/256.
pub(super) const MAX_LOGIT: i32 = 2047;

/// The logistic function and its inverse.
pub(super) struct Logistic {
    /// Probability of a 1, in 1/65536 and within the limits of the coder, for logits from −2048 to 2047 in 1/256.
    probability: [u16; 4096],
    /// Logit of a probability in 1/4096.
    logit: [i16; 4096],
}

impl Logistic {
    /// Returns the tables.
    pub(super) fn tables() -> &'static Logistic {
        static TABLES: OnceLock<Logistic> = OnceLock::new();
        TABLES.get_or_init(|| {
            let probability: [u16; 4096] = std::array::from_fn(spread::logistic_value);
            let mut at = 0;
            let logit = std::array::from_fn(|p| {
                while at < 4095 && u32::from(probability[at]) < 16 * p as u32 + 8 {
                    at += 1;
                }
                at as i16 - 2048
            });
            Logistic { probability: probability.map(|p| p.clamp(32, 65_504)), logit }
        })
    }

    /// Returns the probability of a 1 for a logit, within the limits of the coder.
    #[inline(always)]
    pub(super) fn probability(&self, logit: i32) -> u32 {
        u32::from(self.probability[(logit.clamp(-MAX_LOGIT, MAX_LOGIT) + 2048) as usize & 4095])
    }

    /// Returns the logit of a counter's probability.
    #[inline(always)]
    pub(super) fn logit(&self, counter: Counter) -> i32 {
        i32::from(self.logit[usize::from(counter.0 >> 4)])
    }
}

/// An adaptive probability in 16 bits: 12 bits of probability above 4 bits of a count.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Counter(pub u16);

/// How a counter's probability moves after each number of decisions, in 1/65536 of the distance to the decision.
static RATES: [i32; 16] = {
    let mut rates = [0; 16];
    let mut n = 0;
    while n < 16 {
        rates[n] = 131_072 / (2 * n as i32 + 3);
        n += 1;
    }
    rates
};

/// How a count grows.
static GROWTH: [i32; 16] = {
    let mut growth = [1; 16];
    growth[15] = 0;
    growth
};

impl Counter {
    /// A counter that has seen nothing.
    pub(super) const NEW: Counter = Counter(2048 << 4);

    /// Returns the number of decisions seen, at most 15.
    #[inline(always)]
    pub(super) fn seen(self) -> u16 {
        self.0 & 15
    }

    /// Returns the counter after a decision.
    #[inline(always)]
    pub(super) fn after(self, bit: bool) -> Counter {
        let (p, n) = (i32::from(self.0 >> 4), self.0 & 15);
        let target = if bit { 4095 } else { 0 };
        let moved = ((target - p) * RATES[usize::from(n)] + 32_768) >> 16;
        Counter((i32::from(self.0) + (moved << 4) + GROWTH[usize::from(n)]) as u16)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_logit_is_the_inverse_of_the_logistic_function() {
        let tables = Logistic::tables();
        for p in 0..4096u16 {
            let logit = tables.logit(Counter(p << 4));
            let q = (f64::from(p) + 0.5) / 4096.0;
            let exact = (256.0 * (q / (1.0 - q)).ln()).clamp(-2048.0, 2047.0);
            // One step, and the steps over which the function changes by one of its 65536 values.
            let tolerance = 1.0 + 1.0 / (256.0 * q * (1.0 - q));
            assert!((f64::from(logit) - exact).abs() <= tolerance, "{p}: {logit}, {exact}");
        }
    }

    #[test]
    fn counters_reach_both_ends_and_stay_in_range() {
        for bit in [false, true] {
            for start in 0..4096u16 {
                let mut counter = Counter(start << 4);
                (0..200).for_each(|_| counter = counter.after(bit));
                let end = counter.0 >> 4;
                // A distance of 8 times the last rate, 131 072 / 33, rounds to 0.
                assert!(if bit { end >= 4087 } else { end <= 8 }, "{start} {bit}: {end}");
            }
        }
    }
}
