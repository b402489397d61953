//! The models of a tile and their initial states (spec §11.3).

use std::sync::OnceLock;

use super::decisions::Adaptive;
use super::scan::{SIZES, ZONES};
use super::start;

/// Planes that can be coded: luma or grey, orange, green, alpha.
pub(crate) const PLANES: usize = 4;
/// Kinds of planes that share a tree and most models: luma or grey, chroma, alpha.
pub(crate) const KINDS: usize = 3;
/// Classes of the predicted number of levels of a block.
pub(crate) const BUCKETS: usize = 8;
/// Classes of the number of levels that remain in a block.
pub(super) const LEFT: usize = 6;
/// Classes of the magnitude of neighbouring levels.
pub(super) const NEAR: usize = 4;
/// Number of unary decisions about a level's magnitude.
pub(super) const UNARY: usize = 16;
/// Number of unary decisions about the exponent of a count.
pub(super) const EXPONENTS: usize = 12;
/// Maximum number of step classes.
pub(crate) const CLASSES: usize = 8;

/// The models of one kind of planes.
#[derive(Debug, Clone, Copy)]
pub(crate) struct KindModels {
    /// Exponent of a block's count, by bucket.
    pub exponent: [[Adaptive; EXPONENTS]; BUCKETS],
    /// The two bits below the highest of a count, by exponent.
    pub mantissa: [[Adaptive; 3]; EXPONENTS],
    /// Whether a position has a level, by size, zone, levels left and neighbouring levels.
    pub place: [[[[Adaptive; NEAR]; LEFT]; ZONES]; SIZES],
    /// Whether a magnitude is above 1, by zone, neighbouring levels, and whether there are many levels.
    pub more: [[[Adaptive; 2]; NEAR]; 5],
    /// Whether a magnitude is larger still.
    pub larger: [Adaptive; UNARY],
    /// Whether a block is divided, by size and number of smaller neighbours.
    pub divide: [[Adaptive; 3]; SIZES],
}

/// All models of a tile.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Models {
    /// Whether a block has levels, by plane, size, bucket, and the levels of other planes at the same place.
    pub filled: [[[[Adaptive; 4]; BUCKETS]; SIZES]; PLANES],
    pub kinds: [KindModels; KINDS],
    /// Whether the step class is higher, by the neighbouring classes.
    pub class: [[Adaptive; CLASSES]; 2 * CLASSES],
}

impl Models {
    /// Returns the models in their initial state.
    pub(crate) fn start() -> Self {
        static START: OnceLock<Models> = OnceLock::new();
        *START.get_or_init(Models::of_the_table)
    }

    /// A loop at first use is a quarter of the size of a table that the compiler computes.
    fn of_the_table() -> Self {
        let mut models = Models::BLANK;
        let mut starts = start::ONE.iter().zip(&start::SEEN).map(|(&one, &seen)| Adaptive::new(one, seen));
        models.each(&mut |models| models.iter_mut().zip(&mut starts).for_each(|(model, start)| *model = start));
        debug_assert!(starts.next().is_none(), "the table has as many starts");
        // Alpha is rare and has the initial states of luma.
        models.filled[3] = models.filled[0];
        models.kinds[2] = models.kinds[0];
        models
    }

    const BLANK: Models = {
        // All zeros, so that the constant takes no space in the program.
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

    /// Visits the models whose initial states are in the table, in groups, in the order of the table.
    pub(crate) fn each(&mut self, visit: &mut dyn FnMut(&mut [Adaptive])) {
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
