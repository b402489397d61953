//! Chooses colours for a tile that are near those of the picture and cheap to code. Flat ground keeps its colours.
//!
//! First the number of colours is reduced: a rare colour is replaced by a frequent one within the tolerance. Then,
//! pixel by pixel, the encoder chooses between that colour and the predicted ones within the tolerance, by rate and
//! distortion.

use std::cmp::Reverse;
use std::collections::HashMap;

use super::colors::{Around, Candidates, Colors};
use super::covered::{CELL, ExactTile};
use super::neighbours::sample;
use super::tile::{Shape, Source, State, colors};
use crate::bitstream::coder::range::{Coder, Cumulative};
use crate::bitstream::detail::decisions::{Adaptive, Decisions, price, price_of};
use crate::gaussian::Channels;
use crate::pixels::{Depth, Samples};

/// Minimum number of the eight neighbours of the same colour that a pixel of flat ground has.
const FLAT_NEIGHBOURS: usize = 5;
/// Squared error that is worth a bit, relative to the square of the tolerance. At the same size, 0.4 loses up to 4
/// SSIMULACRA2 points at a tolerance of 20, and 0.02 takes up to 10 % more bytes for the same points.
const SQUARES_A_BIT: f32 = 0.06;
/// Bits of a literal before any was coded, for each channel.
const FIRST_LITERAL_BITS: f32 = 5.0;
/// Number of literals over which their bits are averaged.
const LITERALS: f32 = 64.0;
/// Weights of the squared differences of red, green and blue.
const WEIGHTS: [f32; 3] = [0.3, 0.55, 0.15];
/// Maximum number of frequent colours with which a colour is compared in each of the neighbouring boxes.
const MAX_COMPARED: usize = 64;

/// Sums the cost of decisions in bits, and adapts the models.
#[derive(Debug, Default)]
pub(super) struct Bits {
    bits: f64,
}

impl Decisions for Bits {
    #[inline(always)]
    fn bit(&mut self, model: &mut Adaptive, bit: bool) -> bool {
        self.bits += f64::from(price(model, bit));
        model.learn(bit);
        bit
    }

    #[inline(always)]
    fn even(&mut self, bit: bool) -> bool {
        self.bits += 1.0;
        bit
    }
}

impl Coder for Bits {
    #[inline(always)]
    fn bit(&mut self, one: u32, bit: u32) -> u32 {
        self.bits += f64::from(price_of(if bit == 0 { 65_536 - one } else { one }));
        bit
    }

    fn uniform(&mut self, _total: u32, _value: u32) -> u32 {
        unreachable!("the exact layer has decisions only")
    }

    fn share(&mut self, _frequencies: &impl Cumulative, _value: i32) -> (i32, [u32; 2]) {
        unreachable!("the exact layer has decisions only")
    }
}

/// The chosen colours of a tile.
#[derive(Debug)]
pub(crate) struct Chosen {
    /// The tile with these colours.
    pub tile: ExactTile,
    /// Bits of each cell, row by row.
    pub bits: Vec<f32>,
}

/// Chooses the colours of a tile. No sample differs by more than `tolerance` 8-bit code values from that of `tile`, where
/// differences of colours count by their alpha, and samples of flat ground and of the cells that are `kept` do not differ.
pub(crate) fn approximate(tile: &ExactTile, shape: &Shape, tolerance: f32, kept: Option<&[bool]>) -> Chosen {
    let cells = tile.cells.as_deref();
    let given = colors(&tile.samples, shape.channels.count());
    let mut near = Near::new(&given, shape, cells, tolerance, kept);
    let coded = State::new(shape).code(&mut Bits::default(), shape.size[1], cells, &mut near, u64::MAX);
    coded.expect("a valid tile");
    let samples = samples(&near.chosen, shape);
    Chosen { tile: ExactTile { samples, cells: tile.cells.clone() }, bits: near.bits }
}

/// Returns the samples of colours.
fn samples(colors: &[u64], shape: &Shape) -> Samples {
    let all = colors.iter().flat_map(|&color| (0..shape.channels.count()).map(move |k| sample(color, k)));
    match shape.depth {
        Depth::Eight => Samples::U8(all.map(|v| v as u8).collect()),
        Depth::Sixteen => Samples::U16(all.map(|v| v as u16).collect()),
    }
}

/// Differences of colours, in 8-bit code values.
#[derive(Debug, Clone, Copy)]
struct Differences {
    channels: Channels,
    /// Factor from sample values to 8-bit code values.
    unit: f32,
    tolerance: f32,
}

impl Differences {
    /// Returns the value of a sample.
    #[inline(always)]
    fn value(&self, color: u64, channel: usize) -> f32 {
        sample(color, channel) as f32 * self.unit
    }

    /// Returns the weighted squared difference of two colours if `other` is within the tolerance of `given`.
    /// Transparent and opaque pixels remain so.
    #[inline(always)]
    fn squared(&self, given: u64, other: u64) -> Option<f32> {
        let differences: [f32; 4] = std::array::from_fn(|k| self.value(given, k) - self.value(other, k));
        let alpha = self.channels.alpha();
        let (opacity, colors) = (self.opacity(given), self.channels.count() - usize::from(alpha.is_some()));
        let seen = |k: usize| if k < colors { opacity * differences[k].abs() } else { differences[k].abs() };
        if (0..4).any(|k| seen(k) > self.tolerance) {
            return None;
        }
        let square = |k: usize| differences[k] * differences[k];
        if let Some(alpha) = alpha.filter(|&alpha| differences[alpha] != 0.0) {
            let opacity = self.value(given, alpha);
            if opacity == 0.0 || opacity == 255.0 {
                return None;
            }
        }
        let colors = match self.channels {
            Channels::Grey | Channels::GreyAlpha => square(0),
            Channels::Rgb | Channels::Rgba => (0..3).map(|k| WEIGHTS[k] * square(k)).sum(),
        };
        Some(alpha.map_or(colors, |alpha| colors * self.value(given, alpha) / 255.0 + square(alpha)))
    }

    /// Returns by how much differences of a colour count, 0 to 1. Hidden colours, which encoders may be asked to keep, count
    /// as visible ones do.
    #[inline(always)]
    fn opacity(&self, color: u64) -> f32 {
        match self.channels.alpha().map(|alpha| self.value(color, alpha)) {
            Some(alpha) if alpha > 0.0 => alpha / 255.0,
            _ => 1.0,
        }
    }

    /// Returns the box of a colour. Opaque colours within the tolerance of each other are in the same box or neighbouring
    /// ones.
    fn grid(&self, color: u64) -> [i32; 4] {
        let (alpha, opacity) = (self.channels.alpha(), self.opacity(color));
        std::array::from_fn(|k| {
            let seen = if alpha == Some(k) { self.value(color, k) } else { opacity * self.value(color, k) };
            (seen / (self.tolerance + 1.0)) as i32
        })
    }
}

/// The colours of a tile, and those that are chosen for them.
struct Near<'a> {
    given: &'a [u64],
    width: usize,
    differences: Differences,
    /// Whether each pixel belongs to flat ground or to a cell that is kept.
    flat: Vec<bool>,
    /// Mean bits of a literal.
    literal: f32,
    /// Bits up to the last pixel.
    before: f64,
    /// Bits of each cell.
    bits: Vec<f32>,
    /// The colours chosen so far; for later pixels, the colours after their number was reduced.
    chosen: Vec<u64>,
}

impl<'a> Near<'a> {
    fn new(given: &'a [u64], shape: &Shape, cells: Option<&[bool]>, tolerance: f32, kept: Option<&[bool]>) -> Self {
        let [width, height] = shape.size;
        let unit = match shape.depth {
            Depth::Eight => 1.0,
            Depth::Sixteen => 1.0 / 257.0,
        };
        let mut near = Near {
            given,
            width,
            differences: Differences { channels: shape.channels, unit, tolerance },
            flat: Vec::new(),
            literal: FIRST_LITERAL_BITS * shape.channels.count() as f32,
            before: 0.0,
            bits: vec![0.0; width.div_ceil(CELL) * height.div_ceil(CELL)],
            chosen: Vec::new(),
        };
        near.flat = (0..given.len()).map(|at| near.is_flat(at)).collect();
        near.chosen = near.reduced(cells);
        if let Some(kept) = kept {
            for (at, &color) in given.iter().enumerate() {
                if kept[near.cell(at)] {
                    (near.flat[at], near.chosen[at]) = (true, color);
                }
            }
        }
        near
    }

    /// Returns whether most neighbours of a pixel have its colour.
    fn is_flat(&self, at: usize) -> bool {
        let (x, y, color) = (at % self.width, at / self.width, self.given[at]);
        let columns = x.saturating_sub(1)..(x + 2).min(self.width);
        let rows = y.saturating_sub(1)..(y + 2).min(self.given.len() / self.width);
        let row =
            |y: usize| self.given[y * self.width..][columns.clone()].iter().filter(|&&other| other == color).count();
        // The pixel itself is counted as well.
        rows.map(row).sum::<usize>() > FLAT_NEIGHBOURS
    }

    /// Returns the colours with rare ones replaced by frequent ones within the tolerance.
    fn reduced(&self, cells: Option<&[bool]>) -> Vec<u64> {
        let mut counts = HashMap::<u64, (u32, bool)>::new();
        for (at, color) in self.given.iter().enumerate() {
            if cells.is_none_or(|cells| cells[self.cell(at)]) {
                let (count, is_flat) = counts.entry(*color).or_default();
                *count += 1;
                *is_flat |= self.flat[at];
            }
        }
        let mut all: Vec<_> = counts.into_iter().collect();
        all.sort_unstable_by_key(|&(color, (count, is_flat))| (!is_flat, Reverse(count), color));
        let mut grid = HashMap::<[i32; 4], Vec<u64>>::new();
        let mut replaced = HashMap::<u64, u64>::new();
        let reach = |channel: usize| if channel < self.differences.channels.count() { -1..=1 } else { 0..=0 };
        for (color, (_, is_flat)) in all {
            let own = self.differences.grid(color);
            let mut nearest: Option<(f32, u64)> = None;
            if !is_flat {
                for offset in reach(0).flat_map(|a| reach(1).map(move |b| [a, b])) {
                    for last in reach(2).flat_map(|c| reach(3).map(move |d| [c, d])) {
                        let place = [own[0] + offset[0], own[1] + offset[1], own[2] + last[0], own[3] + last[1]];
                        for &other in grid.get(&place).into_iter().flatten().take(MAX_COMPARED) {
                            let Some(difference) = self.differences.squared(color, other) else { continue };
                            if nearest.is_none_or(|(least, _)| difference < least) {
                                nearest = Some((difference, other));
                            }
                        }
                    }
                }
            }
            match nearest {
                Some((_, other)) => {
                    replaced.insert(color, other);
                }
                None => grid.entry(own).or_default().push(color),
            }
        }
        let new =
            |(at, color): (usize, &u64)| if self.flat[at] { *color } else { *replaced.get(color).unwrap_or(color) };
        self.given.iter().enumerate().map(new).collect()
    }

    fn cell(&self, at: usize) -> usize {
        let (x, y) = (at % self.width, at / self.width);
        y / CELL * self.width.div_ceil(CELL) + x / CELL
    }

    /// Returns the squared error of a colour for a pixel; `None` if the pixel must not have it.
    #[inline(always)]
    fn error(&self, at: usize, color: u64) -> Option<f32> {
        let given = self.given[at];
        if given == color {
            return Some(0.0);
        }
        if self.flat[at] { None } else { self.differences.squared(given, color) }
    }
}

impl Source<u64, Bits> for Near<'_> {
    fn run(&mut self, at: usize, most: usize, color: u64) -> usize {
        let length = (at..at + most).position(|at| self.error(at, color).is_none()).unwrap_or(most);
        self.chosen[at..at + length].fill(color);
        length
    }

    fn color(&mut self, at: usize, colors: &mut Colors<u64>, around: &Around<'_, u64>) -> u64 {
        if self.flat[at] {
            return self.given[at];
        }
        let reduced = self.chosen[at];
        let worth = SQUARES_A_BIT * self.differences.tolerance * self.differences.tolerance;
        let (mut best, mut least, mut is_predicted) = (reduced, f32::INFINITY, false);
        let none = Candidates::of(colors, around).visit(|color, bits| {
            is_predicted |= color == reduced;
            if let Some(error) = self.error(at, color) {
                let cost = error + worth * bits;
                if cost < least {
                    (best, least) = (color, cost);
                }
            }
        });
        let error = self.error(at, reduced).unwrap_or(0.0);
        if !is_predicted && error + worth * (none + self.literal) <= least {
            best = reduced;
        }
        self.chosen[at] = best;
        best
    }

    fn coded(&mut self, at: usize, count: usize, is_literal: bool, decisions: &Bits) {
        let spent = (decisions.bits - self.before) as f32;
        self.before = decisions.bits;
        if is_literal {
            self.literal += (spent - self.literal) / LITERALS;
        }
        // A run of length 0 belongs to the pixel after it.
        let count = count.max(1);
        for at in at..(at + count).min(self.given.len()) {
            let cell = self.cell(at);
            self.bits[cell] += spent / count as f32;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bitstream::exact::tile::write;

    /// Returns letters in random shades on flat ground, with a mask of alpha if there is alpha.
    fn letters(channels: Channels, depth: Depth, [width, height]: [usize; 2]) -> ExactTile {
        let mut state = 7u64;
        let mut random = |below: u64| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) % below
        };
        let mut samples = Vec::new();
        for at in 0..width * height {
            let is_ink = at % width % 7 < 4 && at / width % 9 < 6 && (at % 3 > 0 || at / width % 2 > 0);
            for k in 0..channels.count() {
                let ink = if channels.alpha() == Some(k) { random(4) * 85 } else { 20 + random(60) };
                samples.push(if is_ink { ink as u8 } else { 200 });
            }
        }
        let samples = match depth {
            Depth::Eight => Samples::U8(samples),
            Depth::Sixteen => {
                Samples::U16(samples.into_iter().map(|v| (u16::from(v) * 257).saturating_add(3)).collect())
            }
        };
        ExactTile { samples, cells: None }
    }

    fn values(tile: &ExactTile) -> Vec<f32> {
        match &tile.samples {
            Samples::U8(v) => v.iter().map(|&v| v.into()).collect(),
            Samples::U16(v) => v.iter().map(|&v| f32::from(v) / 257.0).collect(),
        }
    }

    #[test]
    fn chosen_colours_are_within_the_tolerance_and_cost_what_is_estimated() {
        let size = [61, 50];
        for channels in [Channels::Grey, Channels::GreyAlpha, Channels::Rgb, Channels::Rgba] {
            for depth in [Depth::Eight, Depth::Sixteen] {
                let (tile, shape) = (letters(channels, depth, size), Shape { size, channels, depth });
                let mut before = write(&tile, &shape).len();
                for tolerance in [4.0, 12.0, 32.0] {
                    let chosen = approximate(&tile, &shape, tolerance, None);
                    let (own, other) = (values(&tile), values(&chosen.tile));
                    let count = channels.count();
                    for (own, other) in own.chunks_exact(count).zip(other.chunks_exact(count)) {
                        let alpha = channels.alpha().map_or(255.0, |alpha| own[alpha]);
                        let opacity = if alpha > 0.0 { alpha / 255.0 } else { 1.0 };
                        for k in 0..count {
                            let counted = if channels.alpha() == Some(k) { 1.0 } else { opacity };
                            let difference = counted * (own[k] - other[k]).abs();
                            assert!(difference <= tolerance, "{channels:?} {depth:?}: {own:?} became {other:?}");
                        }
                    }
                    let length = write(&chosen.tile, &shape).len();
                    let estimated = chosen.bits.iter().sum::<f32>() / 8.0;
                    // The prices of 1/4096 of a probability, and the end of the stream.
                    assert!((estimated - length as f32).abs() < 0.01 * length as f32 + 8.0, "{estimated} of {length}");
                    assert!(
                        length < before,
                        "{channels:?} {depth:?}: {length} bytes at {tolerance}, not below {before}"
                    );
                    before = length;
                }
            }
        }
    }

    #[test]
    fn flat_ground_and_transparent_and_opaque_pixels_keep_their_values() {
        let size = [61, 50];
        let shape = Shape { size, channels: Channels::Rgba, depth: Depth::Eight };
        let tile = letters(Channels::Rgba, Depth::Eight, size);
        let chosen = values(&approximate(&tile, &shape, 48.0, None).tile);
        for (own, other) in values(&tile).chunks_exact(4).zip(chosen.chunks_exact(4)) {
            assert!(own != [200.0; 4] || own == other);
            assert!(![0.0, 255.0].contains(&own[3]) || own[3] == other[3], "{own:?} became {other:?}");
        }
    }

    #[test]
    fn nearly_transparent_pixels_may_have_other_colours() {
        // A soft shadow whose colours, as browsers store them, are rounded by the division by alpha.
        let size = [48, 40];
        let shape = Shape { size, channels: Channels::Rgba, depth: Depth::Eight };
        let mut tile = letters(Channels::Rgba, Depth::Eight, size);
        let Samples::U8(samples) = &mut tile.samples else { panic!("8 bits") };
        for (at, pixel) in samples.chunks_exact_mut(4).enumerate() {
            let alpha = 1 + at % 48 / 12;
            pixel.copy_from_slice(&[(at * 7 % alpha * 255 / alpha) as u8, 0, (at * 3 % 5 * 51) as u8, alpha as u8]);
        }
        let chosen = values(&approximate(&tile, &shape, 8.0, None).tile);
        let colors: std::collections::HashSet<_> = chosen.chunks_exact(4).map(|p| [p[0] as u8, p[2] as u8]).collect();
        assert!(colors.len() <= 2, "{colors:?}");
    }

    #[test]
    fn a_tolerance_of_nothing_keeps_every_colour() {
        let size = [40, 30];
        let shape = Shape { size, channels: Channels::Rgb, depth: Depth::Eight };
        let tile = letters(Channels::Rgb, Depth::Eight, size);
        assert_eq!(approximate(&tile, &shape, 0.0, None).tile, tile);
    }
}
