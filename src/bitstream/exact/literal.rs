//! Codes the samples of a colour that was not predicted as a whole (spec §12.6).
//!
//! Each sample is coded bit by bit, from the highest. Every bit is predicted by four counters, whose logits are added
//! with learned weights. Three counters see how far the middle of the remaining values lies from a prediction of the
//! sample, and how reliable that prediction is. The fourth sees the exact values of the samples already coded, which
//! stands for a table of the picture's colours.

use super::arithmetic::{Counter, Logistic, hash};
use super::tile::{Neighbours, sample};
use crate::bitstream::coder::range::Coder;
use crate::gaussian::Channels;

/// Number of predictions of a sample.
const PREDICTIONS: usize = 3;
/// Number of counters that predict a bit.
const INPUTS: usize = PREDICTIONS + 1;
/// Classes of activity: how much the neighbours differ.
const ACTIVITIES: usize = 16;
/// Classes of the distance to a prediction, on both sides.
const DISTANCES: usize = 64;
/// Classes of how much the counter of exact values has seen.
const SEEN: usize = 8;
/// Weight of each input at first, in 1/65536.
const FIRST_WEIGHT: i32 = 28_000;
/// Bound of the weights, which keeps sums in 32 bits.
const MAX_WEIGHT: i32 = (1 << 19) - 1;

/// The counters of four bits of a sample in one context. Entry 0 is a check value of the context.
type Line = [Counter; 16];
/// Bytes of a line.
pub(super) const LINE_BYTES: u64 = size_of::<Line>() as u64;

/// Models of the samples.
pub(super) struct Literals {
    tables: &'static Logistic,
    order: &'static [usize],
    bits: usize,
    /// Counters by prediction, position in the order, bit, activity and distance.
    distances: Vec<Counter>,
    /// Lines by hash.
    lines: Vec<Line>,
    /// Number of bits of the hash that the lines are addressed by.
    address: u32,
    /// Weights by position in the order, bit, and how much the counter of exact values has seen.
    weights: Vec<[i32; INPUTS]>,
}

/// Returns the channels in the order in which they are coded: alpha, then green, red, blue.
fn order(channels: Channels) -> &'static [usize] {
    match channels {
        Channels::Grey => &[0],
        Channels::GreyAlpha => &[1, 0],
        Channels::Rgb => &[1, 0, 2],
        Channels::Rgba => &[3, 1, 0, 2],
    }
}

/// Returns the value that continues `w`, `n` and `nw` as a plane, limited to `w` and `n`.
fn median(w: i32, n: i32, nw: i32) -> i32 {
    (w + n - nw).clamp(w.min(n), w.max(n))
}

/// Returns the class of a distance: exact up to 3, then two classes an octave.
#[inline(always)]
fn distance_class(distance: u32) -> usize {
    if distance < 2 {
        return distance as usize;
    }
    let octave = distance.ilog2();
    (2 * octave + (distance >> (octave - 1) & 1)) as usize
}

/// State of the sample that is coded: the prefix of the bits already known, and the rows of counters.
struct Predictions {
    values: [i32; PREDICTIONS],
    /// First counter of each prediction at bit 0 and distance 0.
    rows: [usize; PREDICTIONS],
}

impl Literals {
    /// Returns new models, with `2^address` lines.
    pub(super) fn new(channels: Channels, bits: usize, address: u32) -> Self {
        let order = order(channels);
        let row = |i: usize| {
            let distance = i as u16;
            // A bit is more likely 1 if the prediction is above the middle of the values.
            let p = if i >= DISTANCES / 2 {
                2048 + 110 * (distance - 32).min(15)
            } else {
                2047 - 110 * (31 - distance).min(15)
            };
            Counter(p << 4 | 1)
        };
        let count = PREDICTIONS * order.len() * bits * ACTIVITIES;
        let distances = (0..count).flat_map(|_| (0..DISTANCES).map(row)).collect();
        Literals {
            tables: Logistic::tables(),
            order,
            bits,
            distances,
            lines: vec![[Counter::NEW; 16]; 1 << address],
            address,
            weights: vec![[FIRST_WEIGHT; INPUTS]; order.len() * bits * SEEN],
        }
    }

    /// Codes a colour.
    #[inline(never)]
    pub(super) fn code<C: Coder>(&mut self, coder: &mut C, near: &Neighbours, given: u64) -> u64 {
        let (mut color, mut residual) = (0u64, 0u32);
        for step in 0..self.order.len() {
            let channel = self.order[step];
            let predictions = self.predict(step, near, color, residual);
            let value = self.sample(coder, step, color, &predictions, sample(given, channel));
            color |= (value as u64) << (16 * channel);
            residual = value.abs_diff(predictions.values[0]);
        }
        color
    }

    /// Returns the predictions of the channel at position `step`, from the neighbours, the channels already coded and
    /// the residual of the last of these.
    fn predict(&self, step: usize, near: &Neighbours, color: u64, residual: u32) -> Predictions {
        let channel = self.order[step];
        let is_chroma = self.order.len() >= 3 && channel.is_multiple_of(2);
        // Red and blue are predicted by their differences to green.
        let part = |v: u64| if is_chroma { sample(v, channel) - sample(v, 1) } else { sample(v, channel) };
        let [w, n, nw, ne, ww, nn] = near.all().map(part);
        let base = if is_chroma { sample(color, 1) } else { 0 };
        let middle = base + median(w, n, nw);
        let second = if is_chroma && channel == 2 {
            let [w, n, nw, ..] = near.all().map(|v| sample(v, 2) - sample(v, 0));
            sample(color, 0) + median(w, n, nw)
        } else {
            base + ((w + n + ((ne - nw) >> 1) + 1) >> 1)
        };
        let top = (1 << self.bits) - 1;
        let values = [middle, second, base + w + ne - n].map(|v| v.clamp(0, top));
        let class = |v: u32| bits_of(v >> (self.bits - 8));
        let edges = w.abs_diff(nw) + n.abs_diff(nw) + n.abs_diff(ne);
        let far = w.abs_diff(ww) + n.abs_diff(nn);
        let activities = if step > 0 {
            [class(edges + far), class(residual) + class(edges), class(residual)]
        } else {
            [class(edges + far), class(far), class(edges)]
        };
        let rows = std::array::from_fn(|i| {
            let activity = activities[i].min(ACTIVITIES - 1);
            ((i * self.order.len() + step) * self.bits * ACTIVITIES + activity) * DISTANCES + DISTANCES / 2
        });
        Predictions { values, rows }
    }

    /// Codes a sample.
    fn sample<C: Coder>(&mut self, coder: &mut C, step: usize, color: u64, at: &Predictions, given: i32) -> i32 {
        let known = hash(color);
        let (mut value, mut bit, mut line, mut node) = (0i32, self.bits, 0, 1);
        while bit > 0 {
            if bit % 4 == 0 {
                let context = hash(known ^ (64 * step + bit) as u64 * (1 << 32) ^ value as u64);
                line = (context >> (64 - self.address)) as usize;
                let check = Counter(context as u16 | 1);
                if self.lines[line][0] != check {
                    self.lines[line] = [Counter::NEW; 16];
                    self.lines[line][0] = check;
                }
                node = 1;
            }
            bit -= 1;
            let middle = value + (1 << bit);
            let exact = self.lines[line][node & 15];
            let mut counters = [exact; INPUTS];
            let mut places = [0; PREDICTIONS];
            for i in 0..PREDICTIONS {
                let distance = at.values[i] - middle;
                let row = at.rows[i] + bit * ACTIVITIES * DISTANCES;
                // −1 is the class next to 0 on the other side.
                places[i] = if distance < 0 {
                    row - 1 - distance_class(!distance as u32)
                } else {
                    row + distance_class(distance as u32)
                };
                counters[1 + i] = self.distances[places[i]];
            }
            let logits = counters.map(|counter| self.tables.logit(counter));
            let seen = usize::from(exact.seen()).min(SEEN - 1);
            let weights = &mut self.weights[(step * self.bits + bit) * SEEN + seen];
            let sum: i32 = (0..INPUTS).map(|i| logits[i] * (weights[i] >> 4)).sum();
            let one = self.tables.probability(sum >> 12);
            let is_one = Coder::bit(coder, one, given as u32 >> bit & 1) != 0;
            let error = if is_one { 65_536 - one as i32 } else { -(one as i32) };
            for (weight, logit) in weights.iter_mut().zip(logits) {
                *weight = (*weight + ((logit * error + (1 << 13)) >> 14)).clamp(-MAX_WEIGHT, MAX_WEIGHT);
            }
            self.lines[line][node & 15] = exact.after(is_one);
            for (place, counter) in places.into_iter().zip(&counters[1..]) {
                self.distances[place] = counter.after(is_one);
            }
            node = 2 * node + usize::from(is_one);
            value += i32::from(is_one) << bit;
        }
        value
    }
}

/// Returns the number of bits of a number.
fn bits_of(value: u32) -> usize {
    (32 - value.leading_zeros()) as usize
}
