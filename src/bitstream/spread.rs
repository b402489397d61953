//! Integers near a place: a logistic distribution whose spread is learnt, all in integers (spec §8.2).
//!
//! A few numbers per class learn faster than counts of every value, which decides at a few hundred primitives, and one
//! value costs one step of the range coder where a chain of decisions would cost five.

use std::sync::LazyLock;

use super::range::{Coder, Cumulative};

/// Fraction bits of places, as a factor.
pub(crate) const FINE: i64 = 16;

/// Steps of the distribution's argument for one natural unit.
const UNIT: f64 = 4096.0;

/// The argument is held to ±this.
const LAST: i64 = (1 << 15) - 1;

/// The argument at the mean magnitude: `4096·2·ln 2`.
pub(crate) const MEAN: i32 = 5678;

/// Spreads are sixteenths of octaves above a mean magnitude of 1/256.
const FINEST: i32 = 80;
const WIDEST: i32 = 320;

/// Half of the values of an open range.
const REACH: i32 = 128;

/// The tables of spec §8.2, and one that only readers use.
struct Tables {
    /// `2¹⁶/(1 + exp(−(i − 2048)/256))`.
    logistic: Vec<u16>,
    /// `2¹⁶·(4096·2·ln 2)/(16·m)` for the mean magnitude `m` of each spread.
    inverse: Vec<u32>,
    /// `2³²` over the inverse, for readers: a division less.
    width: Vec<i64>,
    /// The argument where the distribution reaches the middle of each 1024th: where to begin a search.
    quantile: Vec<i32>,
}

/// The formulas behind the tables, before rounding.
pub(crate) mod formulas {
    use super::{FINEST, UNIT};

    pub fn logistic(i: usize) -> f64 {
        65536.0 / (1.0 + (-(i as f64 - 2048.0) / 256.0).exp())
    }

    pub fn inverse(i: usize) -> f64 {
        let mean = (f64::from(FINEST + i as i32) / 16.0 - 8.0).exp2();
        65536.0 * UNIT * 2.0 * std::f64::consts::LN_2 / (16.0 * mean)
    }
}

fn round(v: f64) -> f64 {
    (v + 0.5).floor()
}

static TABLES: LazyLock<Tables> = LazyLock::new(|| Tables {
    logistic: (0..=4096).map(|i| round(formulas::logistic(i)) as u16).collect(),
    inverse: (0..=(WIDEST - FINEST) as usize).map(|i| round(formulas::inverse(i)) as u32).collect(),
    width: (0..=(WIDEST - FINEST) as usize).map(|i| (1 << 32) / round(formulas::inverse(i)) as i64).collect(),
    quantile: (0..1024)
        .map(|i| {
            let p = (f64::from(i) + 0.5) / 1024.0;
            (UNIT * (p / (1.0 - p)).ln()) as i32
        })
        .collect(),
});

/// `16·log₂`, linear between powers of two.
pub(crate) fn log16(value: u64) -> i32 {
    let log = value.ilog2();
    let rest = if log >= 4 { value >> (log - 4) } else { value << (4 - log) };
    16 * log as i32 + (rest & 15) as i32
}

/// Where a value is expected and how closely.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Near {
    /// Sixteenths.
    place: i64,
    /// Index of the spread.
    spread: usize,
    inverse: i64,
    tables: &'static Tables,
}

impl std::fmt::Debug for Tables {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Tables")
    }
}

impl Near {
    /// Around `place`, sixteenths, with a spread of `log` sixteenths of octaves.
    #[inline]
    pub fn new(place: i64, log: i32) -> Self {
        let tables = &*TABLES;
        let spread = (log.clamp(FINEST, WIDEST) - FINEST) as usize;
        Near { place, spread, inverse: tables.inverse[spread].into(), tables }
    }

    /// The chance, in 1/65536, of values below `value`.
    #[inline]
    fn chance(&self, value: i64) -> u32 {
        let t = (FINE * value - FINE / 2 - self.place) * self.inverse >> 16;
        let t = (t.clamp(-LAST, LAST) + (1 << 15)) as usize;
        let (low, high) = (u32::from(self.tables.logistic[t >> 4]), u32::from(self.tables.logistic[(t >> 4) + 1]));
        low + ((high - low) * (t as u32 & 15) >> 4)
    }

    /// How far `value` is from the place, in the distribution's argument.
    #[inline]
    pub fn distance(&self, value: i64) -> i32 {
        ((FINE * value - self.place).abs() * self.inverse >> 16).min(LAST) as i32
    }

    /// A value about where the chance is `chance`.
    #[inline]
    fn about(&self, chance: u32) -> i64 {
        let t = i64::from(self.tables.quantile[(chance.min(65535) >> 6) as usize]);
        (self.place + (t * self.tables.width[self.spread] >> 16) + FINE / 2) >> 4
    }
}

/// Any integer near a place; those further than the range are folded into its ends.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Open {
    near: Near,
    /// The middle of the range.
    middle: i64,
}

impl Open {
    #[inline]
    pub fn new(near: Near) -> Self {
        Open { near, middle: (near.place + FINE / 2) >> 4 }
    }

    /// Codes an integer that is less than 2¹⁷ away.
    #[inline]
    pub fn code<C: Coder>(&self, coder: &mut C, value: i64) -> i64 {
        let (first, last) = (-REACH, REACH - 1);
        let off = value - self.middle;
        let step = coder.choose(self, off.clamp(first.into(), last.into()) as i32);
        if first < step && step < last {
            return self.middle + i64::from(step);
        }
        // At the ends: how many bits the rest has, and the rest.
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
            1..256 => (self.near.chance(self.middle + i64::from(value)) * (65536 - 256) >> 16) + step as u32,
            _ => 65536,
        }
    }

    fn total(&self) -> u32 {
        65536
    }

    #[inline]
    fn find(&self, target: u32) -> (i32, u32, u32) {
        let about = self.near.about(target) - self.middle;
        search(self, target, about.clamp(-i64::from(REACH), i64::from(REACH) - 1) as i32, [-REACH, REACH])
    }
}

/// Integers of a range, near a place.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Bounded {
    near: Near,
    low: i64,
    /// How many values there are.
    count: i32,
    /// Chance of values below the range.
    base: u32,
    /// What each value has at least.
    floor: u32,
    total: u32,
}

impl Bounded {
    /// The `count ≤ 4096` integers from `low` on; all together have at least about `share / 2¹⁶` in equal parts.
    #[inline]
    pub fn new(near: Near, low: i64, count: i32, share: u32) -> Self {
        let mut bounded =
            Bounded { near, low, count, base: near.chance(low), floor: share / count as u32 + 1, total: 0 };
        bounded.total = bounded.below(count);
        bounded
    }
}

impl Cumulative for Bounded {
    /// Values are relative to the lowest.
    #[inline]
    fn below(&self, value: i32) -> u32 {
        self.near.chance(self.low + i64::from(value)) - self.base + self.floor * value as u32
    }

    fn total(&self) -> u32 {
        self.total
    }

    #[inline]
    fn find(&self, target: u32) -> (i32, u32, u32) {
        // What all have alike is spread over the range.
        let alike = self.floor * self.count as u32;
        let chance = match alike < self.total / 16 {
            true => target,
            false => (u64::from(target) * u64::from(self.total - alike) / u64::from(self.total)) as u32,
        };
        let about = self.near.about(chance + self.base) - self.low;
        search(self, target, about.clamp(0, i64::from(self.count) - 1) as i32, [0, self.count])
    }
}

/// The value whose share holds `target`, and its share; `about` is where to begin in `first..end`.
#[inline]
fn search(frequencies: &impl Cumulative, target: u32, about: i32, [first, end]: [i32; 2]) -> (i32, u32, u32) {
    let mut value = about;
    let mut at = frequencies.below(value);
    for _ in 0..8 {
        if at > target {
            let high = at;
            value -= 1;
            at = frequencies.below(value);
            if at <= target {
                return (value, at, high);
            }
        } else {
            let high = frequencies.below(value + 1);
            if high > target {
                return (value, at, high);
            }
            (value, at) = (value + 1, high);
        }
    }
    let (mut low, mut high) = if at > target { (first, value) } else { (value, end) };
    while high - low > 1 {
        let middle = low + (high - low) / 2;
        if frequencies.below(middle) > target { high = middle } else { low = middle }
    }
    (low, frequencies.below(low), frequencies.below(high))
}

/// What a class of values adds to the expected spread, 65536ths of a sixteenth of an octave.
#[derive(Debug, Clone, Copy, Default)]
struct Gain {
    log: i32,
    seen: u32,
}

/// Gains are held to ±this: eight octaves.
const MOST: i32 = 128 << 16;

/// The gains of a field by `K` kinds of classes.
#[derive(Debug, Clone)]
pub(crate) struct Gains<const K: usize> {
    gains: Vec<Gain>,
    starts: [usize; K],
}

impl<const K: usize> Gains<K> {
    /// A field with `classes[k]` classes of the `k`th kind.
    pub fn new(classes: [usize; K]) -> Self {
        let mut starts = [0; K];
        let mut total = 0;
        for (start, n) in starts.iter_mut().zip(classes) {
            *start = total;
            total += n;
        }
        Gains { gains: vec![Gain::default(); total], starts }
    }

    /// The gains of a value's classes, sixteenths of an octave.
    #[inline]
    pub fn log(&self, classes: &[usize; K]) -> i32 {
        (0..K).map(|k| self.gains[self.starts[k] + classes[k]].log).sum::<i32>() >> 16
    }

    /// Learns from a value `distance` away; `MEAN` changes nothing.
    #[inline]
    pub fn learn(&mut self, classes: &[usize; K], distance: i32) {
        for (start, class) in self.starts.iter().zip(classes) {
            let gain = &mut self.gains[start + class];
            gain.log = (gain.log + ((distance - MEAN) * GAIN_STEPS[gain.seen as usize] >> 8)).clamp(-MOST, MOST);
            gain.seen += u32::from(gain.seen < 64);
        }
    }
}

/// How far an estimate moves that has seen so many values, in 1/65536; no less than 1/64.
const fn steps(doubt: i32) -> [i32; 65] {
    let mut steps = [1024; 65];
    let mut seen = 0;
    while seen + doubt < 64 {
        steps[seen as usize] = 65536 / (seen + doubt);
        seen += 1;
    }
    steps
}

const GAIN_STEPS: [i32; 65] = steps(12);
const SHIFT_STEPS: [i32; 65] = steps(20);

/// A shift of the expected place, 65536ths of a sixteenth, learnt by class.
#[derive(Debug, Clone)]
pub(crate) struct Shifts {
    shifts: Vec<Gain>,
}

impl Shifts {
    pub fn new(classes: usize) -> Self {
        Shifts { shifts: vec![Gain::default(); classes] }
    }

    /// Sixteenths.
    #[inline]
    pub fn get(&self, class: usize) -> i64 {
        (self.shifts[class].log >> 16).into()
    }

    /// Learns that a value was `off` sixteenths above its place.
    #[inline]
    pub fn learn(&mut self, class: usize, off: i64) {
        let shift = &mut self.shifts[class];
        let moved = off.clamp(-64, 64) as i32 * SHIFT_STEPS[shift.seen as usize];
        shift.log = (shift.log + moved).clamp(-MOST, MOST);
        shift.seen += u32::from(shift.seen < 64);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_round_alike_everywhere() {
        let clear = |v: f64| (v - v.floor() - 0.5).abs() > 1e-9;
        assert!((0..=4096).all(|i| clear(formulas::logistic(i))));
        assert!((0..=(WIDEST - FINEST) as usize).all(|i| clear(formulas::inverse(i))));
    }

    fn finds_every_share(frequencies: &impl Cumulative, [first, end]: [i32; 2]) {
        assert_eq!((frequencies.below(first), frequencies.below(end)), (0, frequencies.total()));
        for value in first..end {
            let (low, high) = (frequencies.below(value), frequencies.below(value + 1));
            assert!(low < high, "{frequencies:?} at {value}");
            for target in [low, high - 1] {
                assert_eq!(frequencies.find(target), (value, low, high), "{frequencies:?} at {target}");
            }
        }
    }

    #[test]
    fn every_value_has_a_share_and_is_found_by_it() {
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
    fn gains_stay_in_range_whatever_they_see() {
        for distance in [0, LAST as i32] {
            let mut gains = Gains::new([1, 1]);
            (0..100_000).for_each(|_| gains.learn(&[0, 0], distance));
            assert!(gains.log(&[0, 0]).abs() <= 256);
        }
    }
}
