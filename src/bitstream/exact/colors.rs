//! Predicts whole colours: from the colours that followed the same neighbours before, then from the nearest neighbours
//! (spec §12.5).

use super::neighbours::{Neighbours, Row};
use super::packed::Packed;
#[cfg(feature = "encode")]
use crate::bitstream::detail::decisions::price;
use crate::bitstream::detail::decisions::{Adaptive, Decisions};

/// Neighbours of the contexts, nearest first: columns to the left, and rows up.
const NEIGHBOURS: [[i32; 2]; COUNT] = [
    [-1, 0],
    [0, -1],
    [-1, -1],
    [1, -1],
    [-2, 0],
    [0, -2],
    [-2, -1],
    [2, -1],
    [-1, -2],
    [1, -2],
    [-3, 0],
    [0, -3],
    [-2, -2],
    [2, -2],
    [-3, -1],
    [3, -1],
    [-1, -3],
    [1, -3],
    [-4, 0],
    [-3, -2],
    [3, -2],
    [-2, -3],
    [2, -3],
    [4, -1],
    [-4, -1],
    [0, -4],
    [-5, 0],
    [4, -2],
    [-4, -2],
    [-1, -4],
];
/// Number of neighbours of the longest context.
const COUNT: usize = 30;
/// Factors of the neighbours in the sums of contexts.
const FACTORS: [u32; COUNT] = {
    let (mut factors, mut factor, mut k) = ([0; COUNT], 0x2545_f491u32, 0);
    while k < COUNT {
        factor = factor.wrapping_mul(0x9e37_79b1) | 1;
        factors[k] = factor;
        k += 1;
    }
    factors
};
/// Number of contexts. They have the first 30, 18, 10, 6 and 3 neighbours.
const ORDERS: usize = 5;
/// Largest confidence of an entry.
const MAX_CONFIDENCE: u32 = 63;
/// Columns and rows around a pixel that contexts refer to.
pub(super) const REACH: usize = 5;
pub(super) const ROWS_ABOVE: usize = 4;

/// Rows that contexts refer to: that of the pixel, and those above.
pub(super) const ROWS: usize = ROWS_ABOVE + 1;

/// The colour that last followed a context, and the confidence. Tables of integers are not written before they are used.
type Entry<P> = [P; 2];

/// Returns the bytes of the entries that share an address, with colours of this size.
pub(super) const fn entry_bytes(color: usize) -> u64 {
    (ORDERS * (2 * color + size_of::<u16>())) as u64
}

/// Models of predicted colours.
pub(super) struct Colors<P> {
    /// Check values of the contexts of entries, by context and hash; 0 where there is no entry. They are apart from the
    /// entries, so that they stay in the cache where most contexts are new.
    checks: [Vec<u16>; ORDERS],
    entries: [Vec<Entry<P>>; ORDERS],
    /// Number of bits of the hash that entries are addressed by.
    address: u32,
    /// Whether the colour is that of an entry: by length, misses so far, neighbours of the same colour, confidence,
    /// and the entry of the next shorter context.
    follows: Vec<Adaptive>,
    /// Whether the colour is that of a neighbour: by neighbour, and which neighbours are equal.
    equals: Vec<Adaptive>,
}

/// The contexts of a pixel: places, check values, and the entries of those that have one.
pub(super) struct Contexts<P> {
    places: [usize; ORDERS],
    checks: [u16; ORDERS],
    entries: [Option<Entry<P>>; ORDERS],
}

/// What the colour of a pixel is predicted from.
pub(super) struct Around<'a, P> {
    pub contexts: &'a Contexts<P>,
    pub near: &'a Neighbours<P>,
    /// A colour that the pixel does not have.
    pub excluded: Option<P>,
}

/// The colours that a pixel does not have.
#[derive(Debug)]
pub(super) struct Excluded<P> {
    colors: [P; 10],
    count: usize,
}

impl<P: Packed> Excluded<P> {
    #[inline(always)]
    pub(super) fn contains(&self, color: P) -> bool {
        self.colors[..self.count].contains(&color)
    }

    #[inline(always)]
    fn add(&mut self, color: P) {
        self.colors[self.count] = color;
        self.count += 1;
    }
}

impl<P: Packed> Colors<P> {
    /// Returns new models, with `2^address` entries a context.
    pub(super) fn new(address: u32) -> Self {
        const CONFIDENCES: usize = MAX_CONFIDENCE as usize + 1;
        let start = |i: usize| Adaptive::new((255 - 150 / (i + 2)) as u8, 1);
        let by_confidence: [Adaptive; CONFIDENCES] = std::array::from_fn(start);
        let follows = (0..ORDERS * 4 * 4).flat_map(|_| by_confidence).flat_map(|model| [model; 3]).collect();
        Colors {
            checks: std::array::from_fn(|_| vec![0; 1 << address]),
            entries: std::array::from_fn(|_| vec![[P::ZERO; 2]; 1 << address]),
            address,
            follows,
            equals: vec![Adaptive::new(128, 0); 4 * 256],
        }
    }

    /// Returns the contexts of the pixel at column `x` of the first row.
    #[inline(always)]
    pub(super) fn contexts(&self, rows: &[Row<P>; ROWS], x: usize) -> Contexts<P> {
        let around: [&[u32; 2 * REACH + 1]; ROWS] =
            std::array::from_fn(|y| rows[y].keys[x..].first_chunk().expect("a margin on both sides"));
        let mut contexts = Contexts { places: [0; ORDERS], checks: [0; ORDERS], entries: [None; ORDERS] };
        let mut sum = 0u32;
        // Written out, so that positions and factors are constants.
        macro_rules! context {
            ($order:literal: $($k:literal)*) => {
                $(
                    let [dx, dy] = const { NEIGHBOURS[$k] };
                    let key = around[-dy as usize][(dx + REACH as i32) as usize];
                    sum = sum.wrapping_add(key.wrapping_mul(const { FACTORS[$k] }));
                )*
                let mixed = (sum ^ sum >> 15).wrapping_mul(0x2c1b_3c6d);
                let hash = mixed ^ mixed >> 13;
                let place = (hash >> (32 - self.address)) as usize;
                contexts.places[$order] = place;
                let check = hash as u16 | 1;
                contexts.checks[$order] = check;
                if self.checks[$order][place] == check {
                    contexts.entries[$order] = Some(self.entries[$order][place]);
                }
            };
        }
        context!(4: 0 1 2);
        context!(3: 3 4 5);
        context!(2: 6 7 8 9);
        context!(1: 10 11 12 13 14 15 16 17);
        context!(0: 18 19 20 21 22 23 24 25 26 27 28 29);
        contexts
    }

    /// Codes whether the colour of a pixel is a predicted one, other than the excluded one. Returns that colour, or the
    /// colours that it does not have.
    #[inline(always)]
    pub(super) fn code<D: Decisions>(
        &mut self,
        decisions: &mut D,
        around: &Around<'_, P>,
        given: P,
    ) -> Result<P, Excluded<P>> {
        let Around { contexts, near, excluded } = *around;
        let mut tried = Excluded { colors: [P::ZERO; 10], count: 0 };
        excluded.into_iter().for_each(|color| tried.add(color));
        let mut misses = 0;
        for order in 0..ORDERS {
            let Some([color, confidence]) = contexts.entries[order] else { continue };
            if tried.contains(color) {
                continue;
            }
            let shorter = match contexts.entries.get(order + 1).copied().flatten() {
                None => 0,
                Some([other, _]) if other == color => 1,
                Some(_) => 2,
            };
            let equal = usize::from(color == near.w) + 2 * usize::from(color == near.n);
            let confidence = confidence.number() as usize;
            let model = (((order * 4 + misses.min(3)) * 4 + equal) * 64 + confidence) * 3 + shorter;
            if decisions.bit(&mut self.follows[model], color == given) {
                return Ok(color);
            }
            tried.add(color);
            misses += 1;
        }
        let pattern = near.pattern() + 64 * misses.min(3);
        for (k, color) in [near.w, near.n, near.nw, near.ne].into_iter().enumerate() {
            if tried.contains(color) {
                continue;
            }
            if decisions.bit(&mut self.equals[256 * k + pattern], color == given) {
                return Ok(color);
            }
            tried.add(color);
        }
        Err(tried)
    }

    /// Enters the colour of the pixel with these contexts.
    #[inline(always)]
    pub(super) fn learn(&mut self, contexts: &Contexts<P>, color: P) {
        for order in 0..ORDERS {
            let place = contexts.places[order];
            let entry = &mut self.entries[order][place];
            let Some([old, confidence]) = contexts.entries[order] else {
                self.checks[order][place] = contexts.checks[order];
                *entry = [color, P::ZERO];
                continue;
            };
            let confidence = confidence.number();
            *entry = if old == color {
                [old, P::of_number((confidence + 1).min(MAX_CONFIDENCE))]
            } else if confidence < 4 {
                [color, P::ZERO]
            } else {
                [old, P::of_number(confidence / 2)]
            };
        }
    }
}

/// The predicted colours of a pixel, in the order in which they are tried, with their prices.
#[cfg(feature = "encode")]
pub(super) struct Candidates {
    tried: Excluded<u64>,
    prices: Prices,
}

/// Records the prices of decisions, and answers all of them with no.
#[cfg(feature = "encode")]
#[derive(Default)]
struct Prices {
    /// Bits of a yes and of a no.
    bits: [[f32; 2]; 10],
    count: usize,
}

#[cfg(feature = "encode")]
impl Decisions for Prices {
    #[inline(always)]
    fn bit(&mut self, model: &mut Adaptive, _bit: bool) -> bool {
        self.bits[self.count] = [true, false].map(|bit| price(model, bit));
        self.count += 1;
        false
    }

    fn even(&mut self, _bit: bool) -> bool {
        false
    }
}

#[cfg(feature = "encode")]
impl Candidates {
    pub(super) fn of(colors: &mut Colors<u64>, around: &Around<'_, u64>) -> Candidates {
        let mut prices = Prices::default();
        match colors.code(&mut prices, around, 0) {
            Err(tried) => Candidates { tried, prices },
            Ok(_) => unreachable!("all decisions are answered with no"),
        }
    }

    /// Calls `visit` with each colour and its bits. Returns the bits of none of them.
    #[inline(always)]
    pub(super) fn visit(&self, mut visit: impl FnMut(u64, f32)) -> f32 {
        let colors = &self.tried.colors[self.tried.count - self.prices.count..];
        let mut before = 0.0;
        for (&color, [yes, no]) in colors.iter().zip(&self.prices.bits[..self.prices.count]) {
            visit(color, before + yes);
            before += no;
        }
        before
    }
}
