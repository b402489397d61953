//! Codes one tile, row by row: runs of flat ground, predicted colours, and literal colours (spec §12.4).

use super::arithmetic::key;
use super::colors::{Around, Colors, ENTRY_BYTES, REACH, ROWS_ABOVE};
use super::literal::{LINE_BYTES, Literals};
use super::{CELL, ExactTile, mask};
use crate::bitstream::broken::Broken;
use crate::bitstream::coder::range::{Coder, Decoder, Encoder};
use crate::bitstream::detail::decisions::{Adaptive, Decisions};
use crate::error::Result;
use crate::gaussian::Channels;
use crate::limits::Limits;
use crate::parameter::Limit;
use crate::pixels::{Depth, Samples};

/// Pixels that are added on both sides of a row, so that contexts need no bounds.
const MARGIN: usize = REACH;
/// Classes of the length of a run, and of the position of its end.
const LENGTHS: usize = 16;

/// Size and kind of a tile.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Shape {
    pub size: [usize; 2],
    pub channels: Channels,
    pub depth: Depth,
}

/// The colours around a pixel. A colour is a number with 16 bits for each channel, the first in the lowest.
#[derive(Debug, Clone, Copy)]
pub(super) struct Neighbours {
    pub w: u64,
    pub n: u64,
    pub nw: u64,
    pub ne: u64,
    pub ww: u64,
    pub nn: u64,
}

impl Neighbours {
    pub(super) fn all(&self) -> [u64; 6] {
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
    fn are_equal(&self) -> bool {
        let Neighbours { w, n, nw, ne, ww, nn } = *self;
        w == n && w == nw && w == ne && w == ww && w == nn
    }
}

/// Returns a sample of a colour.
#[inline(always)]
pub(super) fn sample(color: u64, channel: usize) -> i32 {
    (color >> (16 * channel)) as i32 & 0xffff
}

/// Returns the bytes of memory that coding a tile takes, without its samples.
pub(crate) fn working_memory([width, height]: [usize; 2]) -> u64 {
    /// Bytes of the models whose number does not depend on the tile.
    const MODELS: u64 = 2 << 20;
    let padded = ((width + 2 * MARGIN) * (height + ROWS_ABOVE)) as u64;
    let addressed = 1u64 << address((width * height) as u64);
    padded * (size_of::<u64>() + size_of::<u32>()) as u64 + addressed * (ENTRY_BYTES + LINE_BYTES) + MODELS
}

/// Work of a pixel in a run, of any other pixel, and of a bit of a literal sample, in the units of
/// [`Limits::work`](crate::Limits::work).
const RUN_WORK: u64 = 2;
const PIXEL_WORK: u64 = 300;
const BIT_WORK: u64 = 40;

/// Returns the number of bits that entries and lines are addressed by in a tile of this many pixels.
fn address(pixels: u64) -> u32 {
    (pixels.max(1).ilog2() + 2).clamp(10, 16)
}

/// The colours that are coded. Positions are those in the tile, row by row.
pub(super) trait Source<D> {
    /// Returns how many of the `most` pixels from `at` on have this colour.
    fn run(&mut self, at: usize, most: usize, color: u64) -> usize;

    /// Returns the colour of a pixel.
    fn color(&mut self, at: usize, colors: &mut Colors, around: &Around<'_>) -> u64;

    /// Is called after `count` pixels from `at` on are coded.
    fn coded(&mut self, _at: usize, _count: usize, _is_literal: bool, _decisions: &D) {}
}

/// The source of a reader, which decodes the colours.
struct Unknown;

impl<D> Source<D> for Unknown {
    #[inline(always)]
    fn run(&mut self, _at: usize, _most: usize, _color: u64) -> usize {
        0
    }

    #[inline(always)]
    fn color(&mut self, _at: usize, _colors: &mut Colors, _around: &Around<'_>) -> u64 {
        0
    }
}

/// The colours of a tile's pixels.
struct Known<'a>(&'a [u64]);

impl<D> Source<D> for Known<'_> {
    fn run(&mut self, at: usize, most: usize, color: u64) -> usize {
        self.0[at..].iter().take(most).take_while(|&&other| other == color).count()
    }

    fn color(&mut self, at: usize, _colors: &mut Colors, _around: &Around<'_>) -> u64 {
        self.0[at]
    }
}

/// The tile being coded: its pixels with margins on all sides, and the models.
pub(super) struct State {
    width: usize,
    stride: usize,
    pixels: Vec<u64>,
    /// Numbers of the pixels' colours in the sums of contexts.
    keys: Vec<u32>,
    colors: Colors,
    literals: Literals,
    /// Whether a run has its largest length: by that length, and whether the last two had.
    whole: [[Adaptive; 4]; LENGTHS],
    /// Whether the exponent of a run's length is larger: by the exponent of its largest length.
    longer: [[Adaptive; LENGTHS]; LENGTHS],
    last_runs: usize,
    /// Work of a literal colour.
    literal_work: u64,
    /// Work so far.
    work: u64,
}

impl State {
    pub(super) fn new(shape: &Shape) -> Self {
        let [width, height] = shape.size;
        let stride = width + 2 * MARGIN;
        let white = (0..shape.channels.count()).fold(0, |v, k| v | u64::from(top(shape.depth)) << (16 * k));
        let address = address((width * height) as u64);
        let count = stride * (height + ROWS_ABOVE);
        State {
            width,
            stride,
            pixels: vec![white; count],
            keys: vec![key(white); count],
            colors: Colors::new(stride, address),
            literals: Literals::new(shape.channels, 8 * shape.depth.bytes(), address),
            whole: [[Adaptive::new(240, 0); 4]; LENGTHS],
            longer: [[Adaptive::new(128, 0); LENGTHS]; LENGTHS],
            last_runs: 0,
            literal_work: BIT_WORK * (8 * shape.depth.bytes() * shape.channels.count()) as u64,
            work: 0,
        }
    }

    /// Returns the position of the first pixel of row `y`.
    fn row(&self, y: usize) -> usize {
        (y + ROWS_ABOVE) * self.stride + MARGIN
    }

    /// Sets some pixels from `at` on to a colour.
    #[inline(always)]
    fn fill(&mut self, at: usize, count: usize, color: u64) {
        self.pixels[at..at + count].fill(color);
        self.keys[at..at + count].fill(key(color));
    }

    /// Returns the pixels around the one at `at`.
    #[inline(always)]
    fn near(&self, at: usize) -> Neighbours {
        let (row, above) = (&self.pixels[at - 2..at], &self.pixels[at - self.stride - 1..][..3]);
        let nn = self.pixels[at - 2 * self.stride];
        Neighbours { w: row[1], n: above[1], nw: above[0], ne: above[2], ww: row[0], nn }
    }

    /// Codes the covered pixels from column `x` to column `end` of row `y`.
    fn span<D: Decisions + Coder>(
        &mut self,
        decisions: &mut D,
        [x, y]: [usize; 2],
        end: usize,
        source: &mut impl Source<D>,
    ) -> std::result::Result<(), Broken> {
        let (row, mut x) = (self.row(y), x);
        let mut excluded = None;
        while x < end {
            let at = row + x;
            let near = self.near(at);
            let place = y * self.width + x;
            if excluded.is_none() && near.are_equal() && self.pixels[at - self.stride + 2] == near.w {
                let above = &self.pixels[at - self.stride + 1..][..end - x];
                let most = above.iter().position(|&color| color != near.w).unwrap_or(above.len());
                let length = self.run(decisions, most, source.run(place, most, near.w))?;
                source.coded(place, length, false, decisions);
                if length < most {
                    excluded = Some(near.w);
                }
                self.fill(at, length, near.w);
                x += length;
                continue;
            }
            let contexts = self.colors.contexts(&self.keys, at);
            let around = Around { pixels: &self.pixels, contexts: &contexts, near: &near, excluded: excluded.take() };
            let given = source.color(place, &mut self.colors, &around);
            let predicted = self.colors.code(decisions, &around, given);
            let is_literal = predicted.is_err();
            let color = match predicted {
                Ok(color) => color,
                Err(excluded) => {
                    self.work += self.literal_work;
                    let color = decisions.apart(|coder| self.literals.code(coder, &near, given));
                    // Otherwise, a picture would have several streams.
                    if excluded.contains(color) {
                        return Err(Broken { field: "literal colour that was excluded", value: color });
                    }
                    color
                }
            };
            self.work += PIXEL_WORK;
            (self.pixels[at], self.keys[at]) = (color, key(color));
            self.colors.learn(&self.pixels, &contexts, at);
            source.coded(place, 1, is_literal, decisions);
            x += 1;
        }
        Ok(())
    }

    /// Codes how many of the next `most` pixels have the colour of flat ground.
    fn run<D: Decisions>(
        &mut self,
        decisions: &mut D,
        most: usize,
        length: usize,
    ) -> std::result::Result<usize, Broken> {
        let class = (most.ilog2() as usize).min(LENGTHS - 1);
        let is_whole = decisions.bit(&mut self.whole[class][self.last_runs], length == most);
        self.last_runs = 2 * self.last_runs % 4 + usize::from(is_whole);
        if is_whole {
            return Ok(most);
        }
        // One more than the length, so that it has a highest bit.
        let number = length as u32 + 1;
        let mut exponent = 0;
        while exponent < class && decisions.bit(&mut self.longer[class][exponent], number.ilog2() as usize > exponent) {
            exponent += 1;
        }
        let low = decisions.raw(exponent as u32, number & ((1 << exponent) - 1));
        let length = ((1 << exponent | low) - 1) as usize;
        if length >= most {
            return Err(Broken { field: "length of a run", value: length as u64 });
        }
        Ok(length)
    }

    /// Passes all samples to `push`, row by row with interleaved channels; those that are not covered are 0.
    fn samples(&self, shape: &Shape, cells: Option<&[bool]>, mut push: impl FnMut(i32)) {
        let [width, height] = shape.size;
        for y in 0..height {
            for (x, &color) in self.pixels[self.row(y)..][..width].iter().enumerate() {
                let is_covered = cells.is_none_or(|cells| cells[y / CELL * width.div_ceil(CELL) + x / CELL]);
                let color = if is_covered { color } else { 0 };
                (0..shape.channels.count()).for_each(|k| push(sample(color, k)));
            }
        }
    }

    /// Codes all pixels, with at most `most_work` work.
    pub(super) fn code<D: Decisions + Coder>(
        &mut self,
        decisions: &mut D,
        height: usize,
        cells: Option<&[bool]>,
        source: &mut impl Source<D>,
        most_work: u64,
    ) -> Result<()> {
        for y in 0..height {
            self.work += RUN_WORK * self.width as u64;
            Limits::check(Limit::Work, self.work, most_work)?;
            let row = self.row(y);
            let first = self.pixels[row - self.stride];
            self.fill(row - MARGIN, MARGIN, first);
            match cells {
                None => self.span(decisions, [0, y], self.width, source)?,
                Some(cells) => {
                    let across = self.width.div_ceil(CELL);
                    let cells = &cells[y / CELL * across..][..across];
                    let mut x = 0;
                    while x < self.width {
                        let is_covered = cells[x / CELL];
                        let count = cells[x / CELL..].iter().take_while(|&&cell| cell == is_covered).count();
                        let end = (x / CELL * CELL + count * CELL).min(self.width);
                        if is_covered {
                            self.span(decisions, [x, y], end, source)?;
                        } else {
                            // Pixels that are not covered continue the colour to their left.
                            let color = self.pixels[row + x - 1];
                            self.fill(row + x, end - x, color);
                        }
                        x = end;
                    }
                }
            }
            let (first, last) = (self.pixels[row], self.pixels[row + self.width - 1]);
            self.fill(row - MARGIN, MARGIN, first);
            self.fill(row + self.width, MARGIN, last);
        }
        Ok(())
    }
}

/// Returns the largest sample value.
fn top(depth: Depth) -> u16 {
    match depth {
        Depth::Eight => 255,
        Depth::Sixteen => 65_535,
    }
}

/// Returns the colours of samples.
pub(super) fn colors(samples: &Samples, channels: usize) -> Vec<u64> {
    fn packed<T: Copy + Into<u64>>(samples: &[T], channels: usize) -> Vec<u64> {
        let color = |pixel: &[T]| pixel.iter().rev().fold(0, |color, &v| color << 16 | v.into());
        samples.chunks_exact(channels).map(color).collect()
    }
    match samples {
        Samples::U8(v) => packed(v, channels),
        Samples::U16(v) => packed(v, channels),
    }
}

/// Reads the stream of a tile, with at most `most_work` work. Returns the tile and the work.
pub(crate) fn read(stream: &[u8], shape: &Shape, most_work: u64) -> Result<(ExactTile, u64)> {
    let mut decoder = Decoder::new(stream)?;
    let cells = mask::code(&mut decoder, shape.size, None)?;
    let mut state = State::new(shape);
    let [width, height] = shape.size;
    state.code(&mut decoder, height, cells.as_deref(), &mut Unknown, most_work)?;
    decoder.finish()?;
    let count = width * height * shape.channels.count();
    let samples = match shape.depth {
        Depth::Eight => {
            let mut samples = Vec::with_capacity(count);
            state.samples(shape, cells.as_deref(), |v| samples.push(v as u8));
            Samples::U8(samples)
        }
        Depth::Sixteen => {
            let mut samples = Vec::with_capacity(count);
            state.samples(shape, cells.as_deref(), |v| samples.push(v as u16));
            Samples::U16(samples)
        }
    };
    Ok((ExactTile { samples, cells }, state.work))
}

/// Writes the stream of a tile.
pub(crate) fn write(tile: &ExactTile, shape: &Shape) -> Vec<u8> {
    let mut encoder = Encoder::default();
    let given = colors(&tile.samples, shape.channels.count());
    let cells = tile.cells.as_deref();
    let mut code = || {
        mask::code(&mut encoder, shape.size, cells)?;
        State::new(shape).code(&mut encoder, shape.size[1], cells, &mut Known(&given), u64::MAX)
    };
    code().expect("a valid tile");
    encoder.finish()
}
