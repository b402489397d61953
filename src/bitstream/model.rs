//! Adaptive probabilities: counted slots, mixed in the logistic domain, all in integers (spec §8.2).

use std::sync::LazyLock;

use super::range::Coder;

/// Steps of the logistic domain for one natural unit.
const UNIT: f64 = 256.0;

/// Largest magnitude in the logistic domain.
const LAST: i32 = 2047;

/// Nodes of [`Field::signed`]'s binarization.
pub(crate) const SIGNED_NODES: usize = 72;

/// The three tables of spec §8.2.
pub(crate) struct Tables {
    /// `256·ln(p/(1−p))` at the middle of each 4096th.
    stretch: [i16; 4096],
    /// `2¹⁶/(1 + exp(−x/256))` for `x` in `−2047..=2047`.
    squash: [u16; 4095],
    /// `2¹⁶/(n + 2)`: how far a slot seen `n` times moves.
    step: [u32; 1024],
    /// `256·√(n/(n + 2))`: how much a slot seen `n` times is trusted.
    trust: [i32; 1024],
}

/// The formulas behind [`Tables`], before rounding.
pub(crate) mod formulas {
    use super::{LAST, UNIT};

    pub fn stretch(i: usize) -> f64 {
        let p = (i as f64 + 0.5) / 4096.0;
        UNIT * (p / (1.0 - p)).ln()
    }

    pub fn squash(i: usize) -> f64 {
        65536.0 / (1.0 + (-(i as f64 - f64::from(LAST)) / UNIT).exp())
    }

    pub fn step(n: usize) -> f64 {
        65536.0 / (n as f64 + 2.0)
    }

    pub fn trust(n: usize) -> f64 {
        UNIT * (n as f64 / (n as f64 + 2.0)).sqrt()
    }
}

fn round(v: f64) -> f64 {
    (v + 0.5).floor()
}

pub(crate) static TABLES: LazyLock<Tables> = LazyLock::new(|| Tables {
    stretch: std::array::from_fn(|i| round(formulas::stretch(i)) as i16),
    squash: std::array::from_fn(|i| round(formulas::squash(i)).clamp(32.0, 65504.0) as u16),
    step: std::array::from_fn(|n| round(formulas::step(n)) as u32),
    trust: std::array::from_fn(|n| round(formulas::trust(n)) as i32),
});

/// A probability of 1 in 22 bits above a count of decisions in 10.
#[derive(Debug, Clone, Copy)]
struct Slot(u32);

impl Slot {
    const NEW: Slot = Slot(1 << 31);

    #[inline]
    fn update(&mut self, bit: u32, limit: u32, tables: &Tables) {
        let (p, n) = (self.0 >> 10, self.0 & 1023);
        let target = if bit != 0 { (1 << 22) - 1 } else { 0 };
        let moved = (i64::from(target - p as i32) * i64::from(tables.step[n as usize])) >> 16;
        let p = (i64::from(p) + moved) as u32;
        self.0 = p << 10 | (n + 1).min(limit);
    }
}

/// The model of one field: `K` contexts, each with a slot for every node of the field's binarization, and a mixer.
#[derive(Debug, Clone)]
pub(crate) struct Field<const K: usize> {
    slots: Vec<Slot>,
    nodes: usize,
    starts: [usize; K],
    /// A weight for each context, 1.0 = 2¹⁶, in a set for each node.
    weights: Vec<[i32; K]>,
    limit: u32,
}

impl<const K: usize> Field<K> {
    /// A field with `nodes` nodes whose `k`th context has `contexts[k]` values.
    pub fn new(nodes: usize, contexts: [usize; K], limit: u32) -> Self {
        let mut starts = [0; K];
        let mut total = 0;
        for (start, n) in starts.iter_mut().zip(contexts) {
            *start = total;
            total += n * nodes;
        }
        let weight = (65536 / K) as i32;
        Field { slots: vec![Slot::NEW; total], nodes, starts, weights: vec![[weight; K]; nodes], limit }
    }

    /// Gives all contexts first opinions.
    pub fn prior(mut self, chances: &[u8], counts: [u32; K]) -> Self {
        for k in 0..K {
            let end = self.starts.get(k + 1).copied().unwrap_or(self.slots.len());
            for context in self.slots[self.starts[k]..end].chunks_mut(self.nodes) {
                for (slot, &one) in context.iter_mut().zip(chances) {
                    *slot = Slot((u32::from(one) * 256 + 128) << 16 | counts[k]);
                }
            }
        }
        self
    }

    /// Gives a slot a first opinion: `one / 2¹⁶`, held as firmly as after `count` decisions.
    pub fn set(&mut self, k: usize, context: usize, node: usize, one: u32, count: u32) {
        self.slots[self.starts[k] + context * self.nodes + node] = Slot(one << 16 | count);
    }

    /// Codes one decision at `node`.
    #[inline]
    pub fn bit<C: Coder>(&mut self, coder: &mut C, contexts: &[usize; K], node: usize, bit: u32) -> u32 {
        let tables = &*TABLES;
        let mut inputs = [0i32; K];
        let weights = &mut self.weights[node];
        let mut sum = 0i64;
        for k in 0..K {
            let slot = self.slots[self.starts[k] + contexts[k] * self.nodes + node];
            let stretched = i32::from(tables.stretch[(slot.0 >> 20) as usize]);
            inputs[k] = stretched * tables.trust[(slot.0 & 1023) as usize] >> 8;
            sum += i64::from(inputs[k]) * i64::from(weights[k]);
        }
        let x = (sum >> 16).clamp(i64::from(-LAST), i64::from(LAST)) as i32;
        let one = u32::from(tables.squash[(x + LAST) as usize]);
        let bit = coder.bit(one, bit);
        let error = if bit != 0 { 65536 - one as i32 } else { -(one as i32) };
        for k in 0..K {
            weights[k] += (inputs[k] * error + (1 << 13)) >> 14;
            self.slots[self.starts[k] + contexts[k] * self.nodes + node].update(bit, self.limit, tables);
        }
        bit
    }

    /// Codes `count` bits of `value`, the highest first, each under the ones before; needs `2^count` nodes from `first`.
    pub fn tree<C: Coder>(
        &mut self,
        coder: &mut C,
        contexts: &[usize; K],
        first: usize,
        count: u32,
        value: u32,
    ) -> u32 {
        let mut node = 1;
        for i in (0..count).rev() {
            node = node << 1 | self.bit(coder, contexts, first + node, value >> i & 1) as usize;
        }
        node as u32 - (1 << count)
    }

    /// Codes an integer of at most 17 bits' magnitude: zero, sign, then the magnitude's length and its bits.
    pub fn signed<C: Coder>(&mut self, coder: &mut C, contexts: &[usize; K], value: i32) -> i32 {
        if self.bit(coder, contexts, 0, u32::from(value == 0)) != 0 {
            return 0;
        }
        let negative = self.bit(coder, contexts, 1, u32::from(value < 0)) != 0;
        let magnitude = self.magnitude(coder, contexts, value.unsigned_abs()) as i32;
        if negative { -magnitude } else { magnitude }
    }

    fn magnitude<C: Coder>(&mut self, coder: &mut C, contexts: &[usize; K], value: u32) -> u32 {
        let value = value.max(1);
        let mut length = 0;
        while length < 16 && self.bit(coder, contexts, 2 + length as usize, u32::from(value.ilog2() > length)) != 0 {
            length += 1;
        }
        // The two bits below the highest are modelled, the rest is as good as noise.
        let (node, mut m, mut left) = (20 + 3 * length as usize, 1, length);
        while left > length.saturating_sub(2) {
            left -= 1;
            let node = if m == 1 { node } else { node + 1 + (m & 1) as usize };
            m = m << 1 | self.bit(coder, contexts, node, value >> left & 1);
        }
        m << left | coder.raw(left, value & ((1 << left) - 1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_round_alike_everywhere() {
        let clear = |v: f64| (v - v.floor() - 0.5).abs() > 1e-9;
        assert!((0..4096).all(|i| clear(formulas::stretch(i))));
        assert!((0..4095).all(|i| clear(formulas::squash(i))));
        assert!((0..1024).all(|n| clear(formulas::step(n)) && clear(formulas::trust(n))));
    }
}
