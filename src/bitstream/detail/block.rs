//! Codes the levels of one block: whether there are any, how many, their positions and values (spec §11.4).

use super::decisions::Decisions;
#[cfg(feature = "encode")]
use super::decisions::price;
use super::model::{BUCKETS, EXPONENTS, KindModels, LEFT, NEAR, UNARY};
use super::scan::{ROOM, STRIDE, scan};
use crate::bitstream::broken::Broken;

/// Maximum magnitude of a level.
pub(crate) const MAX_LEVEL: u32 = 32_767;
/// Number of magnitudes that are coded in unary.
pub(super) const UNARY_SIZES: u32 = UNARY as u32 - 1;
/// Maximum magnitude that contexts distinguish; larger levels count as this.
pub(super) const MAX_CONTEXT_SIZE: u32 = 5;
/// Minimum number of levels of a block with many.
pub(super) const MANY: u32 = 5;
/// Distances in memory from a level to the positions whose contexts contain it, and its weight in each.
pub(super) const FOLLOWERS: [(usize, u8); 5] = [(1, 2), (STRIDE, 2), (STRIDE + 1, 1), (2, 1), (2 * STRIDE, 1)];

/// The levels of a block by position.
#[derive(Debug)]
pub(crate) struct Block {
    pub levels: [i16; ROOM],
    /// Weighted sum of the preceding levels at each position.
    pub(super) near: [u8; ROOM],
    /// The positions that have levels, in coding order.
    pub found: Vec<u16>,
}

impl Default for Block {
    fn default() -> Self {
        Block { levels: [0; ROOM], near: [0; ROOM], found: Vec::with_capacity(256) }
    }
}

impl Block {
    /// Adds a level of this magnitude to the contexts of the following positions.
    #[inline(always)]
    pub(super) fn add_context(&mut self, at: usize, size: u32) {
        let m = size.min(MAX_CONTEXT_SIZE) as u8;
        for (step, weight) in FOLLOWERS {
            let near = &mut self.near[(at + step) % ROOM];
            *near = near.wrapping_add(weight * m);
        }
    }

    /// Resets the contexts that depend on the levels found.
    #[inline(always)]
    pub(super) fn reset_context(&mut self) {
        for &at in &self.found {
            for (step, _) in FOLLOWERS {
                self.near[(usize::from(at) + step) % ROOM] = 0;
            }
        }
    }

    /// Removes the levels found.
    pub(crate) fn clear(&mut self) {
        for &at in &self.found {
            self.levels[usize::from(at) % ROOM] = 0;
        }
        self.found.clear();
    }
}

/// Context of a block, in addition to the models of its kind.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Context {
    pub size: usize,
    /// Class of the predicted number of levels.
    pub bucket: usize,
}

impl Context {
    pub(crate) fn new(size: usize, bucket: usize) -> Self {
        debug_assert!(bucket < BUCKETS);
        Context { size, bucket }
    }
}

/// Codes the levels of `block` after the decision that there are any. When writing, `given` is their number.
#[cfg_attr(target_family = "wasm", inline(never))]
#[cfg_attr(not(target_family = "wasm"), inline(always))]
pub(crate) fn code<D: Decisions>(
    d: &mut D,
    models: &mut KindModels,
    block: &mut Block,
    context: Context,
    given: u32,
) -> Result<u32, Broken> {
    d.apart(|d| levels(d, models, block, context, given))
}

#[inline(always)]
fn levels<D: Decisions>(
    d: &mut D,
    models: &mut KindModels,
    block: &mut Block,
    context: Context,
    given: u32,
) -> Result<u32, Broken> {
    let Context { size, bucket } = context;
    let places = 16u32 << (2 * size);
    let count = count(d, models, bucket, places.ilog2(), given);
    if count > places {
        return Err(Broken { field: "levels of a block", value: count.into() });
    }
    block.found.clear();
    let many = usize::from(count >= MANY);
    let mut left = count;
    let mut class = class_of(left);
    let mut result = Ok(count);
    let zones = &mut models.place[size];
    for (k, place) in scan(size).iter().enumerate() {
        let at = usize::from(place.at) % ROOM;
        let near = usize::from(block.near[at]).div_ceil(2).min(NEAR - 1);
        let zone = usize::from(place.zone);
        let has = places - k as u32 == left || d.bit(&mut zones[zone][class][near], block.levels[at] != 0);
        if !has {
            continue;
        }
        let given = block.levels[at];
        let more = &mut models.more[(zone / 3).min(4)][near][many];
        let mut magnitude = 1;
        if d.bit(more, given.unsigned_abs() > 1) {
            magnitude = larger(d, &mut models.larger, given.unsigned_abs().into());
            if magnitude > MAX_LEVEL {
                result = Err(Broken { field: "level", value: magnitude.into() });
                break;
            }
        }
        let negative = d.even(given < 0);
        // Without a branch: half of the predictions would be wrong.
        let sign = -i16::from(negative);
        block.levels[at] = (magnitude as i16 ^ sign) - sign;
        block.found.push(place.at);
        block.add_context(at, magnitude);
        left -= 1;
        if left == 0 {
            break;
        }
        class = class_of(left);
    }
    block.reset_context();
    result
}

/// For each of the `count` levels of `block`, writes to its place in `savings` an estimate of the bits that a level
/// smaller by one would save. Models and contexts are those of the current levels.
#[cfg(feature = "encode")]
pub(crate) fn savings(
    models: &KindModels,
    block: &mut Block,
    Context { size, .. }: Context,
    count: u32,
    savings: &mut [f32; ROOM],
) {
    /// Bits saved by one size of an Exp-Golomb code.
    const LARGE: f32 = 0.3;
    let places = 16u32 << (2 * size);
    block.found.clear();
    let many = usize::from(count >= MANY);
    let mut left = count;
    for (k, place) in scan(size).iter().enumerate() {
        if left == 0 {
            break;
        }
        let at = usize::from(place.at) % ROOM;
        let magnitude = u32::from(block.levels[at].unsigned_abs());
        if magnitude == 0 {
            continue;
        }
        let near = usize::from(block.near[at]).div_ceil(2).min(NEAR - 1);
        let zone = usize::from(place.zone);
        let more = &models.more[(zone / 3).min(4)][near][many];
        savings[at] = match magnitude {
            1 => {
                let has = &models.place[size][zone][class_of(left)][near];
                let there = if places - k as u32 == left { 0.0 } else { price(has, true) };
                // The last one is the sign.
                there + price(more, false) + 1.0 - price(has, false)
            }
            2 => price(more, true) + price(&models.larger[2], false) - price(more, false),
            3..UNARY_SIZES => {
                let [fewer, same] = [magnitude - 1, magnitude].map(|size| &models.larger[size as usize]);
                price(fewer, true) + price(same, false) - price(fewer, false)
            }
            _ => LARGE,
        };
        block.found.push(place.at);
        block.add_context(at, magnitude);
        left -= 1;
    }
    block.reset_context();
}

#[inline(always)]
pub(super) fn class_of(left: u32) -> usize {
    ((32 - (left - 1).leading_zeros()) as usize).min(LEFT - 1)
}

/// Codes the number of levels of a block: the position of its highest bit in unary, then the bits below it.
#[inline(always)]
pub(super) fn count<D: Decisions>(d: &mut D, models: &mut KindModels, bucket: usize, most: u32, given: u32) -> u32 {
    let goal = given.max(1).ilog2();
    let mut exponent = 0;
    while exponent < most && d.bit(&mut models.exponent[bucket][exponent as usize % EXPONENTS], exponent < goal) {
        exponent += 1;
    }
    let mut count = 1;
    for i in 0..exponent {
        let bit = given >> (exponent - 1 - i) & 1 == 1;
        let read = match i {
            0 => d.bit(&mut models.mantissa[exponent as usize][0], bit),
            1 => d.bit(&mut models.mantissa[exponent as usize][1 + (count & 1) as usize], bit),
            _ => d.even(bit),
        };
        count = count << 1 | u32::from(read);
    }
    count
}

/// Codes a magnitude above 1: in unary, and from 15 on by an Exp-Golomb code.
#[inline(always)]
fn larger<D: Decisions>(d: &mut D, models: &mut [super::decisions::Adaptive; UNARY], given: u32) -> u32 {
    let mut size = 2;
    while size < UNARY_SIZES && d.bit(&mut models[size as usize], given > size) {
        size += 1;
    }
    if size < UNARY_SIZES {
        return size;
    }
    let over = given.saturating_sub(UNARY_SIZES) + 1;
    let mut exponent = 0;
    while exponent < UNARY_SIZES && d.even(exponent < over.ilog2()) {
        exponent += 1;
    }
    UNARY_SIZES - 1 + (1 << exponent | d.raw(exponent, over & ((1 << exponent) - 1)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bitstream::detail::decisions::Price;
    use crate::bitstream::detail::model::Models;
    use crate::bitstream::detail::scan::at;
    use rand::{RngExt, SeedableRng};

    fn price_of(models: &Models, block: &mut Block, context: Context, count: u32) -> f32 {
        let mut price = Price::default();
        code(&mut price, &mut { *models }.kinds[0], block, context, count).unwrap();
        price.bits
    }

    #[test]
    fn estimated_savings_are_close_to_actual_savings() {
        let models = Models::start();
        let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(1);
        let (mut all, mut missed) = (0.0f32, 0.0f32);
        for size in 0..4 {
            for _ in 0..20 {
                let (mut block, context) = (Block::default(), Context::new(size, 3));
                let places: Vec<usize> = (0..8).map(|_| at(rng.random_range(0..4), rng.random_range(0..4))).collect();
                places.iter().for_each(|&place| block.levels[place] = rng.random_range(1..6));
                let count = block.levels.iter().filter(|&&level| level != 0).count() as u32;
                let mut saved = [0.0; ROOM];
                savings(&models.kinds[0], &mut block, context, count, &mut saved);
                let before = price_of(&models, &mut block, context, count);
                for &place in &places {
                    let level = block.levels[place];
                    block.levels[place] -= 1;
                    let after = price_of(&models, &mut block, context, count - u32::from(level == 1));
                    block.levels[place] = level;
                    all += (before - after).abs();
                    missed += (before - after - saved[place]).abs();
                }
            }
        }
        assert!(missed < 0.6 * all, "{missed} of {all} bits are missed");
    }
}
