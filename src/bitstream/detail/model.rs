//! The models of a tile, and how they begin (spec §11.3).

use super::decisions::Adaptive;
use super::scan::{SIZES, ZONES};
use super::start;

/// Planes that can be coded: luma or grey, orange, green, alpha.
pub(crate) const PLANES: usize = 4;
/// Kinds of planes that share a tree and most models: luma or grey, chroma, alpha.
pub(crate) const KINDS: usize = 3;
/// Buckets of how many levels a block is expected to have.
pub(crate) const BUCKETS: usize = 8;
/// Classes of how many levels are still to come.
pub(super) const LEFT: usize = 6;
/// Classes of how large the levels nearby are.
pub(super) const NEAR: usize = 4;
/// Decisions in unary about a level's size.
pub(super) const UNARY: usize = 16;
/// Decisions in unary about the exponent of a count.
pub(super) const EXPONENTS: usize = 12;
/// Most step classes.
pub(crate) const CLASSES: usize = 8;

/// The models of one kind of planes.
#[derive(Debug, Clone, Copy)]
pub(crate) struct KindModels {
    /// Exponent of a block's count, by bucket.
    pub exponent: [[Adaptive; EXPONENTS]; BUCKETS],
    /// The two bits below the highest of a count, by exponent.
    pub mantissa: [[Adaptive; 3]; EXPONENTS],
    /// Whether a place has a level, by size, zone, what is left and what is near.
    pub place: [[[[Adaptive; NEAR]; LEFT]; ZONES]; SIZES],
    /// Whether a level is above 1, by zone, what is near, and whether there are many.
    pub more: [[[Adaptive; 2]; NEAR]; 5],
    /// Whether it is still larger.
    pub larger: [Adaptive; UNARY],
    /// Whether a block is divided, by size and smaller neighbours.
    pub divide: [[Adaptive; 3]; SIZES],
}

/// All models of a tile.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Models {
    /// Whether a block has levels, by plane, size, bucket and what other planes have there.
    pub filled: [[[[Adaptive; 4]; BUCKETS]; SIZES]; PLANES],
    pub kinds: [KindModels; KINDS],
    /// Whether a step class is higher, by its neighbours.
    pub class: [[Adaptive; CLASSES]; 2 * CLASSES],
}

/// Hands out starts in the order of the table.
struct Starts(usize);

impl Starts {
    fn next(&mut self) -> Adaptive {
        let i = self.0;
        self.0 += 1;
        Adaptive::new(start::ONE[i], start::SEEN[i])
    }
}

impl Models {
    /// The models as a tile begins with them.
    pub fn start() -> Self {
        static START: std::sync::OnceLock<Models> = std::sync::OnceLock::new();
        *START.get_or_init(|| {
            let mut s = Starts(0);
            let mut filled = [[[[Adaptive::new(0, 0); 4]; BUCKETS]; SIZES]; PLANES];
            filled.iter_mut().take(3).flatten().flatten().flatten().for_each(|m| *m = s.next());
            let mut kind = || {
                let mut k = KindModels::blank();
                k.each(|m| *m = s.next());
                k
            };
            let [luma, chroma] = [kind(), kind()];
            let mut class = [[Adaptive::new(128, 0); CLASSES]; 2 * CLASSES];
            class.iter_mut().flatten().for_each(|m| *m = s.next());
            // Alpha is rare, and begins as luma does.
            filled[3] = filled[0];
            Models { filled, kinds: [luma, chroma, luma], class }
        })
    }

    /// Visits the models whose starts are in the table, in its order.
    #[cfg(test)]
    pub fn each(&mut self, mut visit: impl FnMut(&mut Adaptive)) {
        self.filled.iter_mut().take(3).flatten().flatten().flatten().for_each(&mut visit);
        self.kinds[0].each(&mut visit);
        self.kinds[1].each(&mut visit);
        self.class.iter_mut().flatten().for_each(&mut visit);
    }
}

impl KindModels {
    fn blank() -> Self {
        let m = Adaptive::new(128, 0);
        KindModels {
            exponent: [[m; EXPONENTS]; BUCKETS],
            mantissa: [[m; 3]; EXPONENTS],
            place: [[[[m; NEAR]; LEFT]; ZONES]; SIZES],
            more: [[[m; 2]; NEAR]; 5],
            larger: [m; UNARY],
            divide: [[m; 3]; SIZES],
        }
    }

    fn each(&mut self, mut visit: impl FnMut(&mut Adaptive)) {
        self.exponent.iter_mut().flatten().for_each(&mut visit);
        self.mantissa.iter_mut().flatten().for_each(&mut visit);
        self.place.iter_mut().flatten().flatten().flatten().for_each(&mut visit);
        self.more.iter_mut().flatten().flatten().for_each(&mut visit);
        self.larger.iter_mut().for_each(&mut visit);
        self.divide.iter_mut().flatten().for_each(&mut visit);
    }
}
