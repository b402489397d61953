//! The colours around a pixel, and the rows that hold them.

use super::arithmetic::key;
use super::packed::Packed;

/// The colours around a pixel.
#[derive(Debug, Clone, Copy)]
pub(super) struct Neighbours<P> {
    pub w: P,
    pub n: P,
    pub nw: P,
    pub ne: P,
    pub ww: P,
    pub nn: P,
}

impl<P: Packed> Neighbours<P> {
    /// Returns the neighbours with 16 bits for each channel.
    #[inline(always)]
    pub(super) fn wide(&self) -> Neighbours<u64> {
        let Neighbours { w, n, nw, ne, ww, nn } = *self;
        Neighbours { w: w.wide(), n: n.wide(), nw: nw.wide(), ne: ne.wide(), ww: ww.wide(), nn: nn.wide() }
    }

    #[inline(always)]
    pub(super) fn all(&self) -> [P; 6] {
        [self.w, self.n, self.nw, self.ne, self.ww, self.nn]
    }

    /// Returns which neighbours are equal, as six bits.
    #[inline(always)]
    pub(super) fn pattern(&self) -> usize {
        let Neighbours { w, n, nw, ne, ww, nn } = *self;
        [w == n, w == nw, n == nw, n == ne, ww == w, nn == n].iter().rev().fold(0, |p, &b| 2 * p + usize::from(b))
    }

    /// Returns whether all neighbours have the same colour.
    #[inline(always)]
    pub(super) fn are_equal(&self) -> bool {
        let Neighbours { w, n, nw, ne, ww, nn } = *self;
        w == n && w == nw && w == ne && w == ww && w == nn
    }
}

/// A row of colours with margins on both sides, and the numbers of these colours in the sums of contexts.
pub(super) struct Row<P> {
    pub colors: Vec<P>,
    pub keys: Vec<u32>,
}

impl<P: Packed> Row<P> {
    /// Sets some pixels from `at` on to a colour.
    #[inline(always)]
    pub(super) fn fill(&mut self, at: usize, count: usize, color: P) {
        self.colors[at..at + count].fill(color);
        self.keys[at..at + count].fill(key(color.wide()));
    }
}

/// Returns a sample of a colour with 16 bits for each channel.
#[inline(always)]
pub(super) fn sample(color: u64, channel: usize) -> i32 {
    (color >> (16 * channel)) as i32 & 0xffff
}
