//! The price of a block, and what a lower level saves, without coding the block again for each of its levels.

use super::block::{Block, Context, FOLLOWERS, MANY, MAX_CONTEXT_SIZE, UNARY_SIZES, class_of, code, count};
use super::decisions::{Price, price};
use super::model::{KindModels, NEAR, UNARY};
use super::scan::{LARGEST, Place, order, scan};

/// Number of positions of the largest block.
const PLACES: usize = LARGEST * LARGEST;

/// The price of a block with its current levels. Positions are those in coding order.
#[derive(Debug)]
pub(crate) struct BlockPrice {
    context: Context,
    /// Number of levels.
    count: u32,
    bits: f32,
    /// Bits of the decisions whether there is a level, over all positions before each one.
    placed: Box<[f32; PLACES + 1]>,
    /// By how much that sum would grow if one level fewer remained at these positions.
    fewer: Box<[f32; PLACES + 1]>,
    /// Weighted sum of the preceding levels at each position.
    near: Box<[u8; PLACES]>,
    /// Class of the number of levels that remain at each position, and of one level fewer.
    classes: Box<[[u8; 2]; PLACES]>,
    /// Position of the last level.
    last: usize,
    /// First position from which on all positions have levels, so that no decision is coded.
    full_from: usize,
    /// Bits of each magnitude from 2 on that is coded in unary.
    larger: [f32; UNARY],
}

/// Sums over the positions before one.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    placed: f32,
    fewer: f32,
}

impl Default for BlockPrice {
    fn default() -> Self {
        BlockPrice {
            context: Context { size: 0, bucket: 0 },
            count: 0,
            bits: 0.0,
            placed: Box::new([0.0; PLACES + 1]),
            fewer: Box::new([0.0; PLACES + 1]),
            near: Box::new([0; PLACES]),
            classes: Box::new([[0; 2]; PLACES]),
            last: 0,
            full_from: 0,
            larger: [0.0; UNARY],
        }
    }
}

impl BlockPrice {
    /// Prices another block. It has `count` levels, at least one.
    pub(crate) fn start(&mut self, models: &mut KindModels, block: &mut Block, context: Context, count: u32) {
        self.context = context;
        let mut before = 0.0;
        for size in 2..UNARY_SIZES as usize {
            self.larger[size] = before + price(&models.larger[size], false);
            before += price(&models.larger[size], true);
        }
        self.larger[UNARY_SIZES as usize] = before;
        self.update(models, block, count);
    }

    /// Returns the bits of the block after the decision that it has levels.
    pub(crate) fn bits(&self) -> f32 {
        self.bits
    }

    /// Prices the block after some of its levels have changed. It has `count` levels, at least one.
    pub(crate) fn update(&mut self, models: &mut KindModels, block: &mut Block, count: u32) {
        let size = self.context.size;
        let places = 16usize << (2 * size);
        (self.count, self.full_from) = (count, places);
        let mut left = count;
        let mut sums = Sums::default();
        let mut classes = classes_of(left);
        let mut values = 0.0;
        block.found.clear();
        for (k, place) in scan(size).iter().enumerate() {
            let (at, zone) = (usize::from(place.at), usize::from(place.zone));
            let (level, near) = (block.levels[at], block.near[at]);
            self.near[k] = near;
            if places - k == left as usize {
                self.full_from = self.full_from.min(k);
            }
            self.add(models, (k, place), classes, level, &mut sums);
            if level == 0 {
                continue;
            }
            let magnitude = level.unsigned_abs().into();
            values += self.value(models, zone, near, magnitude);
            block.found.push(place.at);
            block.add_context(at, magnitude);
            left -= 1;
            if left == 0 {
                self.end(k, sums);
                break;
            }
            classes = classes_of(left);
        }
        block.reset_context();
        self.bits = self.bits_of_count(models, count) + sums.placed + values;
    }

    /// Lowers the level at position `k` by one, which saves `saved` bits as returned by [`saved`](Self::saved). After
    /// that, only the levels at earlier positions may be lowered until the next [`update`](Self::update).
    pub(crate) fn lower(&mut self, models: &mut KindModels, block: &mut Block, k: usize, saved: f32) {
        let size = self.context.size;
        let at = usize::from(scan(size)[k].at);
        let magnitude = u32::from(block.levels[at].unsigned_abs());
        block.levels[at] -= block.levels[at].signum();
        if magnitude == 1 && (self.count == MANY || k >= self.full_from) {
            self.update(models, block, self.count - 1);
            return;
        }
        self.bits -= saved;
        if magnitude <= MAX_CONTEXT_SIZE {
            for (step, weight) in FOLLOWERS {
                let after = usize::from(order(size)[at + step]);
                if after > k {
                    self.near[after] = self.near[after].wrapping_sub(weight);
                }
            }
        }
        if magnitude > 1 {
            return;
        }
        self.count -= 1;
        let mut left = self.count;
        let mut sums = Sums::default();
        let mut classes = classes_of(left);
        for (i, place) in scan(size)[..=k].iter().enumerate() {
            let level = block.levels[usize::from(place.at)];
            self.add(models, (i, place), classes, level, &mut sums);
            if level == 0 {
                continue;
            }
            left -= 1;
            if left == 0 {
                self.end(i, sums);
                return;
            }
            classes = classes_of(left);
        }
        (self.placed[k + 1], self.fewer[k + 1]) = (sums.placed, sums.fewer);
    }

    /// Records the sums before position `k`, and adds the decision whether it has a level.
    #[inline(always)]
    fn add(
        &mut self,
        models: &KindModels,
        (k, place): (usize, &Place),
        classes: [usize; 2],
        level: i16,
        sums: &mut Sums,
    ) {
        (self.placed[k], self.fewer[k]) = (sums.placed, sums.fewer);
        self.classes[k] = classes.map(|class| class as u8);
        if k < self.full_from {
            let models = &models.place[self.context.size][usize::from(place.zone)];
            let [own, other] = classes.map(|class| price(&models[class][class_of_near(self.near[k])], level != 0));
            sums.placed += own;
            sums.fewer += other - own;
        }
    }

    /// Records that the last level is at position `k`.
    fn end(&mut self, k: usize, sums: Sums) {
        self.last = k;
        (self.placed[k + 1], self.fewer[k + 1]) = (sums.placed, sums.fewer);
    }

    /// Returns the bits that the block saves if the level at position `k` is lower by one. The block must have another
    /// level.
    pub(crate) fn saved(&self, models: &mut KindModels, block: &mut Block, k: usize) -> f32 {
        let size = self.context.size;
        let place = scan(size)[k];
        let (at, zone, near) = (usize::from(place.at), usize::from(place.zone), self.near[k]);
        let magnitude: u32 = block.levels[at].unsigned_abs().into();
        if magnitude > 1 {
            let own = self.value(models, zone, near, magnitude) - self.value(models, zone, near, magnitude - 1);
            return if magnitude > MAX_CONTEXT_SIZE { own } else { own + self.saved_after(models, block, k) };
        }
        // The contexts of all values change, or decisions become necessary.
        if self.count == MANY || k >= self.full_from {
            return self.saved_by_coding(models, block, at);
        }
        let [count, fewer] = [self.count, self.count - 1].map(|count| self.bits_of_count(models, count));
        let saved = count - fewer + self.value(models, zone, near, 1);
        if k == self.last {
            // The positions after the level before it are no longer coded.
            let has_level = |place: &Place| block.levels[usize::from(place.at)] != 0;
            let end = scan(size)[..k].iter().rposition(has_level).map_or(0, |before| before + 1);
            return saved + self.placed[k + 1] - self.placed[end] - self.fewer[end];
        }
        let [class, class_of_fewer] = self.classes[k].map(usize::from);
        let (place, near) = (&models.place[size][zone], class_of_near(near));
        let own = price(&place[class][near], true) - price(&place[class_of_fewer][near], false);
        saved + own - self.fewer[k] + self.saved_after(models, block, k)
    }

    /// Returns the bits that the positions whose contexts contain position `k` save.
    fn saved_after(&self, models: &KindModels, block: &Block, k: usize) -> f32 {
        let size = self.context.size;
        let at = usize::from(scan(size)[k].at);
        let mut saved = 0.0;
        for (step, weight) in FOLLOWERS {
            let after = usize::from(order(size)[at + step]);
            // Positions outside of the block have the lowest number.
            if after <= k || after > self.last {
                continue;
            }
            let [near, lower] = [self.near[after], self.near[after] - weight].map(class_of_near);
            if near == lower {
                continue;
            }
            let (zone, level) = (usize::from(scan(size)[after].zone), block.levels[at + step]);
            if after < self.full_from {
                let place = &models.place[size][zone][usize::from(self.classes[after][0])];
                saved += price(&place[near], level != 0) - price(&place[lower], level != 0);
            }
            if level != 0 {
                let (more, is_more) = (&models.more[(zone / 3).min(4)], level.unsigned_abs() > 1);
                saved += price(&more[near][self.many()], is_more) - price(&more[lower][self.many()], is_more);
            }
        }
        saved
    }

    /// Returns what a lower level saves, by coding the block with it.
    fn saved_by_coding(&self, models: &mut KindModels, block: &mut Block, at: usize) -> f32 {
        let level = block.levels[at];
        block.levels[at] -= level.signum();
        let count = self.count - u32::from(block.levels[at] == 0);
        let mut price = Price::default();
        code(&mut price, models, block, self.context, count).expect("levels within the format");
        block.levels[at] = level;
        self.bits - price.bits
    }

    /// Returns the index of the models for blocks with few or many levels.
    fn many(&self) -> usize {
        usize::from(self.count >= MANY)
    }

    /// Returns the bits of the value of a level.
    fn value(&self, models: &KindModels, zone: usize, near: u8, magnitude: u32) -> f32 {
        let more = price(&models.more[(zone / 3).min(4)][class_of_near(near)][self.many()], magnitude > 1);
        let larger = match magnitude {
            1 => 0.0,
            2..UNARY_SIZES => self.larger[magnitude as usize],
            _ => self.larger[UNARY_SIZES as usize] + (2 * (magnitude - UNARY_SIZES + 1).ilog2() + 1) as f32,
        };
        // The last one is the sign.
        more + larger + 1.0
    }

    /// Returns the bits of a number of levels.
    fn bits_of_count(&self, models: &mut KindModels, number: u32) -> f32 {
        let mut price = Price::default();
        let places = 16u32 << (2 * self.context.size);
        count(&mut price, models, self.context.bucket, places.ilog2(), number);
        price.bits
    }
}

/// Returns the class of a number of levels that remain, and that of one fewer.
fn classes_of(left: u32) -> [usize; 2] {
    [left, (left - 1).max(1)].map(class_of)
}

/// Returns the class of a weighted sum of preceding levels.
#[inline(always)]
fn class_of_near(near: u8) -> usize {
    usize::from(near).div_ceil(2).min(NEAR - 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bitstream::detail::model::Models;
    use crate::bitstream::detail::scan::SIZES;
    use rand::{RngExt, SeedableRng};

    fn coded(models: &mut KindModels, block: &mut Block, context: Context, count: u32) -> f32 {
        let mut price = Price::default();
        code(&mut price, models, block, context, count).unwrap();
        price.bits
    }

    #[test]
    fn prices_and_savings_are_those_of_coding_the_block() {
        let models = &mut Models::start().kinds[0];
        let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(1);
        let mut priced = BlockPrice::default();
        let mut is_each_case_tried = [false; 4];
        for size in 0..SIZES {
            let places = scan(size);
            // From single levels to blocks that are full.
            for filled in [0.02, 0.1, 0.3, 0.7, 1.0] {
                for largest in [1, 2, 6, 40] {
                    let (mut block, context) = (Block::default(), Context::new(size, rng.random_range(0..8)));
                    for place in places {
                        if rng.random_bool(filled) {
                            block.levels[usize::from(place.at)] = rng.random_range(-largest..=largest);
                        }
                    }
                    let count = places.iter().filter(|p| block.levels[usize::from(p.at)] != 0).count() as u32;
                    if count < 2 {
                        continue;
                    }
                    priced.start(models, &mut block, context, count);
                    let before = coded(models, &mut block, context, count);
                    // The rounding errors of sums of up to 1024 prices in different orders.
                    let tolerance = 1024.0 * f32::EPSILON / 2.0 * before + 1e-3;
                    assert!((priced.bits() - before).abs() < tolerance, "{} {before}", priced.bits());
                    for (k, place) in places.iter().enumerate() {
                        let (at, level) = (usize::from(place.at), block.levels[usize::from(place.at)]);
                        if level == 0 {
                            continue;
                        }
                        let saved = priced.saved(models, &mut block, k);
                        block.levels[at] -= level.signum();
                        let fewer = count - u32::from(block.levels[at] == 0);
                        let after = coded(models, &mut block, context, fewer);
                        block.levels[at] = level;
                        let what = format!("{size} {filled} {largest}, {count} levels, {level} at {k}");
                        assert!((before - after - saved).abs() < tolerance, "{what}: {saved} {}", before - after);
                        let is_removed = level.abs() == 1;
                        is_each_case_tried[0] |= is_removed && k == priced.last;
                        is_each_case_tried[1] |= is_removed && k >= priced.full_from;
                        is_each_case_tried[2] |= is_removed && k < priced.last && count > 40;
                        is_each_case_tried[3] |= level.unsigned_abs() > UNARY_SIZES as u16;
                    }
                }
            }
        }
        assert_eq!(is_each_case_tried, [true; 4]);
    }

    #[test]
    fn a_block_with_lowered_levels_has_the_price_of_coding_it() {
        let models = &mut Models::start().kinds[0];
        let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(2);
        let mut priced = BlockPrice::default();
        for size in 0..SIZES {
            let places = scan(size);
            for filled in [0.1, 0.5, 1.0] {
                for largest in [1, 3, 30] {
                    let (mut block, context) = (Block::default(), Context::new(size, 3));
                    for place in places {
                        if rng.random_bool(filled) {
                            block.levels[usize::from(place.at)] = rng.random_range(-largest..=largest);
                        }
                    }
                    let count = |block: &Block| places.iter().filter(|p| block.levels[usize::from(p.at)] != 0).count();
                    if count(&block) < 2 {
                        continue;
                    }
                    let number = count(&block) as u32;
                    priced.start(models, &mut block, context, number);
                    for (k, place) in places.iter().enumerate().rev() {
                        let level = block.levels[usize::from(place.at)];
                        if level == 0 || level.abs() == 1 && count(&block) == 1 || rng.random_bool(0.4) {
                            continue;
                        }
                        let saved = priced.saved(models, &mut block, k);
                        priced.lower(models, &mut block, k, saved);
                        let number = count(&block) as u32;
                        let after = coded(models, &mut block, context, number);
                        // Rounding errors of up to 1024 sums.
                        let tolerance = 1e-4 * after + 1e-2;
                        let what = format!("{size} {filled} {largest}: {level} at {k} of {number}");
                        assert!((priced.bits() - after).abs() < tolerance, "{what}: {} {after}", priced.bits());
                    }
                }
            }
        }
    }
}
