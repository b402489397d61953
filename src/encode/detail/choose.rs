//! Levels and blocks of a tile: what costs least, distortion and bits together.

use super::coefficients::{self, AllSizes, Division};
use super::residual::TileResidual;
use crate::bitstream::coder::range::Encoder;
use crate::bitstream::detail::block::{self, Block, Context, MAX_LEVEL};
use crate::bitstream::detail::decisions::{Decisions, Price};
use crate::bitstream::detail::head::DetailHead;
use crate::bitstream::detail::levels::{CELL, CELLS, SUPER, SUPERS, TILE, TileLevels};
use crate::bitstream::detail::model::{KINDS, Models, PLANES};
use crate::bitstream::detail::scan::{SIZES, STRIDE, at, scan};
use crate::bitstream::detail::tile::{Content, ROOT, TileCoder, TileState, kinds, push};
use crate::detail::steps::PlaneSteps;
use crate::gaussian::Channels;

/// Settings with which a layer is coded.
#[derive(Debug, Clone, Copy)]
pub(super) struct Setting {
    pub head: DetailHead,
    pub channels: Channels,
    /// Squared error that a bit has to save, in squared steps.
    pub lambda: f32,
    pub care: Care,
}

/// How carefully levels are chosen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Care {
    /// All that are not worth their bits go at once.
    Quick,
    /// Each is tried by itself.
    Thorough,
}

/// Below this, in steps, a coefficient has no level to begin with.
const DEAD: f32 = 0.58;
/// Levels from which on large blocks are not worth trying, by size.
const CROWDED: [u32; SIZES] = [u32::MAX, u32::MAX, 40, 48];

/// A tile whose levels have been chosen.
#[derive(Debug)]
pub(super) struct Chosen {
    pub stream: Vec<u8>,
    pub levels: Option<TileLevels>,
    /// Sizes of the blocks that cells lie in, by kind.
    pub sizes: [Vec<u8>; KINDS],
}

/// Levels of a tile at their places, and the blocks that they are in.
struct Dense {
    sizes: [Vec<u8>; KINDS],
    planes: [Vec<i16>; PLANES],
    classes: Vec<u8>,
    written: TileLevels,
}

impl Content for Dense {
    fn is_divided(&self, kind: usize, [x, y]: [usize; 2], size: usize) -> bool {
        usize::from(self.sizes[kind][y * CELLS + x]) < size
    }

    fn bring(&self, plane: usize, [x, y]: [usize; 2], size: usize, block: &mut Block) -> u32 {
        let (n, mut count) = (CELL << size, 0);
        for v in 0..n {
            let from = &self.planes[plane][(y * CELL + v) * TILE + x * CELL..][..n];
            block.levels[at(0, v)..at(0, v) + n].copy_from_slice(from);
            count += from.iter().filter(|&&level| level != 0).count() as u32;
        }
        count
    }

    fn take(&mut self, plane: usize, cell: [usize; 2], size: usize, block: &Block) {
        push(&mut self.written, plane, cell, size, block);
    }

    fn class(&self, [x, y]: [usize; 2]) -> u8 {
        self.classes.get(y * SUPERS + x).copied().unwrap_or(0)
    }
}

/// A coefficient that may have a level.
#[derive(Debug, Clone, Copy)]
struct Candidate {
    at: u16,
    negative: bool,
    /// Magnitude in steps.
    value: f32,
}

/// Where coefficients come from.
enum Source<'a> {
    /// Blocks of all sizes, to choose from.
    All(&'a AllSizes),
    /// The blocks are chosen.
    Chosen(coefficients::Coefficients),
}

struct Chooser<'a> {
    setting: &'a Setting,
    source: Source<'a>,
    state: TileState,
    models: Models,
    dense: Dense,
    block: Block,
    candidates: Vec<Candidate>,
    fixed: Option<&'a [Vec<u8>; KINDS]>,
}

/// A block that was tried: what it costs, and the levels of its planes.
#[derive(Debug, Clone, Copy, Default)]
struct Tried {
    cost: f32,
    counts: [u32; 2],
    /// Whether no coefficient came near a level.
    is_quiet: bool,
}

/// Chooses the levels of a tile in blocks that are given, or, with `all`, in blocks that are chosen as well: these are then what
/// is worth it where the whole tile is lapped for blocks of each size, and the levels are chosen anew where it is lapped for them.
pub(super) fn choose(
    tile: &TileResidual,
    classes: &[u8],
    setting: &Setting,
    all: Option<&AllSizes>,
    sizes: Option<&[Vec<u8>; KINDS]>,
) -> Chosen {
    let quick = Setting { care: Care::Quick, ..*setting };
    let trees;
    let sizes = match (sizes, all) {
        (Some(sizes), _) => sizes,
        (None, Some(all)) => {
            trees = Chooser::new(tile, classes, &quick, Source::All(all), None).run().sizes;
            &trees
        }
        (None, None) => unreachable!("either sizes or what to choose them from"),
    };
    let division = |plane: usize| Division::Chosen(&sizes[[0, 1, 1, 2][plane]]);
    let chosen = std::array::from_fn(|plane| coefficients::plane(tile, plane, division(plane)));
    Chooser::new(tile, classes, setting, Source::Chosen(chosen), Some(sizes)).run()
}

impl<'a> Chooser<'a> {
    fn new(
        tile: &TileResidual,
        classes: &[u8],
        setting: &'a Setting,
        source: Source<'a>,
        fixed: Option<&'a [Vec<u8>; KINDS]>,
    ) -> Self {
        let dense = Dense {
            sizes: std::array::from_fn(|_| vec![0; CELLS * CELLS]),
            planes: std::array::from_fn(|_| vec![0; TILE * TILE]),
            classes: classes.to_vec(),
            written: TileLevels::default(),
        };
        let (state, models) = (TileState::new(tile.size), Models::start());
        Chooser { setting, source, state, models, dense, block: Block::default(), candidates: Vec::new(), fixed }
    }

    fn run(mut self) -> Chosen {
        let mut encoder = Encoder::default();
        for at in self.state.superblocks() {
            for (kind, _) in kinds(self.setting.channels, self.setting.head.alpha) {
                self.tree(kind, at, ROOT);
            }
            let (models, state, block) = (&mut self.models, &mut self.state, &mut self.block);
            let Setting { head, channels, .. } = self.setting;
            TileCoder { decisions: &mut encoder, models, state, head, channels: *channels, block }
                .superblock(at, &mut self.dense)
                .expect("what is chosen is within the format");
        }
        let Dense { sizes, mut written, classes, .. } = self.dense;
        if written.levels.is_empty() {
            return Chosen { stream: Vec::new(), levels: None, sizes };
        }
        for (kind, _) in kinds(self.setting.channels, self.setting.head.alpha) {
            written.sizes[kind].clone_from(&sizes[kind]);
        }
        if self.setting.head.classes > 1 {
            written.classes = classes;
        }
        Chosen { stream: encoder.finish(), levels: Some(written), sizes }
    }

    fn set_size(&mut self, kind: usize, cell: [usize; 2], size: usize) {
        self.state.set_size(kind, cell, size);
        let n = 1usize << size;
        for j in 0..n {
            self.dense.sizes[kind][(cell[1] + j) * CELLS + cell[0]..][..n].fill(size as u8);
        }
    }

    /// Chooses the blocks of a square and their levels; returns what they cost.
    fn tree(&mut self, kind: usize, cell: [usize; 2], size: usize) -> f32 {
        let [least, most] = self.setting.head.sizes(kind);
        if let Some(fixed) = self.fixed {
            let is_divided = usize::from(fixed[kind][cell[1] * CELLS + cell[0]]) < size;
            return if is_divided { self.quarters(kind, cell, size) } else { self.leaf(kind, cell, size).cost };
        }
        if size > most {
            return self.quarters(kind, cell, size);
        }
        if size == least {
            return self.leaf(kind, cell, size).cost;
        }
        let near = self.state.smaller(kind, cell, size);
        let model = self.models.kinds[kind].divide[size][near];
        let price = |bit: bool| {
            let mut price = Price::default();
            price.bit(&mut model.clone(), bit);
            self.setting.lambda * price.bits
        };
        let (whole, divided) = (price(false), price(true));
        let tried = self.leaf(kind, cell, size);
        let one = tried.cost + whole;
        if tried.is_quiet {
            return one;
        }
        let kept = self.saved(kind, cell, size);
        let four = self.quarters(kind, cell, size) + divided;
        if one > four {
            return four;
        }
        self.set_size(kind, cell, size);
        self.restore(kind, cell, size, &kept);
        for (plane, count) in planes(kind).zip(tried.counts) {
            self.state.fill(plane, cell, size, count);
        }
        one
    }

    fn quarters(&mut self, kind: usize, [x, y]: [usize; 2], size: usize) -> f32 {
        let half = 1 << (size - 1);
        [[0, 0], [1, 0], [0, 1], [1, 1]]
            .map(|[i, j]| self.tree(kind, [x + i * half, y + j * half], size - 1))
            .iter()
            .sum()
    }

    /// The levels of a square.
    fn saved(&self, kind: usize, [x, y]: [usize; 2], size: usize) -> Vec<i16> {
        let n = CELL << size;
        planes(kind)
            .flat_map(|plane| {
                (0..n).flat_map(move |v| &self.dense.planes[plane][(y * CELL + v) * TILE + x * CELL..][..n])
            })
            .copied()
            .collect()
    }

    fn restore(&mut self, kind: usize, [x, y]: [usize; 2], size: usize, kept: &[i16]) {
        let n = CELL << size;
        let mut rows = kept.chunks_exact(n);
        for plane in planes(kind) {
            for v in 0..n {
                let row = rows.next().expect("as many as were saved");
                self.dense.planes[plane][(y * CELL + v) * TILE + x * CELL..][..n].copy_from_slice(row);
            }
        }
    }

    fn leaf(&mut self, kind: usize, cell: [usize; 2], size: usize) -> Tried {
        self.set_size(kind, cell, size);
        let mut all = Tried { is_quiet: true, ..Tried::default() };
        for (i, plane) in planes(kind).enumerate() {
            let Tried { cost, counts: [count, _], is_quiet } = self.levels(kind, plane, cell, size);
            self.state.fill(plane, cell, size, count);
            all.cost += cost;
            all.counts[i] = count;
            all.is_quiet &= is_quiet;
        }
        all
    }

    /// Chooses the levels of one block.
    fn levels(&mut self, kind: usize, plane: usize, cell: [usize; 2], size: usize) -> Tried {
        let [x, y] = cell;
        let n = CELL << size;
        let Setting { head, lambda, care, .. } = *self.setting;
        let place = y / (SUPER / CELL) * SUPERS + x / (SUPER / CELL);
        let class = if head.classes > 1 { self.dense.classes[place] } else { 0 };
        let steps = PlaneSteps::new(&head, plane, class);
        let coefficients: &[f32] = match &self.source {
            Source::All(all) => all.plane(size, plane),
            Source::Chosen(chosen) => &chosen[plane],
        };
        let is_void = coefficients.is_empty();
        let bias = head.biases.map(|bias| f32::from(bias) / 32.0);
        let mut nothing = 0f32;
        let mut largest = 0f32;
        self.candidates.clear();
        for v in 0..n {
            if is_void {
                break;
            }
            let row = &coefficients[(y * CELL + v) * TILE + x * CELL..][..n];
            for (u, &c) in row.iter().enumerate() {
                // Steps are in 1/64 code value, coefficients in 1/16.
                let value = c * 4.0 / steps.step(size, u, v) as f32;
                let magnitude = value.abs();
                nothing += magnitude * magnitude;
                largest = largest.max(magnitude);
                if magnitude > DEAD {
                    self.candidates.push(Candidate { at: at(u, v) as u16, negative: value < 0.0, value: magnitude });
                }
            }
        }
        for v in 0..n {
            self.dense.planes[plane][(y * CELL + v) * TILE + x * CELL..][..n].fill(0);
        }
        let bucket = self.state.bucket(plane, cell, size);
        let others = self.state.others(plane, cell, size);
        let mut filled = self.models.filled[plane][size][bucket][others];
        let mut price = Price::default();
        price.bit(&mut filled, false);
        let empty = Tried { cost: nothing + lambda * price.bits, counts: [0; 2], is_quiet: largest < QUIET };
        if self.candidates.is_empty() {
            return empty;
        }
        if self.fixed.is_none() && size > head.sizes(kind)[0] && self.candidates.len() as u32 > CROWDED[size] {
            return Tried { cost: f32::INFINITY, counts: [0; 2], is_quiet: false };
        }
        let order = order(size);
        self.candidates.sort_unstable_by_key(|c| std::cmp::Reverse(order[usize::from(c.at)]));
        let error = |value: f32, level: u32| {
            let stands_for = if level == 0 { 0.0 } else { level as f32 - bias[usize::from(level > 1)] };
            (value - stands_for) * (value - stands_for)
        };
        let mut distortion = nothing;
        for c in &self.candidates {
            let level = ((c.value + 1.0 - DEAD) as u32).clamp(1, MAX_LEVEL);
            self.block.levels[usize::from(c.at)] = signed(level, c.negative);
            distortion += error(c.value, level) - error(c.value, 0);
        }
        let mut count = self.candidates.len() as u32;
        let mut trial = Trial {
            models: &mut self.models,
            block: &mut self.block,
            kind,
            context: Context::new(size, bucket),
            filled,
        };
        let mut cost = distortion + lambda * trial.price(count);
        let passes = if care == Care::Thorough { 2 } else { 1 };
        for _ in 0..passes {
            let mut is_changed = false;
            for c in &self.candidates {
                let at = usize::from(c.at);
                let level = u32::from(trial.block.levels[at].unsigned_abs());
                // What is far from the border of rounding stays.
                let is_sure = match (level, care) {
                    (0, _) => true,
                    (1, Care::Thorough) => c.value > 1.5,
                    (1, Care::Quick) => c.value > 1.1,
                    (_, Care::Thorough) => c.value - level as f32 > 0.1,
                    (_, Care::Quick) => c.value - level as f32 > -0.2,
                };
                if is_sure {
                    continue;
                }
                trial.block.levels[at] = signed(level - 1, c.negative);
                let without = count - u32::from(level == 1);
                let rest = distortion + error(c.value, level - 1) - error(c.value, level);
                let trial_cost = if without == 0 { f32::INFINITY } else { rest + lambda * trial.price(without) };
                if trial_cost < cost {
                    (cost, distortion, count, is_changed) = (trial_cost, rest, without, true);
                } else {
                    trial.block.levels[at] = signed(level, c.negative);
                }
            }
            if !is_changed {
                break;
            }
        }
        if empty.cost <= cost {
            for c in &self.candidates {
                self.block.levels[usize::from(c.at)] = 0;
            }
            return Tried { is_quiet: false, ..empty };
        }
        for c in &self.candidates {
            let at = usize::from(c.at);
            let (u, v) = (at % STRIDE, at / STRIDE);
            self.dense.planes[plane][(y * CELL + v) * TILE + x * CELL + u] = std::mem::take(&mut self.block.levels[at]);
        }
        Tried { cost, counts: [count, 0], is_quiet: false }
    }
}

/// Below this, in steps, coefficients of a block say that smaller ones have nothing either.
const QUIET: f32 = 0.45;

/// The planes of a kind.
fn planes(kind: usize) -> std::ops::Range<usize> {
    [0..1, 1..3, 3..4][kind].clone()
}

fn signed(level: u32, negative: bool) -> i16 {
    if negative { -(level as i16) } else { level as i16 }
}

/// A block whose price is asked for again and again.
struct Trial<'a> {
    models: &'a mut Models,
    block: &'a mut Block,
    kind: usize,
    context: Context,
    filled: crate::bitstream::detail::decisions::Adaptive,
}

impl Trial<'_> {
    /// Bits of the block as it is, with `count` levels.
    fn price(&mut self, count: u32) -> f32 {
        let mut price = Price::default();
        price.bit(&mut self.filled.clone(), true);
        block::code(&mut price, &mut self.models.kinds[self.kind], self.block, self.context, count)
            .expect("levels within the format");
        price.bits
    }
}

/// The place of each level of a block in the order of coding.
fn order(size: usize) -> &'static [u16] {
    static ORDERS: std::sync::OnceLock<[Vec<u16>; SIZES]> = std::sync::OnceLock::new();
    &ORDERS.get_or_init(|| {
        std::array::from_fn(|size| {
            let mut order = vec![0; crate::bitstream::detail::scan::ROOM];
            scan(size).iter().enumerate().for_each(|(k, place)| order[usize::from(place.at)] = k as u16);
            order
        })
    })[size]
}
