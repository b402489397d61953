//! Codes the samples of a colour that was not predicted as a whole (spec §12.6).
//!
//! Each sample is coded bit by bit, from the highest. Every bit is predicted by four counters, whose logits are added
//! with learned weights. Three counters see how far the middle of the remaining values lies from a prediction of the
//! sample, and how reliable that prediction is. The fourth sees the exact values of the samples already coded, which
//! stands for a table of the picture's colours.

use super::arithmetic::{Counter, Logistic, hash};
use super::neighbours::{Neighbours, sample};
use crate::bitstream::coder::range::Coder;
use crate::bitstream::detail::decisions::Decisions;
use crate::gaussian::Channels;
use crate::simd::{Simd, Task};

/// Number of predictions of a sample.
const PREDICTIONS: usize = 3;
/// Number of counters that predict a bit.
const INPUTS: usize = PREDICTIONS + 1;
/// Classes of activity: how much the neighbours differ.
const ACTIVITIES: usize = 16;
/// Classes of the distance to a prediction: on both sides for short samples, on each side for others.
const DISTANCES: usize = 32;
/// Classes of how much the counter of exact values has seen.
const SEEN: usize = 8;
/// Weight of each input at first, in 1/65536.
const FIRST_WEIGHT: i32 = 28_000;
/// Bound of the weights, which keeps sums in 32 bits.
const MAX_WEIGHT: i32 = (1 << 19) - 1;

/// Largest number of bits of a sample.
const MAX_BITS: usize = 16;

/// The counters of four bits of a sample in one context. Entry 0 is a check value of the context, or 0 if the line has
/// not been used. Tables of integers are not written before they are used.
type Line = [u16; 16];
/// Counters of a prediction and a bit by distance, in one cache line.
#[derive(Debug, Clone, Copy)]
#[repr(align(64))]
struct Distances([Counter; DISTANCES]);
/// Bytes of a line.
pub(super) const LINE_BYTES: u64 = size_of::<Line>() as u64;

/// Models of the samples.
pub(super) struct Literals {
    tables: &'static Logistic,
    order: &'static [usize],
    bits: usize,
    /// Counters by prediction; position in the order, activity and bit; if the samples are not short, the side.
    distances: [Vec<Distances>; PREDICTIONS],
    /// Lines by hash.
    lines: Vec<Line>,
    /// Number of bits of the hash that the lines are addressed by.
    address: u32,
    /// Weights by position in the order, bit, and how much the counter of exact values has seen.
    weights: Vec<[[[i32; INPUTS]; SEEN]; MAX_BITS]>,
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

/// Returns the class of a distance: exact up to 3, then two classes an octave, and below 0 on the other side.
#[inline(always)]
const fn class(distance: i32) -> i32 {
    let side = distance >> 31;
    // −1 is the class next to 0 on the other side.
    let magnitude = (distance ^ side) as u32;
    let octave = (magnitude | 1).ilog2();
    let class = 2 * octave + (2 * magnitude >> octave & 1) + (magnitude == 1) as u32;
    class as i32 ^ side
}

/// Returns whether samples are short: of 8 bits, with code of its own, which WebAssembly leaves out to be small.
const fn are_short(bits: usize) -> bool {
    bits == 8 && !cfg!(target_family = "wasm")
}

/// Number of distances of short samples.
const SHORT: usize = 512;
/// Rows of counters of a short sample, and of others.
const SHORT_ROWS: usize = 8;
const ROWS: usize = 2 * MAX_BITS;

/// Classes of the distances from −256 on, modulo 32. The sides of short samples have half as many classes.
static CLASSES: [u8; SHORT] = {
    let (mut classes, mut i) = ([0; SHORT], 0);
    while i < SHORT {
        classes[i] = class(i as i32 - SHORT as i32 / 2) as u8 % DISTANCES as u8;
        i += 1;
    }
    classes
};

/// Coding of a colour with certain instructions.
pub(super) struct Literal<'a, C> {
    pub literals: &'a mut Literals,
    pub coder: &'a mut C,
    pub near: Neighbours<u64>,
    pub given: u64,
}

impl<C: Coder + Decisions> Task for Literal<'_, C> {
    type Output = u64;

    #[inline(always)]
    fn run<S: Simd>(self, _simd: S) -> u64 {
        let Literal { literals, coder, near, given } = self;
        coder.apart(
            #[inline(always)]
            |coder| {
                if are_short(literals.bits) {
                    literals.code::<C, true, SHORT_ROWS>(coder, &near, given)
                } else {
                    literals.code::<C, false, ROWS>(coder, &near, given)
                }
            },
        )
    }
}

/// The predictions of a sample.
struct Predictions {
    values: [i32; PREDICTIONS],
    /// Which counters each prediction selects.
    rows: [usize; PREDICTIONS],
}

impl Literals {
    /// Returns new models, with `2^address` lines.
    pub(super) fn new(channels: Channels, bits: usize, address: u32) -> Self {
        let order = order(channels);
        // A bit is more likely 1 if the prediction is above the middle of the values.
        let above = |class: usize| Counter((2048 + 110 * class.min(15) as u16) << 4 | 1);
        let below = |class: usize| Counter((2047 - 110 * class.min(15) as u16) << 4 | 1);
        let last = DISTANCES - 1;
        let rows = if are_short(bits) {
            let both = |i| if i < DISTANCES / 2 { above(i) } else { below(last - i) };
            vec![Distances(std::array::from_fn(both)); order.len() * ACTIVITIES * SHORT_ROWS]
        } else {
            let sides = [std::array::from_fn(|i| below(last - i)), std::array::from_fn(above)];
            sides.map(Distances).repeat(order.len() * ACTIVITIES * ROWS / 2)
        };
        Literals {
            tables: Logistic::tables(),
            order,
            bits,
            distances: std::array::from_fn(|_| rows.clone()),
            lines: vec![[0; 16]; 1 << address],
            address,
            weights: vec![[[[FIRST_WEIGHT; INPUTS]; SEEN]; MAX_BITS]; order.len()],
        }
    }

    /// Codes a colour.
    #[inline(always)]
    fn code<C: Coder, const IS_SHORT: bool, const ROWS: usize>(
        &mut self,
        coder: &mut C,
        near: &Neighbours<u64>,
        given: u64,
    ) -> u64 {
        let (mut color, mut residual) = (0u64, 0u32);
        for step in 0..self.order.len() {
            let channel = self.order[step];
            let predictions = self.predict(step, near, color, residual);
            let value = self.sample::<C, IS_SHORT, ROWS>(coder, step, color, &predictions, sample(given, channel));
            color |= (value as u64) << (16 * channel);
            residual = value.abs_diff(predictions.values[0]);
        }
        color
    }

    /// Returns the predictions of the channel at position `step`, from the neighbours, the channels already coded and
    /// the residual of the last of these.
    #[inline(always)]
    fn predict(&self, step: usize, near: &Neighbours<u64>, color: u64, residual: u32) -> Predictions {
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
        let rows = activities.map(|activity| step * ACTIVITIES + activity.min(ACTIVITIES - 1));
        Predictions { values, rows }
    }

    /// Codes a sample.
    #[inline(always)]
    fn sample<C: Coder, const IS_SHORT: bool, const ROWS: usize>(
        &mut self,
        coder: &mut C,
        step: usize,
        color: u64,
        at: &Predictions,
        given: i32,
    ) -> i32 {
        let known = hash(color);
        let context = |bit: usize, value: i32| hash(known ^ (64 * step + bit) as u64 * (1 << 32) ^ value as u64);
        let shift = 64 - self.address;
        // The line of the lower bits, if the upper ones are those of a prediction, is on its way while these are coded.
        if IS_SHORT {
            std::hint::black_box(self.lines[(context(4, at.values[0] & 0xf0) >> shift) as usize][0]);
        }
        let [first, second, third] = &mut self.distances;
        let rows = [
            rows_of::<ROWS>(first, at.rows[0]),
            rows_of::<ROWS>(second, at.rows[1]),
            rows_of::<ROWS>(third, at.rows[2]),
        ];
        let weights = &mut self.weights[step];
        let (mut value, mut bit) = (0i32, if IS_SHORT { 8 } else { self.bits });
        while bit > 0 {
            let context = context(bit, value);
            let line = &mut self.lines[(context >> shift) as usize];
            let check = context as u16 | 1;
            if line[0] != check {
                *line = [Counter::NEW.0; 16];
                line[0] = check;
            }
            let mut node = 1;
            for _ in 0..4 {
                bit -= 1;
                let middle = value + (1 << bit);
                let exact = Counter(line[node]);
                let places: [(usize, usize); PREDICTIONS] = at.values.map(|value| {
                    let distance = value - middle;
                    if IS_SHORT {
                        (bit % ROWS, CLASSES[(distance + 256) as usize % SHORT].into())
                    } else {
                        let class = class(distance);
                        (2 * bit % ROWS + usize::from(class >= 0), class as usize)
                    }
                });
                let [a, b, c] = std::array::from_fn(|i| {
                    let (row, class) = places[i];
                    rows[i][row % ROWS].0[class % DISTANCES]
                });
                let counters = [exact, a, b, c];
                let logits = counters.map(|counter| self.tables.logit(counter));
                let weights = &mut weights[bit % MAX_BITS][usize::from(exact.seen()).min(SEEN - 1)];
                let sum: i32 = (0..INPUTS).map(|i| logits[i] * (weights[i] >> 4)).sum();
                let one = self.tables.probability(sum >> 12);
                let is_one = Coder::bit(coder, one, given as u32 >> bit & 1) != 0;
                let error = if is_one { 65_536 - one as i32 } else { -(one as i32) };
                for i in 0..INPUTS {
                    let moved = weights[i] + ((logits[i] * error + (1 << 13)) >> 14);
                    weights[i] = moved.clamp(-MAX_WEIGHT, MAX_WEIGHT);
                }
                line[node] = exact.after(is_one).0;
                for i in 0..PREDICTIONS {
                    let (row, class) = places[i];
                    rows[i][row % ROWS].0[class % DISTANCES] = counters[1 + i].after(is_one);
                }
                node = (2 * node + usize::from(is_one)) % 16;
                value += i32::from(is_one) << bit;
            }
        }
        value
    }
}

/// Returns the rows of all bits of one position in the order and one activity.
#[inline(always)]
fn rows_of<const ROWS: usize>(all: &mut [Distances], at: usize) -> &mut [Distances; ROWS] {
    all[at * ROWS..].first_chunk_mut().expect("rows of all bits")
}

/// Returns the number of bits of a number.
fn bits_of(value: u32) -> usize {
    (32 - value.leading_zeros()) as usize
}
