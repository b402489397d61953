//! Binary decisions of the layer, which are written, read or priced by the same code (spec §11.3).

use crate::bitstream::coder::range::{Coder, Decoder, Encoder};
#[cfg(feature = "encode")]
use crate::strict_math::StrictMath;

/// An adaptive probability of a 1: the mean of a fast and a slow estimate, in 1/65536.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Adaptive {
    /// The fast estimate in the lower half, the slow one in the upper. They are written together, because reading one
    /// word that was just written as two halves stalls the processor.
    estimates: u32,
    /// The mean of the estimates, within the limits of a probability. A reader needs it first, so it is computed when
    /// the estimates change.
    one: u16,
    /// Number of decisions that the estimates are based on, up to [`MAX_SEEN`].
    seen: u8,
}

/// Number of decisions after which the estimates adapt at their final rate.
const MAX_SEEN: usize = 127;

/// How estimates adapt after a number of decisions.
#[derive(Clone, Copy)]
struct Rates {
    /// Rates of the fast and the slow estimate, in 1/65536.
    quick: u16,
    slow: u16,
    /// The number of decisions after the next one.
    next: u8,
}

static RATES: [Rates; MAX_SEEN + 1] = {
    let mut rates = [Rates { quick: 0, slow: 0, next: MAX_SEEN as u8 }; MAX_SEEN + 1];
    let mut n = 0;
    while n <= MAX_SEEN {
        rates[n].quick = pace(n as u32, 65_536 / 24);
        rates[n].slow = pace(n as u32, 65_536 / 128);
        if n < MAX_SEEN {
            rates[n].next = n as u8 + 1;
        }
        n += 1;
    }
    rates
};

const fn pace(n: u32, least: u32) -> u16 {
    let pace = 131_072 / (2 * n + 3);
    let pace = if pace > least { pace } else { least };
    if pace > 32_767 { 32_767 } else { pace as u16 }
}

/// Least and greatest probability of a 1.
const LIMITS: [u32; 2] = [32, 65_504];

impl Adaptive {
    /// Placeholder for a model that has not been initialized.
    pub(crate) const NONE: Adaptive = Adaptive { estimates: 0, one: 0, seen: 0 };

    /// A probability of `(256·one + 128) / 65536` with the confidence of `seen` decisions.
    pub(crate) const fn new(one: u8, seen: u8) -> Self {
        // Within the limits for every `one`.
        let p = (one as u16) << 8 | 128;
        Adaptive { estimates: (p as u32) << 16 | p as u32, one: p, seen }
    }

    /// Returns the fast and the slow estimate.
    #[inline(always)]
    fn estimates(self) -> [u32; 2] {
        [self.estimates & 0xffff, self.estimates >> 16]
    }

    /// Returns the probability of a 1, in 1/65536.
    #[inline(always)]
    pub(crate) fn one(self) -> u32 {
        self.one.into()
    }

    #[inline(always)]
    pub(crate) fn learn(&mut self, bit: bool) {
        let rates = &RATES[usize::from(self.seen) & MAX_SEEN];
        let target = if bit { 65_535 } else { 0 };
        let moved = |p: u32, pace: u16| (p as i32 + (((target - p as i32) * i32::from(pace)) >> 16)) as u32;
        let [quick, slow] = self.estimates();
        // Neither estimate leaves its half.
        let (quick, slow) = (moved(quick, rates.quick), moved(slow, rates.slow));
        self.estimates = slow << 16 | quick;
        self.one = ((quick + slow) >> 1).clamp(LIMITS[0], LIMITS[1]) as u16;
        self.seen = rates.next;
    }

    /// Returns the slow estimate and the number of decisions, for learning initial states.
    #[cfg(test)]
    pub fn learnt(self) -> (u16, u8) {
        (self.estimates()[1] as u16, self.seen)
    }
}

/// A coder of decisions: a writer codes the values that are passed, and a reader ignores them and returns what it
/// decodes.
pub(crate) trait Decisions {
    /// Codes a decision with a model.
    fn bit(&mut self, model: &mut Adaptive, bit: bool) -> bool;

    /// Codes a decision with equal probabilities.
    fn even(&mut self, bit: bool) -> bool;

    /// Runs `work` with this coder, on a copy if that keeps it in registers.
    #[inline(always)]
    fn apart<T>(&mut self, work: impl FnOnce(&mut Self) -> T) -> T {
        work(self)
    }

    /// Codes `count` decisions with equal probabilities, the highest bit first.
    #[inline]
    fn raw(&mut self, count: u32, value: u32) -> u32 {
        (0..count).rev().fold(0, |read, i| read << 1 | u32::from(self.even(value >> i & 1 == 1)))
    }
}

const HALF: u32 = 32_768;

impl Decisions for Encoder {
    #[inline]
    fn bit(&mut self, model: &mut Adaptive, bit: bool) -> bool {
        Coder::bit(self, model.one(), u32::from(bit));
        model.learn(bit);
        bit
    }

    #[inline]
    fn even(&mut self, bit: bool) -> bool {
        Coder::bit(self, HALF, u32::from(bit)) != 0
    }
}

impl Decisions for Decoder<'_> {
    #[inline(always)]
    fn bit(&mut self, model: &mut Adaptive, _bit: bool) -> bool {
        let (bound, bit) = self.look(model.one());
        // WebAssembly shares one copy, which keeps the module small.
        if cfg!(target_family = "wasm") {
            self.take(bit, bound);
            model.learn(bit);
            return bit;
        }
        // The caller branches on the bit as well, so that the compiler can merge both branches.
        if bit {
            self.take(true, bound);
            model.learn(true);
            return true;
        }
        self.take(false, bound);
        model.learn(false);
        false
    }

    #[inline(always)]
    fn even(&mut self, _bit: bool) -> bool {
        Decoder::even(self)
    }

    #[inline(always)]
    fn apart<T>(&mut self, work: impl FnOnce(&mut Self) -> T) -> T {
        let mut copy = self.clone();
        let done = work(&mut copy);
        *self = copy;
        done
    }
}

/// Sums the cost of decisions in bits, with the models in their current state; does not adapt them.
#[cfg(feature = "encode")]
#[derive(Debug, Default)]
pub(crate) struct Price {
    pub bits: f32,
}

/// Number of probabilities that [`Price`] distinguishes.
#[cfg(feature = "encode")]
const PRICES: usize = 4096;

/// Returns the cost of a decision for each probability, in bits.
#[cfg(feature = "encode")]
fn prices() -> &'static [f32; PRICES] {
    static PRICE: std::sync::OnceLock<[f32; PRICES]> = std::sync::OnceLock::new();
    PRICE.get_or_init(|| std::array::from_fn(|i| -((i as f32 + 0.5) / PRICES as f32).strict_log2()))
}

/// Returns the bits of a decision with a model.
#[cfg(feature = "encode")]
#[inline(always)]
pub(crate) fn price(model: &Adaptive, bit: bool) -> f32 {
    price_of(if bit { model.one() } else { 65_536 - model.one() })
}

/// Returns the bits of a decision with this probability, in 1/65536.
#[cfg(feature = "encode")]
#[inline(always)]
pub(crate) fn price_of(probability: u32) -> f32 {
    prices()[(probability >> 4) as usize & (PRICES - 1)]
}

#[cfg(feature = "encode")]
impl Decisions for Price {
    #[inline(always)]
    fn bit(&mut self, model: &mut Adaptive, bit: bool) -> bool {
        self.bits += price(model, bit);
        bit
    }

    #[inline(always)]
    fn even(&mut self, bit: bool) -> bool {
        self.bits += 1.0;
        bit
    }

    #[inline(always)]
    fn raw(&mut self, count: u32, value: u32) -> u32 {
        self.bits += count as f32;
        value
    }
}

/// Reads from another source and sums the cost in bits, by kind.
#[derive(Debug)]
pub(crate) struct Counted<D> {
    pub source: D,
    pub bits: f64,
}

impl<D: Decisions> Decisions for Counted<D> {
    fn bit(&mut self, model: &mut Adaptive, bit: bool) -> bool {
        let one = f64::from(model.one()) / 65_536.0;
        let bit = self.source.bit(model, bit);
        self.bits -= if bit { one } else { 1.0 - one }.log2();
        bit
    }

    fn even(&mut self, bit: bool) -> bool {
        self.bits += 1.0;
        self.source.even(bit)
    }
}
