//! Codes integers near a predicted value with a logistic distribution of adaptive spread, in integer arithmetic (spec
//! §8.2).
//!
//! A few parameters per class adapt faster than counts of every value, which matters for a few hundred Gaussians. A
//! value takes one step of the range coder, where a chain of binary decisions would take five.

use super::range::{Coder, Cumulative};

/// Units of a position per integer.
pub(crate) const FINE: i64 = 16;

/// Steps of the distribution's argument per natural unit.
const UNIT: f64 = 4096.0;

/// Maximum magnitude of the argument.
const MAX_ARGUMENT: i64 = (1 << 15) - 1;

/// The argument at the mean magnitude: `4096·2·ln 2`.
pub(crate) const MEAN: i32 = 5678;

/// Minimum and maximum spread, in sixteenths of octaves above a mean magnitude of 1/256.
const MIN_SPREAD: i32 = 80;
const MAX_SPREAD: i32 = 320;

/// Half the number of values of an open range.
const REACH: i32 = 128;

/// Number of spreads.
const SPREADS: usize = (MAX_SPREAD - MIN_SPREAD) as usize + 1;

/// The exponential function for `|x| ≤ 9` with a relative error of 10⁻¹⁴, for tables that are computed at compile
/// time.
const fn exp(x: f64) -> f64 {
    let (mut sum, mut term, mut n) = (1.0, 1.0, 1.0);
    while n < 20.0 {
        term *= x / 16.0 / n;
        sum += term;
        n += 1.0;
    }
    let fourth = sum * sum * sum * sum;
    fourth * fourth * fourth * fourth
}

/// `2¹⁶/(1 + exp(−(i − 2048)/256))`, rounded.
const fn logistic(i: usize) -> u32 {
    (65536.0 / (1.0 + exp(-(i as f64 - 2048.0) / 256.0)) + 0.5) as u32
}

/// Defines a table that the compiler computes. In WebAssembly it is computed on first use, because tables would be a
/// tenth of the module.
macro_rules! table {
    ($(#[$doc:meta])* $name:ident: $kind:ty = $value:block) => {
        $(#[$doc])*
        #[cfg(not(target_family = "wasm"))]
        static $name: $kind = $value;
        #[cfg(target_family = "wasm")]
        static $name: std::sync::LazyLock<$kind> = std::sync::LazyLock::new(|| $value);
    };
}

table!(/// Each logistic value, and from bit 16 on, the difference to the next.
LOGISTIC: [u32; 4096] = {
    let mut table = [0; 4096];
    let (mut i, mut value) = (0, logistic(0));
    while i < 4096 {
        let next = logistic(i + 1);
        table[i] = (next - value) << 16 | value;
        (i, value) = (i + 1, next);
    }
    table
});

/// Returns entry `i`, below 4096, of the table `logistic`.
pub(crate) fn logistic_value(i: usize) -> u16 {
    LOGISTIC[i] as u16
}

table!(/// `2¹⁶·(4096·2·ln 2)/(16·m)` for the mean magnitude `m` of each spread.
INVERSE: [u32; SPREADS] = {
    let mut table = [0; SPREADS];
    let mut i = 0;
    while i < SPREADS {
        let octaves = (MIN_SPREAD as f64 + i as f64) / 16.0 - 8.0;
        let inverse = 65536.0 * UNIT * 2.0 * std::f64::consts::LN_2 / 16.0 * exp(-octaves * std::f64::consts::LN_2);
        table[i] = (inverse + 0.5) as u32;
        i += 1;
    }
    table
});

table!(/// `2³²` over the inverse, which saves readers a division.
WIDTH: [u32; SPREADS] = {
    let mut table = [0; SPREADS];
    let mut i = 0;
    while i < SPREADS {
        table[i] = ((1 << 32) / INVERSE[i] as u64) as u32;
        i += 1;
    }
    table
});

table!(/// The argument near the middle of each 1024th of the distribution, where readers start a search.
QUANTILE: [i16; 1024] = {
    let mut table = [0; 1024];
    let (mut i, mut at) = (0, 0);
    while i < 1024 {
        while at < 4095 && (LOGISTIC[at] & 0xffff) < 64 * i as u32 + 32 {
            at += 1;
        }
        table[i] = (16 * at as i32 - (1 << 15)) as i16;
        i += 1;
    }
    table
});

/// Returns `16·log₂`, linear between powers of two.
#[inline]
pub(crate) fn log16(value: u64) -> i32 {
    let log = value.ilog2();
    // The bits below the highest.
    let rest = value << (63 - log) >> 59 & 15;
    16 * log as i32 + rest as i32
}

/// Predicted value and spread.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Near {
    /// Predicted value, sixteenths.
    place: i64,
    /// Index of the spread.
    spread: usize,
    inverse: i64,
}

impl Near {
    /// A prediction of `place`, in sixteenths, with a spread of `log` sixteenths of octaves.
    #[inline]
    pub(crate) fn new(place: i64, log: i32) -> Self {
        let spread = (log.clamp(MIN_SPREAD, MAX_SPREAD) - MIN_SPREAD) as usize;
        Near { place, spread, inverse: INVERSE[spread].into() }
    }

    /// Returns the distribution of values relative to `first`.
    #[inline]
    fn from(&self, first: i64) -> Chances {
        let first = (FINE * first - FINE / 2 - self.place) * self.inverse + (1 << 31);
        Chances { first, step: FINE * self.inverse }
    }

    /// Returns the distance of `value` from the prediction, in units of the distribution's argument.
    #[inline]
    pub(crate) fn distance(&self, value: i64) -> i32 {
        ((FINE * value - self.place).abs() * self.inverse >> 16).min(MAX_ARGUMENT) as i32
    }

    /// Returns an estimate of the value with the cumulative probability `chance`.
    #[inline]
    fn about(&self, chance: u32) -> i64 {
        let t = i64::from(QUANTILE[(chance.min(65535) >> 6) as usize]);
        (self.place + (t * i64::from(WIDTH[self.spread]) >> 16) + FINE / 2) >> 4
    }
}

/// The distribution in the form that readers and writers evaluate: its argument is linear in the value.
#[derive(Debug, Clone, Copy)]
struct Chances {
    /// The argument below the first value in 65536ths, with an offset of [`MAX_ARGUMENT`] + 1 so that it indexes the
    /// table.
    first: i64,
    /// Increase of the argument from one value to the next, 65536ths.
    step: i64,
}

impl Chances {
    /// Returns the probability, in 1/65536, of values below `value`.
    #[inline]
    fn below(&self, value: i32) -> u32 {
        let t = (self.first + i64::from(value) * self.step >> 16).clamp(1, 2 * MAX_ARGUMENT + 1) as u32;
        let entry = LOGISTIC[(t >> 4) as usize & 4095];
        (entry & 0xffff) + ((entry >> 16) * (t & 15) >> 4)
    }
}

/// Any integer near a prediction; values outside the range are folded into its ends.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Open {
    near: Near,
    chances: Chances,
    /// The middle of the range.
    middle: i64,
}

impl Open {
    #[inline]
    pub(crate) fn new(near: Near) -> Self {
        let middle = (near.place + FINE / 2) >> 4;
        Open { near, chances: near.from(middle), middle }
    }

    /// Codes an integer whose distance from the prediction is below 2¹⁷.
    #[inline]
    pub(crate) fn code<C: Coder>(&self, coder: &mut C, value: i64) -> i64 {
        let (first, last) = (-REACH, REACH - 1);
        let off = value - self.middle;
        let step = coder.choose(self, off.clamp(first.into(), last.into()) as i32);
        if first < step && step < last {
            return self.middle + i64::from(step);
        }
        // At the ends of the range: the number of bits of the remainder, then the remainder.
        let beyond = off.unsigned_abs().saturating_sub(step.unsigned_abs().into()) as u32 + 1;
        let length = coder.uniform(18, beyond.ilog2());
        let beyond = 1 << length | coder.raw(length, beyond & ((1 << length) - 1));
        self.middle + i64::from(step) + i64::from(step.signum()) * (i64::from(beyond) - 1)
    }
}

impl Cumulative for Open {
    /// Values are relative to the middle: `-128..=127`.
    #[inline]
    fn below(&self, value: i32) -> u32 {
        let step = value + REACH;
        match step {
            ..=0 => 0,
            1..256 => (self.chances.below(value) * (65536 - 256) >> 16) + step as u32,
            _ => 65536,
        }
    }

    fn total(&self) -> u32 {
        65536
    }

    #[inline]
    fn find(&self, target: u32) -> (i32, [u32; 2]) {
        let about = self.near.about(target) - self.middle;
        search(self, target, about.clamp(-i64::from(REACH), i64::from(REACH) - 1) as i32, [-REACH, REACH])
    }
}

/// Integers of a bounded range, near a prediction.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Bounded {
    near: Near,
    chances: Chances,
    low: i64,
    /// Number of values.
    count: i32,
    /// Probability of values below the range.
    base: u32,
    /// Minimum frequency of each value.
    floor: u32,
    total: u32,
}

impl Bounded {
    /// The `count ≤ 4096` integers from `low` on. About `share / 2¹⁶` of the probability is distributed equally over
    /// them.
    #[inline]
    pub(crate) fn new(near: Near, low: i64, count: i32, share: u32) -> Self {
        let chances = near.from(low);
        let (base, floor) = (chances.below(0), share / count as u32 + 1);
        let total = chances.below(count) - base + floor * count as u32;
        Bounded { near, chances, low, count, base, floor, total }
    }
}

impl Cumulative for Bounded {
    /// Values are relative to the lowest.
    #[inline]
    fn below(&self, value: i32) -> u32 {
        self.chances.below(value) - self.base + self.floor * value as u32
    }

    fn total(&self) -> u32 {
        self.total
    }

    #[inline(always)]
    fn find(&self, target: u32) -> (i32, [u32; 2]) {
        let guess = |alike: u32| {
            let about = self.near.about(target.saturating_sub(alike) + self.base) - self.low;
            about.clamp(0, i64::from(self.count) - 1) as i32
        };
        // Subtract the minimum frequencies of all values below: half of their total, or the amount from a first
        // estimate.
        let alike = self.floor * self.count as u32;
        let below = match alike < self.total / 16 {
            true => alike / 2,
            false => self.floor * guess(target / 4) as u32 + self.floor / 2,
        };
        search(self, target, guess(below), [0, self.count])
    }
}

/// Returns the value whose interval contains `target`, and that interval. The search in `first..end` starts at
/// `about`.
#[inline]
fn search<F: Cumulative + Copy>(frequencies: &F, target: u32, about: i32, range: [i32; 2]) -> (i32, [u32; 2]) {
    let [low, high] = [about, about + 1].map(|v| frequencies.below(v));
    match low <= target && target < high {
        true => (about, [low, high]),
        // A copy, so that the values of the common case stay in registers.
        false => search_on(*frequencies, target, about, range),
    }
}

/// Continues [`search`] if the first guess was wrong, which is rare.
#[cold]
#[inline(never)]
fn search_on(frequencies: impl Cumulative, target: u32, about: i32, [first, end]: [i32; 2]) -> (i32, [u32; 2]) {
    let mut value = about;
    let mut at = frequencies.below(value);
    for _ in 0..8 {
        if at > target {
            let high = at;
            value -= 1;
            at = frequencies.below(value);
            if at <= target {
                return (value, [at, high]);
            }
        } else {
            let high = frequencies.below(value + 1);
            if high > target {
                return (value, [at, high]);
            }
            (value, at) = (value + 1, high);
        }
    }
    let (mut low, mut high) = if at > target { (first, value) } else { (value, end) };
    while high - low > 1 {
        let middle = low + (high - low) / 2;
        if frequencies.below(middle) > target { high = middle } else { low = middle }
    }
    (low, [frequencies.below(low), frequencies.below(high)])
}

/// Adaptive correction of the predicted spread for a class of values, in 65536ths of a sixteenth of an octave.
#[derive(Debug, Clone, Copy, Default)]
struct Gain {
    log: i32,
    seen: u8,
}

/// Maximum magnitude of a gain: eight octaves.
const MAX_GAIN: i32 = 128 << 16;

/// The gains of a field for `K` kinds of classes with at most 64 classes in total, so that indexing needs no check.
#[derive(Debug, Clone)]
pub(crate) struct Gains<const K: usize>([Gain; 64]);

/// The classes of a value, one of each kind, as indices among all classes.
pub(crate) type Classes<const K: usize> = [usize; K];

impl<const K: usize> Gains<K> {
    pub(crate) fn new() -> Self {
        Gains([Gain::default(); 64])
    }

    /// Returns the sum of the gains of a value's classes, in sixteenths of an octave.
    #[inline]
    pub(crate) fn log(&self, classes: &Classes<K>) -> i32 {
        classes.iter().map(|c| self.0[c & 63].log).sum::<i32>() >> 16
    }

    /// Adapts to a value at `distance` from the prediction; `MEAN` changes nothing.
    #[inline]
    pub(crate) fn learn(&mut self, classes: &Classes<K>, distance: i32) {
        for c in classes {
            let gain = &mut self.0[c & 63];
            let moved = (distance - MEAN) * GAIN_STEPS[usize::from(gain.seen)] >> 8;
            gain.log = (gain.log + moved).clamp(-MAX_GAIN, MAX_GAIN);
            gain.seen += u8::from(gain.seen < u8::MAX);
        }
    }
}

/// Adaptation rate of an estimate by the number of values seen, in 1/65536; at least 1/64.
const fn steps(doubt: i32) -> [i32; 256] {
    let mut steps = [1024; 256];
    let mut seen = 0;
    while seen + doubt < 64 {
        steps[seen as usize] = 65536 / (seen + doubt);
        seen += 1;
    }
    steps
}

static GAIN_STEPS: [i32; 256] = steps(12);
static SHIFT_STEPS: [i32; 256] = steps(20);

/// Adaptive corrections of the predicted value by class, with at most 64 classes, in 65536ths of a sixteenth.
#[derive(Debug, Clone)]
pub(crate) struct Shifts([Gain; 64]);

impl Shifts {
    pub(crate) fn new() -> Self {
        Shifts([Gain::default(); 64])
    }

    /// Returns the correction in sixteenths.
    #[inline]
    pub(crate) fn get(&self, class: usize) -> i64 {
        (self.0[class & 63].log >> 16).into()
    }

    /// Adapts to a value that was `off` sixteenths above the prediction.
    #[inline]
    pub(crate) fn learn(&mut self, class: usize, off: i64) {
        let shift = &mut self.0[class & 63];
        let moved = off.clamp(-64, 64) as i32 * SHIFT_STEPS[usize::from(shift.seen)];
        shift.log = (shift.log + moved).clamp(-MAX_GAIN, MAX_GAIN);
        shift.seen += u8::from(shift.seen < u8::MAX);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_equal_the_formulas_rounded_the_same_on_every_machine() {
        let rounded = |v: f64, table: u32| (v - v.floor() - 0.5).abs() > 1e-9 && (v + 0.5).floor() == f64::from(table);
        assert!((0..=4096).all(|i| {
            let v = 65536.0 / (1.0 + (-(f64::from(i) - 2048.0) / 256.0).exp());
            let table = match i {
                4096 => (LOGISTIC[4095] & 0xffff) + (LOGISTIC[4095] >> 16),
                _ => LOGISTIC[i as usize] & 0xffff,
            };
            rounded(v, table)
        }));
        assert!((MIN_SPREAD..=MAX_SPREAD).zip(INVERSE).all(|(log, table)| {
            let mean = (f64::from(log) / 16.0 - 8.0).exp2();
            rounded(65536.0 * UNIT * 2.0 * std::f64::consts::LN_2 / (16.0 * mean), table)
        }));
    }

    fn finds_every_share(frequencies: &impl Cumulative, [first, end]: [i32; 2]) {
        assert_eq!((frequencies.below(first), frequencies.below(end)), (0, frequencies.total()));
        for value in first..end {
            let (low, high) = (frequencies.below(value), frequencies.below(value + 1));
            assert!(low < high, "{frequencies:?} at {value}");
            for target in [low, high - 1] {
                assert_eq!(frequencies.find(target), (value, [low, high]), "{frequencies:?} at {target}");
            }
        }
    }

    #[test]
    fn every_value_has_an_interval_and_is_found_by_it() {
        for place in [-3, 0, 7, 8, 9, 1000 * 16 + 5, -(1 << 20)] {
            for log in [0, 80, 100, 151, 200, 280, 320, 400] {
                let near = Near::new(place, log);
                finds_every_share(&Open::new(near), [-REACH, REACH]);
                for (low, count, share) in
                    [(0, 1, 1024), (0, 40, 1024), (-7, 12, 1024), (-2048, 4096, 16384), (990, 20, 0)]
                {
                    finds_every_share(&Bounded::new(near, low, count, share), [0, count]);
                }
            }
        }
    }

    #[test]
    fn gains_stay_in_range_for_extreme_distances() {
        for distance in [0, MAX_ARGUMENT as i32] {
            let mut gains = Gains::new();
            (0..100_000).for_each(|_| gains.learn(&[0, 1], distance));
            assert!(gains.log(&[0, 1]).abs() <= 256);
        }
    }
}
