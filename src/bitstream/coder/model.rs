//! Adaptive probabilities of binary decisions (spec §8.3).

use super::range::Coder;

/// Nodes of [`Field::signed`]'s binarization.
pub(crate) const SIGNED_NODES: usize = 72;

/// Adaptation rate `2¹⁶/(n + 2)` of a slot after `n` decisions.
const STEPS: [u16; 256] = {
    let mut steps = [0; 256];
    let mut n = 0;
    while n < 256 {
        steps[n] = (65536 / (n + 2)) as u16;
        n += 1;
    }
    steps
};

/// A probability of 1 in 22 bits above a count of decisions in 10.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Slot(u32);

impl Slot {
    const NEW: Slot = Slot(1 << 31);

    /// Initial probability `one / 2¹⁶`, with the confidence of `count` decisions.
    pub(crate) const fn new(one: u32, count: u32) -> Self {
        Slot(one << 16 | count)
    }

    /// Codes one decision and counts it, up to `limit < 256`.
    #[inline]
    pub(crate) fn code<C: Coder>(&mut self, coder: &mut C, limit: u32, bit: u32) -> u32 {
        let bit = coder.bit(self.one(), bit);
        self.update(bit, limit);
        bit
    }

    /// Returns the probability of a 1 in 1/65536; never 0 or 1.
    #[inline]
    fn one(self) -> u32 {
        (self.0 >> 16).clamp(32, 65504)
    }

    #[inline]
    fn update(&mut self, bit: u32, limit: u32) {
        let (p, n) = (self.0 >> 10, self.0 & 1023);
        let target = if bit != 0 { (1 << 22) - 1 } else { 0 };
        let moved = (i64::from(target - p as i32) * i64::from(STEPS[n as usize & 255])) >> 16;
        let p = (i64::from(p) + moved) as u32;
        self.0 = p << 10 | (n + 1).min(limit);
    }
}

/// The model of one field: contexts, each with a slot for every node of the field's binarization.
#[derive(Debug, Clone)]
pub(crate) struct Field {
    slots: Vec<Slot>,
    nodes: usize,
    limit: u32,
}

impl Field {
    /// Returns a field with `nodes` nodes and `contexts` contexts, whose slots count up to `limit < 256` decisions.
    pub(crate) fn new(nodes: usize, contexts: usize, limit: u32) -> Self {
        Field { slots: vec![Slot::NEW; nodes * contexts], nodes, limit }
    }

    /// Codes one decision at `node`.
    #[inline]
    pub(crate) fn bit<C: Coder>(&mut self, coder: &mut C, context: usize, node: usize, bit: u32) -> u32 {
        self.slots[context * self.nodes + node].code(coder, self.limit, bit)
    }

    /// Codes `count` bits of `value`, the highest first, each in the context of the ones before; needs `2^count`
    /// nodes.
    pub(crate) fn tree<C: Coder>(&mut self, coder: &mut C, context: usize, count: u32, value: u32) -> u32 {
        let mut node = 1;
        for i in (0..count).rev() {
            node = node << 1 | self.bit(coder, context, node, value >> i & 1) as usize;
        }
        node as u32 - (1 << count)
    }

    /// Codes an integer whose magnitude has at most 17 bits: zero, sign, then the magnitude's length and its bits.
    pub(crate) fn signed<C: Coder>(&mut self, coder: &mut C, context: usize, value: i32) -> i32 {
        if self.bit(coder, context, 0, u32::from(value == 0)) != 0 {
            return 0;
        }
        let negative = self.bit(coder, context, 1, u32::from(value < 0)) != 0;
        let magnitude = self.magnitude(coder, context, value.unsigned_abs()) as i32;
        if negative { -magnitude } else { magnitude }
    }

    fn magnitude<C: Coder>(&mut self, coder: &mut C, context: usize, value: u32) -> u32 {
        let value = value.max(1);
        let mut length = 0;
        while length < 16 && self.bit(coder, context, 2 + length as usize, u32::from(value.ilog2() > length)) != 0 {
            length += 1;
        }
        // The two bits below the highest are modelled; the others are coded with equal probabilities.
        let (node, mut m, mut left) = (20 + 3 * length as usize, 1, length);
        while left > length.saturating_sub(2) {
            left -= 1;
            let node = if m == 1 { node } else { node + 1 + (m & 1) as usize };
            m = m << 1 | self.bit(coder, context, node, value >> left & 1);
        }
        m << left | coder.raw(left, value & ((1 << left) - 1))
    }
}
