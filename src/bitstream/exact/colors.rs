//! Predicts whole colours: from the colours that followed the same neighbours before, then from the nearest neighbours
//! (spec §12.5).

use super::tile::Neighbours;
#[cfg(feature = "encode")]
use crate::bitstream::detail::decisions::price;
use crate::bitstream::detail::decisions::{Adaptive, Decisions};

/// Neighbours of the contexts, nearest first: columns to the left, and rows up.
const NEIGHBOURS: [[i32; 2]; 30] = [
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
/// Numbers of neighbours of the contexts, longest first.
const LENGTHS: [usize; ORDERS] = [30, 18, 10, 6, 3];
const ORDERS: usize = 5;
/// Largest confidence of an entry.
const MAX_CONFIDENCE: u8 = 63;
/// Columns and rows around a pixel that contexts refer to.
pub(super) const REACH: usize = 5;
pub(super) const ROWS_ABOVE: usize = 4;

/// Bytes of the entries that share an address.
pub(super) const ENTRY_BYTES: u64 = (ORDERS * size_of::<Entry>()) as u64;

/// The colour that last followed a context.
#[derive(Debug, Clone, Copy, Default)]
struct Entry {
    /// Position in the tile of a pixel of this colour.
    at: u32,
    /// Check value of the context; 0 if the entry is empty.
    check: u16,
    confidence: u8,
}

/// Models of predicted colours.
pub(super) struct Colors {
    /// Entries by context length and hash.
    entries: [Vec<Entry>; ORDERS],
    /// Number of bits of the hash that entries are addressed by.
    address: u32,
    offsets: [isize; 30],
    factors: [u32; 30],
    /// Whether the colour is that of an entry: by length, misses so far, neighbours of the same colour, confidence,
    /// and the entry of the next shorter context.
    follows: Vec<Adaptive>,
    /// Whether the colour is that of a neighbour: by neighbour, and which neighbours are equal.
    equals: Vec<Adaptive>,
}

/// The places of a pixel's contexts.
pub(super) struct Contexts {
    places: [usize; ORDERS],
    checks: [u16; ORDERS],
}

/// What the colour of a pixel is predicted from.
pub(super) struct Around<'a> {
    /// The pixels of the tile.
    pub pixels: &'a [u64],
    pub contexts: &'a Contexts,
    pub near: &'a Neighbours,
    /// A colour that the pixel does not have.
    pub excluded: Option<u64>,
}

/// The colours that a pixel does not have.
#[derive(Debug)]
pub(super) struct Excluded {
    colors: [u64; 10],
    count: usize,
}

impl Excluded {
    #[inline(always)]
    pub(super) fn contains(&self, color: u64) -> bool {
        self.colors[..self.count].contains(&color)
    }

    #[inline(always)]
    fn add(&mut self, color: u64) {
        self.colors[self.count] = color;
        self.count += 1;
    }
}

impl Colors {
    /// Returns new models for tiles whose rows are `stride` pixels apart, with `2^address` entries a length.
    pub(super) fn new(stride: usize, address: u32) -> Self {
        let mut factor = 0x2545_f491u32;
        let factors = std::array::from_fn(|_| {
            factor = factor.wrapping_mul(0x9e37_79b1) | 1;
            factor
        });
        let start = |i: usize| Adaptive::new((255 - 150 / (i / 3 % 64 + 2)) as u8, 1);
        Colors {
            entries: std::array::from_fn(|_| vec![Entry::default(); 1 << address]),
            address,
            offsets: NEIGHBOURS.map(|[x, y]| x as isize + y as isize * stride as isize),
            factors,
            follows: (0..ORDERS * 4 * 4 * 64 * 3).map(start).collect(),
            equals: vec![Adaptive::new(128, 0); 4 * 256],
        }
    }

    /// Returns the contexts of the pixel at `at`.
    #[inline(always)]
    pub(super) fn contexts(&self, keys: &[u32], at: usize) -> Contexts {
        let mut contexts = Contexts { places: [0; ORDERS], checks: [0; ORDERS] };
        let (mut sum, mut from) = (0u32, 0);
        for order in (0..ORDERS).rev() {
            for k in from..LENGTHS[order] {
                let key = keys[at.wrapping_add_signed(self.offsets[k])];
                sum = sum.wrapping_add(key.wrapping_mul(self.factors[k]));
            }
            from = LENGTHS[order];
            let mixed = (sum ^ sum >> 15).wrapping_mul(0x2c1b_3c6d);
            let hash = mixed ^ mixed >> 13;
            contexts.places[order] = (hash >> (32 - self.address)) as usize;
            contexts.checks[order] = hash as u16 | 1;
        }
        contexts
    }

    /// Codes whether the colour of a pixel is a predicted one, other than the excluded one. Returns that colour, or the
    /// colours that it does not have.
    #[inline(always)]
    pub(super) fn code<D: Decisions>(
        &mut self,
        decisions: &mut D,
        around: &Around<'_>,
        given: u64,
    ) -> Result<u64, Excluded> {
        let Around { pixels, contexts, near, excluded } = *around;
        let found: [Option<u64>; ORDERS] = std::array::from_fn(|order| {
            let entry = self.entries[order][contexts.places[order]];
            (entry.check == contexts.checks[order]).then(|| pixels[entry.at as usize])
        });
        let mut tried = Excluded { colors: [0; 10], count: 0 };
        excluded.into_iter().for_each(|color| tried.add(color));
        let mut misses = 0;
        for order in 0..ORDERS {
            let Some(color) = found[order] else { continue };
            if tried.contains(color) {
                continue;
            }
            let shorter = match found.get(order + 1).copied().flatten() {
                None => 0,
                Some(other) if other == color => 1,
                Some(_) => 2,
            };
            let equal = usize::from(color == near.w) + 2 * usize::from(color == near.n);
            let confidence = usize::from(self.entries[order][contexts.places[order]].confidence);
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

    /// Enters the colour of the pixel at `at`, which `pixels` already contains.
    #[inline(always)]
    pub(super) fn learn(&mut self, pixels: &[u64], contexts: &Contexts, at: usize) {
        for order in 0..ORDERS {
            let (check, new) = (contexts.checks[order], at as u32);
            let entry = &mut self.entries[order][contexts.places[order]];
            if entry.check != check {
                *entry = Entry { at: new, check, confidence: 0 };
            } else if pixels[entry.at as usize] == pixels[at] {
                entry.confidence = (entry.confidence + 1).min(MAX_CONFIDENCE);
            } else if entry.confidence < 4 {
                *entry = Entry { at: new, check, confidence: 0 };
            } else {
                entry.confidence /= 2;
            }
        }
    }
}

/// The predicted colours of a pixel, in the order in which they are tried, with their prices.
#[cfg(feature = "encode")]
pub(super) struct Candidates {
    tried: Excluded,
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
    pub(super) fn of(colors: &mut Colors, around: &Around<'_>) -> Candidates {
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
