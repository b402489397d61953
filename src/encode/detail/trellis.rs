//! Chooses the levels of a tile, and optionally its blocks, by rate–distortion optimization.

use super::coefficients::{self, AllSizes, Coefficients, Division};
use super::flat_cells::Ground;
use super::partition::blocks_among;
use super::residual::TileResidual;
use super::scaled::{CachedCoefficients, Factors, Values};
use super::settings::{LevelSearch, Setting, planes};
use crate::bitstream::coder::range::Encoder;
use crate::bitstream::detail::block::{self, Block, Context, MAX_LEVEL};
use crate::bitstream::detail::block_price::BlockPrice;
use crate::bitstream::detail::decisions;
use crate::bitstream::detail::levels::{CELL, CELLS, SUPER, SUPERS, TILE, TileLevels};
use crate::bitstream::detail::model::{KINDS, KindModels, Models, PLANES};
use crate::bitstream::detail::scan::{ROOM, STRIDE, at, order};
use crate::bitstream::detail::tile::{Content, ROOT, TileCoder, TileState, kinds, push};
use crate::constants::detail;

/// The chosen levels of a tile.
#[derive(Debug)]
pub(super) struct Chosen {
    pub stream: Vec<u8>,
    pub levels: Option<TileLevels>,
    /// Size of the block that each cell lies in, by kind.
    pub sizes: [Vec<u8>; KINDS],
}

/// Levels of a tile at their positions, and the blocks that contain them.
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
    /// Position in coding order.
    k: u16,
    /// Position in memory.
    at: u16,
    negative: bool,
    /// Magnitude, in steps.
    value: f32,
}

/// Source of the coefficients.
#[derive(Clone, Copy)]
enum Source<'a> {
    /// Blocks of all sizes, from which the chooser selects, the selection by the estimate, and the flat cells.
    All { all: &'a AllSizes, estimated: &'a [Vec<u8>; KINDS], ground: &'a Ground },
    /// Blocks that are already chosen.
    Chosen(&'a Coefficients),
}

struct Chooser<'a> {
    setting: &'a Setting,
    source: Source<'a>,
    state: TileState,
    models: Models,
    dense: Dense,
    block: Block,
    factors: Factors,
    values: Values,
    candidates: Vec<Candidate>,
    price: BlockPrice,
    /// Candidates for which the estimate is inconclusive.
    doubtful: Vec<Candidate>,
    /// Estimated bits saved by lowering the level at each position of a block.
    savings: Box<[f32; ROOM]>,
}

/// The levels of a block: their number, and their squared error in squared steps.
#[derive(Debug, Clone, Copy)]
struct Found {
    count: u32,
    distortion: f32,
}

/// The result of trying a block.
#[derive(Debug, Clone, Copy, Default)]
struct Tried {
    cost: f32,
    /// Number of levels in each of its planes.
    counts: [u32; 2],
    /// Whether no coefficient comes close to having a level.
    is_quiet: bool,
    /// Whether the block has too many candidates to be priced exactly.
    is_crowded: bool,
}

/// Chooses the blocks of a tile by the prices of their levels. The whole tile is lapped once for each block size.
/// Returns the size of the block that each cell lies in, by kind.
pub(super) fn priced_blocks(
    tile: &TileResidual,
    (classes, ground): (&[u8], &Ground),
    setting: &Setting,
) -> [Vec<u8>; KINDS] {
    let all = AllSizes::new(tile, setting.head);
    let estimated = blocks_among(&all, tile, (classes, ground), setting);
    let setting = Setting { level_search: LevelSearch::Quick, ..*setting };
    let sizes = std::array::from_fn(|_| vec![0; CELLS * CELLS]);
    let source = Source::All { all: &all, estimated: &estimated, ground };
    Chooser::new(tile, classes, &setting, source, sizes).run().sizes
}

/// Chooses the levels of a tile in blocks of the given `sizes`. The coefficients come from `kept`, which is filled on
/// first use.
pub(super) fn choose(
    tile: &TileResidual,
    classes: &[u8],
    setting: &Setting,
    sizes: &[Vec<u8>; KINDS],
    kept: Option<&CachedCoefficients>,
) -> Chosen {
    let division = |plane: usize| Division::Chosen(&sizes[[0, 1, 1, 2][plane]]);
    let own = CachedCoefficients::new();
    let coefficients = kept
        .unwrap_or(&own)
        .get_or_init(|| std::array::from_fn(|plane| coefficients::plane(tile, plane, division(plane))));
    Chooser::new(tile, classes, setting, Source::Chosen(coefficients), sizes.clone()).run()
}

impl<'a> Chooser<'a> {
    fn new(
        tile: &TileResidual,
        classes: &[u8],
        setting: &'a Setting,
        source: Source<'a>,
        sizes: [Vec<u8>; KINDS],
    ) -> Self {
        let dense = Dense {
            sizes,
            planes: std::array::from_fn(|_| vec![0; TILE * TILE]),
            classes: classes.to_vec(),
            written: TileLevels::default(),
        };
        Chooser {
            setting,
            source,
            state: TileState::new(tile.size),
            models: Models::start(),
            dense,
            block: Block::default(),
            factors: Factors::new(setting.head, setting.gain),
            values: Values::default(),
            candidates: Vec::new(),
            price: BlockPrice::default(),
            doubtful: Vec::new(),
            savings: Box::new([0.0; ROOM]),
        }
    }

    fn run(mut self) -> Chosen {
        let mut encoder = Encoder::default();
        for at in self.state.superblocks() {
            for (kind, _) in kinds(self.setting.channels, self.setting.head.alpha) {
                match self.source {
                    Source::All { .. } => {
                        self.priced_tree(kind, at, ROOT);
                    }
                    Source::Chosen(_) => self.tree(kind, at, ROOT),
                }
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

    /// Chooses the levels of the blocks in a square.
    fn tree(&mut self, kind: usize, cell: [usize; 2], size: usize) {
        let [x, y] = cell;
        if self.dense.is_divided(kind, cell, size) {
            let half = 1 << (size - 1);
            for [i, j] in [[0, 0], [1, 0], [0, 1], [1, 1]] {
                self.tree(kind, [x + i * half, y + j * half], size - 1);
            }
            return;
        }
        self.state.set_size(kind, cell, size);
        for plane in planes(kind) {
            let count = self.levels(kind, plane, cell, size).counts[0];
            self.state.fill(plane, cell, size, count);
        }
    }

    /// Chooses the blocks of a square and their levels. Returns their cost.
    fn priced_tree(&mut self, kind: usize, cell: [usize; 2], size: usize) -> f32 {
        let [least, most] = self.setting.head.sizes(kind);
        if size > most {
            return self.priced_quarters(kind, cell, size);
        }
        if size == least {
            return self.priced_leaf(kind, cell, size).cost;
        }
        let near = self.state.smaller(kind, cell, size);
        let model = &self.models.kinds[kind].divide[size][near];
        let [whole, divided] = [false, true].map(|bit| self.setting.lambda * decisions::price(model, bit));
        let tried = self.priced_leaf(kind, cell, size);
        let one = tried.cost + whole;
        if tried.is_quiet {
            return one;
        }
        if tried.is_crowded {
            return match self.is_divided_by_estimate(kind, cell, size) {
                true => self.priced_quarters(kind, cell, size) + divided,
                false => one,
            };
        }
        let saved = self.saved(kind, cell, size);
        let four = self.priced_quarters(kind, cell, size) + divided;
        if four < one {
            return four;
        }
        self.set_size(kind, cell, size);
        self.restore(kind, cell, size, &saved);
        for (plane, count) in planes(kind).zip(tried.counts) {
            self.state.fill(plane, cell, size, count);
        }
        one
    }

    fn priced_quarters(&mut self, kind: usize, [x, y]: [usize; 2], size: usize) -> f32 {
        let half = 1 << (size - 1);
        let quarters = [[0, 0], [1, 0], [0, 1], [1, 1]];
        quarters.map(|[i, j]| self.priced_tree(kind, [x + i * half, y + j * half], size - 1)).iter().sum()
    }

    fn is_divided_by_estimate(&self, kind: usize, [x, y]: [usize; 2], size: usize) -> bool {
        let Source::All { estimated, .. } = self.source else { return false };
        usize::from(estimated[kind][y * CELLS + x]) < size
    }

    fn priced_leaf(&mut self, kind: usize, cell: [usize; 2], size: usize) -> Tried {
        self.set_size(kind, cell, size);
        let mut all = Tried { is_quiet: true, ..Tried::default() };
        for (i, plane) in planes(kind).enumerate() {
            self.clear(plane, cell, size);
            let Tried { cost, counts: [count, _], is_quiet, is_crowded } = self.levels(kind, plane, cell, size);
            self.state.fill(plane, cell, size, count);
            all.cost += cost;
            all.counts[i] = count;
            all.is_quiet &= is_quiet;
            all.is_crowded |= is_crowded;
        }
        if let Source::All { ground, .. } = self.source {
            all.cost *= ground.factor(kind, cell, size, self.setting.mixed.price);
        }
        all
    }

    fn set_size(&mut self, kind: usize, cell: [usize; 2], size: usize) {
        self.state.set_size(kind, cell, size);
        let n = 1usize << size;
        for j in 0..n {
            self.dense.sizes[kind][(cell[1] + j) * CELLS + cell[0]..][..n].fill(size as u8);
        }
    }

    /// Returns the levels of a square, plane by plane.
    fn saved(&self, kind: usize, [x, y]: [usize; 2], size: usize) -> Vec<i16> {
        let n = CELL << size;
        let rows =
            |plane: usize| (0..n).flat_map(move |v| &self.dense.planes[plane][(y * CELL + v) * TILE + x * CELL..][..n]);
        planes(kind).flat_map(rows).copied().collect()
    }

    fn restore(&mut self, kind: usize, [x, y]: [usize; 2], size: usize, saved: &[i16]) {
        let n = CELL << size;
        for (plane, saved) in planes(kind).zip(saved.chunks_exact(n * n)) {
            for (v, row) in saved.chunks_exact(n).enumerate() {
                self.dense.planes[plane][(y * CELL + v) * TILE + x * CELL..][..n].copy_from_slice(row);
            }
        }
    }

    /// Clears the levels of a square in one plane.
    fn clear(&mut self, plane: usize, [x, y]: [usize; 2], size: usize) {
        let n = CELL << size;
        for v in 0..n {
            self.dense.planes[plane][(y * CELL + v) * TILE + x * CELL..][..n].fill(0);
        }
    }

    /// Chooses the levels of one block of a plane.
    fn levels(&mut self, kind: usize, plane: usize, cell: [usize; 2], size: usize) -> Tried {
        let [x, y] = cell;
        let Setting { head, lambda, level_search, .. } = *self.setting;
        let class = self.dense.class(cell.map(|c| c / (SUPER / CELL)));
        let coefficients: &[f32] = match self.source {
            Source::All { all, .. } => all.plane(size, plane),
            Source::Chosen(chosen) => &chosen[plane],
        };
        self.values.take(coefficients, cell, size, self.factors.of(class, plane, size));
        self.candidates.clear();
        let (candidates, order) = (&mut self.candidates, order(size));
        self.values.above(detail::DEAD_ZONE, |u, v, value| {
            let at = at(u, v);
            candidates.push(Candidate { k: order[at], at: at as u16, negative: value < 0.0, value: value.abs() });
        });
        let bucket = self.state.bucket(plane, cell, size);
        let others = self.state.others(plane, cell, size);
        let filled = self.models.filled[plane][size][bucket][others];
        let nothing = self.values.energy + lambda * decisions::price(&filled, false);
        let empty =
            Tried { cost: nothing, is_quiet: self.values.largest < detail::MIN_SPLIT_MAGNITUDE, ..Tried::default() };
        if self.candidates.is_empty() {
            return empty;
        }
        let is_priced = matches!(self.source, Source::All { .. });
        let is_crowded =
            is_priced && size > head.sizes(kind)[0] && self.candidates.len() > detail::MAX_PRICED_CANDIDATES[size];
        self.candidates.sort_unstable_by_key(|c| std::cmp::Reverse(c.k));
        let mut trial = Trial {
            models: &mut self.models.kinds[kind],
            block: &mut self.block,
            price: &mut self.price,
            context: Context::new(size, bucket),
            lambda,
            bias: head.biases.map(|bias| f32::from(bias) / 32.0),
        };
        let mut found = trial.rounded(&self.candidates, self.values.energy);
        let is_many = self.candidates.len() > detail::MAX_EXACT_CANDIDATES;
        let doubtful = &mut self.doubtful;
        if is_crowded {
            // The price is not compared with that of other blocks.
            trial.start(&found);
        } else if is_many
            && level_search == LevelSearch::Thorough
            && trial.lower(&self.candidates, &mut found, &mut self.savings, doubtful)
        {
            trial.start(&found);
            trial.try_each(doubtful, &mut found, |_, _| false);
        } else {
            for _ in 0..if level_search == LevelSearch::Quick { 1 } else { 2 } {
                trial.start(&found);
                if !trial.try_each(&self.candidates, &mut found, |value, level| is_sure(value, level, level_search)) {
                    break;
                }
            }
        }
        let cost = found.distortion + lambda * (decisions::price(&filled, true) + trial.price.bits());
        let is_worth_it = cost < nothing;
        for c in &self.candidates {
            let at = usize::from(c.at);
            let level = std::mem::take(&mut self.block.levels[at]);
            if is_worth_it {
                self.dense.planes[plane][(y * CELL + at / STRIDE) * TILE + x * CELL + at % STRIDE] = level;
            }
        }
        match is_worth_it {
            true => Tried { cost, counts: [found.count, 0], is_quiet: false, is_crowded },
            false => Tried { is_quiet: false, is_crowded, ..empty },
        }
    }
}

/// Returns whether a value is so far from the rounding boundary that its level is kept without a trial.
fn is_sure(value: f32, level: u32, level_search: LevelSearch) -> bool {
    match (level, level_search) {
        (0, _) => true,
        (1, LevelSearch::Quick) => value > detail::QUICK_SURE_ONE,
        (1, _) => value > detail::SURE_ONE,
        (_, LevelSearch::Quick) => value - level as f32 > detail::QUICK_SURE_EXCESS,
        (_, _) => value - level as f32 > detail::SURE_EXCESS,
    }
}

/// Returns the level of a value without regard to its rate.
fn rounded(value: f32) -> u32 {
    ((value + 1.0 - detail::DEAD_ZONE) as u32).clamp(1, MAX_LEVEL)
}

fn signed(level: u32, negative: bool) -> i16 {
    if negative { -(level as i16) } else { level as i16 }
}

/// A block of which different levels are tried.
struct Trial<'a> {
    models: &'a mut KindModels,
    block: &'a mut Block,
    price: &'a mut BlockPrice,
    context: Context,
    lambda: f32,
    /// Offset of reconstructed values towards 0, in steps: for level 1, and for higher levels.
    bias: [f32; 2],
}

impl Trial<'_> {
    /// Prices the block with its current levels.
    fn start(&mut self, found: &Found) {
        self.price.start(self.models, self.block, self.context, found.count);
    }

    /// Returns the squared error of a level, in squared steps.
    fn error(&self, value: f32, level: u32) -> f32 {
        let stands_for = if level == 0 { 0.0 } else { level as f32 - self.bias[usize::from(level > 1)] };
        (value - stands_for) * (value - stands_for)
    }

    fn level(&self, candidate: &Candidate) -> u32 {
        self.block.levels[usize::from(candidate.at)].unsigned_abs().into()
    }

    fn set(&mut self, candidate: &Candidate, level: u32) {
        self.block.levels[usize::from(candidate.at)] = signed(level, candidate.negative);
    }

    /// Rounds all candidates. `energy` is the squared error without levels.
    fn rounded(&mut self, candidates: &[Candidate], energy: f32) -> Found {
        let mut distortion = energy;
        for c in candidates {
            let level = rounded(c.value);
            self.set(c, level);
            distortion += self.error(c.value, level) - self.error(c.value, 0);
        }
        Found { count: candidates.len() as u32, distortion }
    }

    /// Lowers each level by one if an estimate for that level alone clearly shows that this saves more than it costs.
    /// Writes the inconclusive candidates to `doubtful`. Returns false and changes nothing if no level would remain.
    fn lower(
        &mut self,
        candidates: &[Candidate],
        found: &mut Found,
        savings: &mut [f32; ROOM],
        doubtful: &mut Vec<Candidate>,
    ) -> bool {
        block::savings(self.models, self.block, self.context, found.count, savings);
        doubtful.clear();
        let before = *found;
        for c in candidates {
            let level = self.level(c);
            if is_sure(c.value, level, LevelSearch::Quick) {
                continue;
            }
            let more = self.error(c.value, level - 1) - self.error(c.value, level);
            let gain = savings[usize::from(c.at)] + detail::SAVED_CONTEXT_BITS - more / self.lambda;
            if gain > detail::CONCLUSIVE_BITS {
                self.set(c, level - 1);
                found.count -= u32::from(level == 1);
                found.distortion += more;
            } else if gain > -detail::CONCLUSIVE_BITS {
                doubtful.push(*c);
            }
        }
        if found.count == 0 {
            for c in candidates {
                self.set(c, rounded(c.value));
            }
            *found = before;
            return false;
        }
        true
    }

    /// Tries to lower each level by one, from the last position to the first, and keeps the changes that reduce the
    /// cost. It skips levels for which `is_sure` returns true. Returns whether any level changed. The block must have
    /// been priced with its current levels.
    fn try_each(&mut self, candidates: &[Candidate], found: &mut Found, is_sure: impl Fn(f32, u32) -> bool) -> bool {
        let mut is_changed = false;
        for c in candidates {
            let (level, k) = (self.level(c), usize::from(c.k));
            let count = found.count - u32::from(level == 1);
            if level == 0 || count == 0 || is_sure(c.value, level) {
                continue;
            }
            let more = self.error(c.value, level - 1) - self.error(c.value, level);
            let saved = self.price.saved(self.models, self.block, k);
            if more < self.lambda * saved {
                self.price.lower(self.models, self.block, k, saved);
                (*found, is_changed) = (Found { count, distortion: found.distortion + more }, true);
            }
        }
        is_changed
    }
}
