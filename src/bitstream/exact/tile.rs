//! Codes one tile, row by row: runs of flat ground, predicted colours, and literal colours (spec §12.4).

use super::arithmetic::key;
use super::colors::{Around, Colors, REACH, ROWS, entry_bytes};
use super::covered::{CELL, ExactTile};
use super::literal::{LINE_BYTES, Literal, Literals};
use super::mask;
use super::neighbours::{Neighbours, Row};
use super::packed::Packed;
use crate::bitstream::broken::Broken;
use crate::bitstream::coder::range::{Coder, Decoder, Encoder};
use crate::bitstream::detail::decisions::{Adaptive, Decisions};
use crate::error::Result;
use crate::gaussian::Channels;
use crate::limits::Limits;
use crate::parameter::Limit;
use crate::pixels::{Depth, Samples};
use crate::simd::{Simd, Task, dispatch};

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

/// Returns the bytes of memory that coding a tile takes, without its samples.
pub(crate) fn working_memory(shape: &Shape) -> u64 {
    /// Bytes of the models whose number does not depend on the tile.
    const MODELS: u64 = 2 << 20;
    let color = match shape.depth {
        Depth::Eight => size_of::<Eight>(),
        Depth::Sixteen => size_of::<u64>(),
    };
    let [width, height] = shape.size;
    let rows = (ROWS * (width + 2 * MARGIN) * (color + size_of::<u32>())) as u64;
    let addressed = 1u64 << address((width * height) as u64);
    rows + addressed * (entry_bytes(color) + LINE_BYTES) + MODELS
}

/// Colours of pictures of 8 bits. WebAssembly has one copy of the code for all pictures.
#[cfg(not(target_family = "wasm"))]
type Eight = u32;
#[cfg(target_family = "wasm")]
type Eight = u64;

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
pub(super) trait Source<P, D> {
    /// Returns how many of the `most` pixels from `at` on have this colour.
    fn run(&mut self, at: usize, most: usize, color: P) -> usize;

    /// Returns the colour of a pixel.
    fn color(&mut self, at: usize, colors: &mut Colors<P>, around: &Around<'_, P>) -> P;

    /// Is called after `count` pixels from `at` on are coded.
    #[inline(always)]
    fn coded(&mut self, _at: usize, _count: usize, _is_literal: bool, _decisions: &D) {}

    /// Is called after row `y` is coded.
    #[inline(always)]
    fn row(&mut self, _y: usize, _colors: &[P]) {}
}

/// The source of a reader, which decodes the colours, with the receiver of its rows. The receiver has no type of its own,
/// so that there is one copy of the code for both depths in WebAssembly.
struct Unknown<'a, P>(&'a mut dyn FnMut(usize, &[P]));

impl<P: Packed, D> Source<P, D> for Unknown<'_, P> {
    #[inline(always)]
    fn run(&mut self, _at: usize, _most: usize, _color: P) -> usize {
        0
    }

    #[inline(always)]
    fn color(&mut self, _at: usize, _colors: &mut Colors<P>, _around: &Around<'_, P>) -> P {
        P::ZERO
    }

    #[inline(always)]
    fn row(&mut self, y: usize, colors: &[P]) {
        self.0(y, colors);
    }
}

/// The colours of a tile's pixels.
struct Known<'a>(&'a [u64]);

impl<D> Source<u64, D> for Known<'_> {
    fn run(&mut self, at: usize, most: usize, color: u64) -> usize {
        self.0[at..].iter().take(most).take_while(|&&other| other == color).count()
    }

    fn color(&mut self, at: usize, _colors: &mut Colors<u64>, _around: &Around<'_, u64>) -> u64 {
        self.0[at]
    }
}

/// Models of the lengths of runs.
struct Runs {
    /// Whether a run has its largest length: by that length, and whether the last two had.
    whole: [[Adaptive; 4]; LENGTHS],
    /// Whether the exponent of a run's length is larger: by the exponent of its largest length.
    longer: [[Adaptive; LENGTHS]; LENGTHS],
    last: usize,
}

impl Runs {
    /// Codes how many of the next `most` pixels have the colour of flat ground.
    fn code<D: Decisions>(
        &mut self,
        decisions: &mut D,
        most: usize,
        length: usize,
    ) -> std::result::Result<usize, Broken> {
        let class = (most.ilog2() as usize).min(LENGTHS - 1);
        let is_whole = decisions.bit(&mut self.whole[class][self.last], length == most);
        self.last = 2 * self.last % 4 + usize::from(is_whole);
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
}

/// The tile being coded: the last rows of its pixels, and the models.
pub(super) struct State<P> {
    width: usize,
    /// The row that is coded, and those above it, the nearest first.
    rows: [Row<P>; ROWS],
    colors: Colors<P>,
    literals: Literals,
    runs: Runs,
    /// Work of a literal colour.
    literal_work: u64,
    /// Work so far.
    work: u64,
}

impl<P: Packed> State<P> {
    pub(super) fn new(shape: &Shape) -> Self {
        let [width, height] = shape.size;
        let stride = width + 2 * MARGIN;
        let white = (0..shape.channels.count()).fold(0, |v, k| v | u64::from(top(shape.depth)) << (16 * k));
        let address = address((width * height) as u64);
        let row = |_| Row { colors: vec![P::of(white); stride], keys: vec![key(white); stride] };
        State {
            width,
            rows: std::array::from_fn(row),
            colors: Colors::new(address),
            literals: Literals::new(shape.channels, 8 * shape.depth.bytes(), address),
            runs: Runs {
                whole: [[Adaptive::new(240, 0); 4]; LENGTHS],
                longer: [[Adaptive::new(128, 0); LENGTHS]; LENGTHS],
                last: 0,
            },
            literal_work: BIT_WORK * (8 * shape.depth.bytes() * shape.channels.count()) as u64,
            work: 0,
        }
    }

    /// Returns the pixels around the one at column `x`, which counts the margin.
    #[inline(always)]
    fn near(&self, x: usize) -> Neighbours<P> {
        let [row, above, second, ..] = &self.rows;
        let (row, above) = (&row.colors[x - 2..x], &above.colors[x - 1..x + 2]);
        Neighbours { w: row[1], n: above[1], nw: above[0], ne: above[2], ww: row[0], nn: second.colors[x] }
    }

    /// Codes the covered pixels from column `x` to column `end` of row `y`.
    #[inline(always)]
    fn span<D: Decisions + Coder, S: Simd>(
        &mut self,
        simd: S,
        decisions: &mut D,
        [x, y]: [usize; 2],
        end: usize,
        source: &mut impl Source<P, D>,
    ) -> std::result::Result<(), Broken> {
        let mut x = x;
        let mut excluded = None;
        // End of the pixels of the same colour in the row above, as far as it is known.
        let mut known = 0;
        while x < end {
            let at = x + MARGIN;
            let near = self.near(at);
            let place = y * self.width + x;
            if excluded.is_none() && near.are_equal() && self.rows[1].colors[at + 2] == near.w {
                if known <= x {
                    let above = &self.rows[1].colors[at + 1..][..end - x];
                    known = x + equal(above, near.w);
                }
                let most = known - x;
                let length = self.runs.code(decisions, most, source.run(place, most, near.w))?;
                source.coded(place, length, false, decisions);
                if length < most {
                    excluded = Some(near.w);
                }
                self.rows[0].fill(at, length, near.w);
                x += length;
                continue;
            }
            let contexts = self.colors.contexts(&self.rows, x);
            let around = Around { contexts: &contexts, near: &near, excluded: excluded.take() };
            let given = source.color(place, &mut self.colors, &around);
            let predicted = self.colors.code(decisions, &around, given);
            let is_literal = predicted.is_err();
            let color = match predicted {
                Ok(color) => color,
                Err(excluded) => {
                    self.work += self.literal_work;
                    let (near, given, literals) = (near.wide(), given.wide(), &mut self.literals);
                    let wide = simd.call(Literal { literals, coder: decisions, near, given });
                    let color = P::of(wide);
                    // Otherwise, a picture would have several streams.
                    if excluded.contains(color) {
                        return Err(Broken { field: "literal colour that was excluded", value: wide });
                    }
                    color
                }
            };
            self.work += PIXEL_WORK;
            (self.rows[0].colors[at], self.rows[0].keys[at]) = (color, key(color.wide()));
            self.colors.learn(&contexts, color);
            source.coded(place, 1, is_literal, decisions);
            x += 1;
        }
        Ok(())
    }

    /// Codes all pixels, with at most `most_work` work.
    pub(super) fn code<D: Decisions + Coder>(
        &mut self,
        decisions: &mut D,
        height: usize,
        cells: Option<&[bool]>,
        source: &mut impl Source<P, D>,
        most_work: u64,
    ) -> Result<()> {
        dispatch(Coding { state: self, decisions, height, cells, source, most_work })
    }

    #[inline(always)]
    fn code_with<D: Decisions + Coder, S: Simd>(
        &mut self,
        simd: S,
        decisions: &mut D,
        height: usize,
        cells: Option<&[bool]>,
        source: &mut impl Source<P, D>,
        most_work: u64,
    ) -> Result<()> {
        for y in 0..height {
            self.work += RUN_WORK * self.width as u64;
            Limits::check(Limit::Work, self.work, most_work)?;
            self.rows.rotate_right(1);
            let first = self.rows[1].colors[MARGIN];
            self.rows[0].fill(0, MARGIN, first);
            match cells {
                None => self.span(simd, decisions, [0, y], self.width, source)?,
                Some(cells) => {
                    let across = self.width.div_ceil(CELL);
                    let cells = &cells[y / CELL * across..][..across];
                    let mut x = 0;
                    while x < self.width {
                        let is_covered = cells[x / CELL];
                        let count = cells[x / CELL..].iter().take_while(|&&cell| cell == is_covered).count();
                        let end = (x / CELL * CELL + count * CELL).min(self.width);
                        if is_covered {
                            self.span(simd, decisions, [x, y], end, source)?;
                        } else {
                            // Pixels that are not covered continue the colour to their left.
                            let color = self.rows[0].colors[MARGIN + x - 1];
                            self.rows[0].fill(MARGIN + x, end - x, color);
                        }
                        x = end;
                    }
                }
            }
            let row = &mut self.rows[0];
            let (first, last) = (row.colors[MARGIN], row.colors[MARGIN + self.width - 1]);
            row.fill(0, MARGIN, first);
            row.fill(MARGIN + self.width, MARGIN, last);
            source.row(y, &row.colors[MARGIN..][..self.width]);
        }
        Ok(())
    }
}

/// Coding of all pixels with certain instructions.
struct Coding<'a, P, D, F> {
    state: &'a mut State<P>,
    decisions: &'a mut D,
    height: usize,
    cells: Option<&'a [bool]>,
    source: &'a mut F,
    most_work: u64,
}

impl<P: Packed, D: Decisions + Coder, F: Source<P, D>> Task for Coding<'_, P, D, F> {
    type Output = Result<()>;

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> Result<()> {
        let Coding { state, decisions, height, cells, source, most_work } = self;
        state.code_with(simd, decisions, height, cells, source, most_work)
    }
}

/// Returns how many of the first pixels have a colour.
#[inline(always)]
fn equal<P: Packed>(pixels: &[P], color: P) -> usize {
    /// Pixels that are compared at once, without branches.
    const STEP: usize = 16;
    let (steps, _) = pixels.as_chunks::<STEP>();
    let start = STEP * steps.iter().take_while(|step| step.iter().fold(true, |all, &v| all & (v == color))).count();
    start + pixels[start..].iter().take_while(|&&v| v == color).count()
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

/// Sets the samples of a colour.
#[inline(always)]
fn unpack<P: Packed, T, const N: usize>(color: P, to: &mut [T; N], cut: impl Fn(u64) -> T) {
    let wide = color.wide();
    for (k, to) in to.iter_mut().enumerate() {
        *to = cut(wide >> (16 * k));
    }
}

/// Appends the samples of colours.
#[inline(always)]
fn append<P: Packed, T: Copy + Default>(
    colors: &[P],
    channels: Channels,
    samples: &mut Vec<T>,
    cut: impl Fn(u64) -> T + Copy,
) {
    fn all<P: Packed, T: Copy + Default, const N: usize>(
        colors: &[P],
        samples: &mut Vec<T>,
        cut: impl Fn(u64) -> T + Copy,
    ) {
        let start = samples.len();
        samples.resize(start + N * colors.len(), T::default());
        let (pixels, _) = samples[start..].as_chunks_mut::<N>();
        colors.iter().zip(pixels).for_each(|(&color, to)| unpack(color, to, cut));
    }
    match channels {
        Channels::Grey => all::<P, T, 1>(colors, samples, cut),
        Channels::GreyAlpha => all::<P, T, 2>(colors, samples, cut),
        Channels::Rgb => all::<P, T, 3>(colors, samples, cut),
        Channels::Rgba => all::<P, T, 4>(colors, samples, cut),
    }
}

/// Reads the colours of a tile, with at most `most_work` work. Returns the samples and the work.
fn samples<P: Packed, T: Copy + Default>(
    decoder: &mut Decoder<'_>,
    shape: &Shape,
    cells: Option<&[bool]>,
    most_work: u64,
    cut: impl Fn(u64) -> T + Copy,
) -> Result<(Vec<T>, u64)> {
    let [width, height] = shape.size;
    let count = shape.channels.count();
    let mut samples = Vec::with_capacity(width * height * count);
    let mut row = |y: usize, colors: &[P]| {
        append(colors, shape.channels, &mut samples, cut);
        let Some(cells) = cells else { return };
        let from = y * width * count;
        let cells = &cells[y / CELL * width.div_ceil(CELL)..];
        for (cell, samples) in cells.iter().zip(samples[from..].chunks_mut(CELL * count)) {
            if !cell {
                samples.fill(T::default());
            }
        }
    };
    let mut state = State::<P>::new(shape);
    state.code(decoder, height, cells, &mut Unknown(&mut row), most_work)?;
    Ok((samples, state.work))
}

/// Reads the stream of a tile, with at most `most_work` work. Returns the tile and the work.
pub(crate) fn read(stream: &[u8], shape: &Shape, most_work: u64) -> Result<(ExactTile, u64)> {
    let mut decoder = Decoder::new(stream)?;
    let cells = mask::code(&mut decoder, shape.size, None)?;
    let covered = cells.as_deref();
    let (samples, work) = match shape.depth {
        Depth::Eight => {
            let (samples, work) = samples::<Eight, u8>(&mut decoder, shape, covered, most_work, |v| v as u8)?;
            (Samples::U8(samples), work)
        }
        Depth::Sixteen => {
            let (samples, work) = samples::<u64, u16>(&mut decoder, shape, covered, most_work, |v| v as u16)?;
            (Samples::U16(samples), work)
        }
    };
    decoder.finish()?;
    Ok((ExactTile { samples, cells }, work))
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
