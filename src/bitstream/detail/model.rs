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

/// The models as a tile begins with them: made by the compiler, since code that makes them is larger than they are.
static START: Models = begun();

/// Puts the starts of the table into an array, from the `i`-th on.
macro_rules! put {
    ($i:ident, $array:expr) => {
        $array = Adaptive::new(start::ONE[$i], start::SEEN[$i]);
        $i += 1;
    };
}

/// Runs a block for all values of an index.
macro_rules! each {
    ($k:ident < $end:expr, $body:block) => {
        let mut $k = 0;
        while $k < $end {
            $body
            $k += 1;
        }
    };
}

const fn begun() -> Models {
    let m = Adaptive::new(128, 0);
    let blank = KindModels {
        exponent: [[m; EXPONENTS]; BUCKETS],
        mantissa: [[m; 3]; EXPONENTS],
        place: [[[[m; NEAR]; LEFT]; ZONES]; SIZES],
        more: [[[m; 2]; NEAR]; 5],
        larger: [m; UNARY],
        divide: [[m; 3]; SIZES],
    };
    let mut filled = [[[[m; 4]; BUCKETS]; SIZES]; PLANES];
    let mut kinds = [blank; KINDS];
    let mut class = [[m; CLASSES]; 2 * CLASSES];
    let mut i = 0;
    each!(a < 3, {
        each!(b < SIZES, {
            each!(c < BUCKETS, {
                each!(d < 4, {
                    put!(i, filled[a][b][c][d]);
                });
            });
        });
    });
    each!(k < 2, {
        each!(a < BUCKETS, {
            each!(b < EXPONENTS, {
                put!(i, kinds[k].exponent[a][b]);
            });
        });
        each!(a < EXPONENTS, {
            each!(b < 3, {
                put!(i, kinds[k].mantissa[a][b]);
            });
        });
        each!(a < SIZES, {
            each!(b < ZONES, {
                each!(c < LEFT, {
                    each!(d < NEAR, {
                        put!(i, kinds[k].place[a][b][c][d]);
                    });
                });
            });
        });
        each!(a < 5, {
            each!(b < NEAR, {
                each!(c < 2, {
                    put!(i, kinds[k].more[a][b][c]);
                });
            });
        });
        each!(a < UNARY, {
            put!(i, kinds[k].larger[a]);
        });
        each!(a < SIZES, {
            each!(b < 3, {
                put!(i, kinds[k].divide[a][b]);
            });
        });
    });
    each!(a < 2 * CLASSES, {
        each!(b < CLASSES, {
            put!(i, class[a][b]);
        });
    });
    assert!(i == start::ONE.len(), "the table has as many starts");
    // Alpha is rare, and begins as luma does.
    filled[3] = filled[0];
    kinds[2] = kinds[0];
    Models { filled, kinds, class }
}

impl Models {
    /// The models as a tile begins with them.
    pub fn start() -> Self {
        START
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
    #[cfg(test)]
    fn each(&mut self, mut visit: impl FnMut(&mut Adaptive)) {
        self.exponent.iter_mut().flatten().for_each(&mut visit);
        self.mantissa.iter_mut().flatten().for_each(&mut visit);
        self.place.iter_mut().flatten().flatten().flatten().for_each(&mut visit);
        self.more.iter_mut().flatten().flatten().for_each(&mut visit);
        self.larger.iter_mut().for_each(&mut visit);
        self.divide.iter_mut().flatten().for_each(&mut visit);
    }
}
