//! The range coder: codes binary decisions with given probabilities as bytes (spec §8.1).
//!
//! 32-bit range, carry propagation, 16-bit probabilities. Bytes past the end read as zero, and the writer ends with
//! the shortest string that still decodes correctly. A stream has no terminator, and every message has exactly one
//! valid string.

use crate::bitstream::broken::Broken;

/// Bound of the range below which it is scaled up by a byte.
const MIN_RANGE: u32 = 1 << 24;

/// Cumulative frequencies of consecutive integers.
pub trait Cumulative: std::fmt::Debug {
    /// Returns the sum of the frequencies of the integers below `value`.
    fn below(&self, value: i32) -> u32;

    /// Returns the sum of all frequencies, at most 2¹⁷.
    fn total(&self) -> u32;

    /// Returns the integer whose interval contains `target`, and the ends of that interval.
    fn find(&self, target: u32) -> (i32, [u32; 2]);
}

/// Prediction of a value that is coded next. Positions are in sixteenths, spreads in sixteenths of octaves.
#[derive(Debug, Clone, Copy)]
pub enum Prediction {
    /// Prediction of `major − minor`.
    Aspect { major: u8, place: i64, spread: i32 },
    /// Prediction of an angle: one of 64 directions, and the spread as a part of all angles.
    Angle { direction: u32, spread: i32 },
    /// Prediction of a channel's colour, before the prediction errors of the first two channels are known, and the
    /// weights of those errors in 256ths.
    Color { channel: usize, place: i64, cross: [i64; 2], spread: i32 },
}

/// One side of the coder. Writer and reader run the same code: a writer codes the values that are passed, and a reader
/// ignores them and returns what it decodes.
pub trait Coder {
    /// Codes one decision whose probability of being 1 is `one / 2¹⁶`, `one` in `1..=65535`.
    fn bit(&mut self, one: u32, bit: u32) -> u32;

    /// Codes one of `total` equally likely values, `total` in `1..=2¹⁶`.
    fn uniform(&mut self, total: u32, value: u32) -> u32;

    /// Codes one of several integers, and returns it with the ends of its interval.
    fn share(&mut self, frequencies: &impl Cumulative, value: i32) -> (i32, [u32; 2]);

    /// Codes one of several integers.
    #[inline]
    fn choose(&mut self, frequencies: &impl Cumulative, value: i32) -> i32 {
        self.share(frequencies, value).0
    }

    /// Codes `count ≤ 32` bits of `value` with equal probabilities, the higher half first.
    fn raw(&mut self, count: u32, value: u32) -> u32 {
        if count > 16 {
            let high = self.uniform(1 << (count - 16), value >> 16);
            return high << 16 | self.uniform(1 << 16, value & 0xffff);
        }
        self.uniform(1 << count, value)
    }

    /// Codes two numbers with these numbers of bits, in one step if the bits are few.
    #[inline]
    fn pair(&mut self, bits: [u32; 2], [x, y]: [u32; 2]) -> [u32; 2] {
        if bits[0] + bits[1] > 16 {
            return [self.raw(bits[0], x), self.raw(bits[1], y)];
        }
        let both = self.uniform(1 << (bits[0] + bits[1]), x << bits[1] | y);
        [both >> bits[1], both & ((1 << bits[1]) - 1)]
    }

    /// Ends the cost accounting of `field`; only a meter implements it.
    fn account(&mut self, _field: &'static str) {}

    /// Ends the cost accounting of the common part, or of a Gaussian; only a meter implements it.
    fn gaussian(&mut self) {}

    /// Reports the prediction of the next value; only a recorder implements it.
    #[inline(always)]
    fn expect(&mut self, _forecast: Prediction) {}
}

/// Writes decisions.
#[derive(Debug)]
pub struct Encoder {
    low: u64,
    range: u32,
    bytes: Vec<u8>,
}

impl Default for Encoder {
    fn default() -> Self {
        Encoder { low: 0, range: u32::MAX, bytes: Vec::new() }
    }
}

impl Encoder {
    /// Propagates the carry out of `low`.
    fn carry(&mut self) {
        if self.low >> 32 != 0 {
            self.low &= 0xffff_ffff;
            // The value is below 1, so there is always a byte below 255 that takes the carry.
            for byte in self.bytes.iter_mut().rev() {
                *byte = byte.wrapping_add(1);
                if *byte != 0 {
                    break;
                }
            }
        }
    }

    fn normalize(&mut self) {
        while self.range < MIN_RANGE {
            self.bytes.push((self.low >> 24) as u8);
            self.low = self.low << 8 & 0xffff_ffff;
            self.range <<= 8;
        }
    }

    /// Narrows the range to the interval from `low` to `high` of `total`.
    fn narrow(&mut self, total: u32, low: u32, high: u32) {
        let unit = self.range / total;
        self.low += u64::from(unit * low);
        self.range = if high == total { self.range - unit * low } else { unit * (high - low) };
        self.carry();
        self.normalize();
    }

    /// Returns the shortest string in the final interval, and the smallest of that length.
    pub fn finish(mut self) -> Vec<u8> {
        let last = self.low + u64::from(self.range) - 1;
        for kept in 0..=4 {
            let unit = 1u64 << (32 - 8 * kept);
            let value = self.low.next_multiple_of(unit);
            if value <= last {
                self.low = value;
                self.carry();
                self.bytes.extend_from_slice(&(self.low as u32).to_be_bytes()[..kept]);
                break;
            }
        }
        while self.bytes.last() == Some(&0) {
            self.bytes.pop();
        }
        self.bytes
    }
}

impl Coder for Encoder {
    fn bit(&mut self, one: u32, bit: u32) -> u32 {
        let bound = (self.range >> 16) * one;
        if bit != 0 {
            self.range = bound;
        } else {
            self.low += u64::from(bound);
            self.range -= bound;
            self.carry();
        }
        self.normalize();
        bit
    }

    fn uniform(&mut self, total: u32, value: u32) -> u32 {
        self.narrow(total, value, value + 1);
        value
    }

    fn share(&mut self, frequencies: &impl Cumulative, value: i32) -> (i32, [u32; 2]) {
        let [low, high] = [value, value + 1].map(|v| frequencies.below(v));
        self.narrow(frequencies.total(), low, high);
        (value, [low, high])
    }
}

/// Reads decisions.
#[derive(Debug, Clone)]
pub struct Decoder<'a> {
    /// In the upper half, the value of the bytes minus the lower end of the interval; below it, the bytes that follow.
    window: u64,
    range: u32,
    /// Number of valid bits in the lower half of the window.
    ahead: u32,
    bytes: &'a [u8],
    /// Number of bytes that have been moved into the window.
    at: usize,
}

impl<'a> Decoder<'a> {
    /// # Errors
    /// [`Broken`] for a value above the first interval, which no writer produces: 2³² − 1 in the first four bytes.
    pub fn new(bytes: &'a [u8]) -> Result<Self, Broken> {
        let mut decoder = Decoder { window: 0, range: u32::MAX, ahead: 0, bytes, at: 0 };
        decoder.refill();
        (decoder.window, decoder.ahead) = (decoder.window << 32, 0);
        if decoder.code() >= decoder.range {
            return Err(Broken { field: "start of the coded stream", value: decoder.code().into() });
        }
        Ok(decoder)
    }

    /// Returns the value of the bytes minus the lower end of the interval.
    #[inline(always)]
    fn code(&self) -> u32 {
        (self.window >> 32) as u32
    }

    /// Fills the lower half of the window, which is empty.
    #[inline(always)]
    fn refill(&mut self) {
        self.window |= u64::from(four(self.bytes, self.at));
        self.at += 4;
        self.ahead = 32;
    }

    #[inline(always)]
    fn normalize(&mut self) {
        // The loop seldom runs, and hardly ever twice, so the branch is predicted well.
        while self.range < MIN_RANGE {
            if self.ahead == 0 {
                self.refill();
            }
            self.range <<= 8;
            self.window <<= 8;
            self.ahead -= 8;
        }
    }

    /// Returns the length of the interval of a 1, and whether the value lies in it.
    #[inline(always)]
    pub fn look(&self, one: u32) -> (u32, bool) {
        let bound = (self.range >> 16) * one;
        (bound, self.code() < bound)
    }

    /// Narrows the range to the interval of a 1, whose length is `bound`, or to that of a 0.
    #[inline(always)]
    pub fn take(&mut self, bit: bool, bound: u32) {
        if bit {
            self.range = bound;
        } else {
            self.window -= u64::from(bound) << 32;
            self.range -= bound;
        }
        self.normalize();
    }

    /// Reads a decision with equal probabilities. The code has no branch, because the processor could not predict it.
    #[inline(always)]
    pub fn even(&mut self) -> bool {
        let bound = (self.range >> 16) << 15;
        let is_one = self.code() < bound;
        let zero = u32::from(is_one).wrapping_sub(1);
        self.window -= u64::from(bound & zero) << 32;
        self.range = bound + (self.range.wrapping_sub(2 * bound) & zero);
        self.normalize();
        is_one
    }

    /// Narrows the range to the interval from `low` to `high` of `total`, in units of `unit`.
    #[inline]
    fn narrow(&mut self, unit: u32, total: u32, low: u32, high: u32) {
        self.window -= u64::from(unit * low) << 32;
        self.range = if high == total { self.range - unit * low } else { unit * (high - low) };
        self.normalize();
    }

    /// Checks that the bytes are those that [`Encoder::finish`] writes for this message.
    pub fn finish(&self) -> Result<(), Broken> {
        let length = self.bytes.len();
        let broken = Err(Broken { field: "end of the coded stream", value: length as u64 });
        let Some(&last) = self.bytes.last() else { return Ok(()) };
        // Number of bytes that have been shifted into the window.
        let at = self.at - self.ahead as usize / 8;
        if length > at || last == 0 {
            return broken;
        }
        // The interval contains a shorter or smaller string if one unit of the last byte fits below, or its next
        // multiple above. A last byte that has left the window has a larger unit than the whole interval.
        let place = 8 * (at - length) as u32;
        if place >= 32 {
            return Ok(());
        }
        let (code, range, unit) = (u64::from(self.code()), u64::from(self.range), 1u64 << place);
        let (below, above) = (u64::from(last) * unit, (256 - u64::from(last)) * unit);
        if below <= code || code + above < range || unit <= code { broken } else { Ok(()) }
    }
}

/// Returns the four bytes from `at` on; those past the end are 0. A separate function without access to the decoder,
/// so that the decoder stays in registers.
#[cold]
#[inline(never)]
fn four(bytes: &[u8], at: usize) -> u32 {
    let some = bytes.get(at..).unwrap_or_default();
    u32::from_be_bytes(match some.first_chunk() {
        Some(four) => *four,
        None => std::array::from_fn(|i| some.get(i).copied().unwrap_or(0)),
    })
}

impl Coder for Decoder<'_> {
    #[inline]
    fn bit(&mut self, one: u32, _bit: u32) -> u32 {
        let (bound, bit) = self.look(one);
        self.take(bit, bound);
        bit.into()
    }

    #[inline]
    fn uniform(&mut self, total: u32, _value: u32) -> u32 {
        let unit = self.range / total;
        let value = (self.code() / unit).min(total - 1);
        self.narrow(unit, total, value, value + 1);
        value
    }

    #[inline(always)]
    fn share(&mut self, frequencies: &impl Cumulative, _value: i32) -> (i32, [u32; 2]) {
        let total = frequencies.total();
        let unit = self.range / total;
        let (value, [low, high]) = frequencies.find((self.code() / unit).min(total - 1));
        self.narrow(unit, total, low, high);
        (value, [low, high])
    }
}

/// WebAssembly uses one reader for Gaussians and reports, which keeps the module small.
pub(crate) const ONE_READER: bool = cfg!(target_family = "wasm");

/// Forwards decisions and sums their cost.
#[derive(Debug)]
pub struct Meter<C> {
    pub coder: C,
    /// Bits since the last account of a field and of a Gaussian; `None` if nothing is counted.
    bits: Option<[f64; 2]>,
    pub fields: Vec<(&'static str, f64)>,
    /// Bits of the common part, and of each Gaussian.
    pub each: Vec<f32>,
}

impl<C> Meter<C> {
    pub fn new(coder: C) -> Self {
        Meter { coder, bits: Some([0.0; 2]), fields: Vec::new(), each: Vec::new() }
    }

    /// Returns a meter that counts nothing, for programs that should contain one reader instead of two.
    pub fn silent(coder: C) -> Self {
        Meter { bits: None, ..Meter::new(coder) }
    }
}

/// Adds the cost of an interval of `share` out of `total`.
#[cold]
#[inline(never)]
fn count(bits: &mut [f64; 2], total: u32, share: u32) {
    let cost = f64::from(total).log2() - f64::from(share).log2();
    bits.iter_mut().for_each(|bits| *bits += cost);
}

impl<C: Coder> Coder for Meter<C> {
    #[inline]
    fn bit(&mut self, one: u32, bit: u32) -> u32 {
        let bit = self.coder.bit(one, bit);
        if let Some(bits) = &mut self.bits {
            count(bits, 1 << 16, if bit != 0 { one } else { 65536 - one });
        }
        bit
    }

    #[inline]
    fn uniform(&mut self, total: u32, value: u32) -> u32 {
        if let Some(bits) = &mut self.bits {
            count(bits, total, 1);
        }
        self.coder.uniform(total, value)
    }

    #[inline(always)]
    fn share(&mut self, frequencies: &impl Cumulative, value: i32) -> (i32, [u32; 2]) {
        let (value, [low, high]) = self.coder.share(frequencies, value);
        if let Some(bits) = &mut self.bits {
            count(bits, frequencies.total(), high - low);
        }
        (value, [low, high])
    }

    #[inline]
    fn account(&mut self, field: &'static str) {
        let Some([bits, _]) = &mut self.bits else { return };
        let bits = std::mem::take(bits);
        match self.fields.iter_mut().find(|f| f.0 == field) {
            Some(f) => f.1 += bits,
            None => self.fields.push((field, bits)),
        }
    }

    #[inline]
    fn gaussian(&mut self) {
        let Some([_, bits]) = &mut self.bits else { return };
        self.each.push(std::mem::take(bits) as f32);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn next(state: &mut u64) -> u64 {
        *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        *state >> 33
    }

    fn decisions(seed: u64, count: u64) -> Vec<(u32, u32)> {
        let mut state = seed;
        (0..count)
            .map(|_| {
                let one = match next(&mut state) % 4 {
                    0 => 1,
                    1 => 65535,
                    _ => 1 + (next(&mut state) % 65535) as u32,
                };
                (one, u32::from((next(&mut state) % 65536) < u64::from(one)))
            })
            .collect()
    }

    #[test]
    fn messages_round_trip_and_other_endings_are_refused() {
        for seed in 0..400 {
            let message = decisions(seed, seed % 97);
            let mut encoder = Encoder::default();
            // Every decision is followed by a uniform value, including the last one of its range.
            let uniform = |one: u32| (1 + one % 977, (one / 7).min(one % 977));
            message.iter().for_each(|&(one, bit)| {
                encoder.bit(one, bit);
                encoder.uniform(uniform(one).0, uniform(one).1);
            });
            let bytes = encoder.finish();
            let decode = |bytes: &[u8]| {
                let mut decoder = Decoder::new(bytes).unwrap();
                let same = message.iter().all(|&(one, bit)| {
                    decoder.bit(one, bit) == bit && decoder.uniform(uniform(one).0, 0) == uniform(one).1
                });
                (same, decoder.finish())
            };
            assert_eq!(decode(&bytes), (true, Ok(())), "seed {seed}");
            for extra in [0, 1, 255] {
                let mut longer = bytes.clone();
                longer.push(extra);
                let (same, end) = decode(&longer);
                assert!(!same || end.is_err(), "seed {seed} with {extra} appended");
            }
            if let Some(last) = bytes.len().checked_sub(1) {
                for byte in 0..=255 {
                    let mut other = bytes.clone();
                    other[last] = byte;
                    let (same, end) = decode(&other);
                    assert!(byte == bytes[last] || !same || end.is_err(), "seed {seed} ending in {byte}");
                }
                let (same, end) = decode(&bytes[..last]);
                assert!(!same || end.is_err(), "seed {seed} cut");
            }
        }
    }

    #[test]
    fn carries_propagate_through_long_runs_of_ones() {
        let mut encoder = Encoder::default();
        for _ in 0..100 {
            encoder.bit(1, 0);
            encoder.bit(65535, 1);
        }
        let bytes = encoder.finish();
        let mut decoder = Decoder::new(&bytes).unwrap();
        for _ in 0..100 {
            assert_eq!((decoder.bit(1, 0), decoder.bit(65535, 0)), (0, 1));
        }
        decoder.finish().unwrap();
    }
}
