//! The models of a tile, and how they begin (spec §11.3).

use std::sync::OnceLock;

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

impl Models {
    /// The models as a tile begins with them.
    pub fn start() -> Self {
        static START: OnceLock<Models> = OnceLock::new();
        *START.get_or_init(Models::of_the_table)
    }

    /// A loop at the first use, not what the compiler makes of the table: that is four times as large.
    fn of_the_table() -> Self {
        let mut models = Models::BLANK;
        let mut starts = start::ONE.iter().zip(&start::SEEN).map(|(&one, &seen)| Adaptive::new(one, seen));
        models.each(&mut |models| models.iter_mut().zip(&mut starts).for_each(|(model, start)| *model = start));
        debug_assert!(starts.next().is_none(), "the table has as many starts");
        // Alpha is rare, and begins as luma does.
        models.filled[3] = models.filled[0];
        models.kinds[2] = models.kinds[0];
        models
    }

    const BLANK: Models = {
        // All zeros: no bytes of the program.
        let m = Adaptive::NONE;
        let kind = KindModels {
            exponent: [[m; EXPONENTS]; BUCKETS],
            mantissa: [[m; 3]; EXPONENTS],
            place: [[[[m; NEAR]; LEFT]; ZONES]; SIZES],
            more: [[[m; 2]; NEAR]; 5],
            larger: [m; UNARY],
            divide: [[m; 3]; SIZES],
        };
        Models {
            filled: [[[[m; 4]; BUCKETS]; SIZES]; PLANES],
            kinds: [kind; KINDS],
            class: [[m; CLASSES]; 2 * CLASSES],
        }
    };

    /// Visits the models whose starts are in the table, some at a time, in its order.
    pub fn each(&mut self, visit: &mut dyn FnMut(&mut [Adaptive])) {
        visit(self.filled[..3].as_flattened_mut().as_flattened_mut().as_flattened_mut());
        for kind in &mut self.kinds[..2] {
            visit(kind.exponent.as_flattened_mut());
            visit(kind.mantissa.as_flattened_mut());
            visit(kind.place.as_flattened_mut().as_flattened_mut().as_flattened_mut());
            visit(kind.more.as_flattened_mut().as_flattened_mut());
            visit(&mut kind.larger);
            visit(kind.divide.as_flattened_mut());
        }
        visit(self.class.as_flattened_mut());
    }
}
