//! Codes one tile: step classes, trees of blocks, and the blocks, row by row of superblocks (spec §11.4).

use super::block::{self, Block, Context};
use super::decisions::{Adaptive, Decisions};
use super::head::DetailHead;
use super::levels::{CELL, CELLS, CodedBlock, Level, SUPER, SUPERS, TileLevels};
use super::model::{BUCKETS, CLASSES, KINDS, Models, PLANES};
use super::scan::{SIZES, STRIDE};
use crate::bitstream::broken::Broken;
use crate::bitstream::coder::range::{Decoder, Encoder};
use crate::gaussian::Channels;

/// Density of a block in which every position has a level.
const FULL_DENSITY: u32 = 1024;
/// Size index of a superblock as a block.
pub(crate) const ROOT: usize = SIZES - 1;

/// Returns the kinds of planes that a layer codes, with the planes of each.
pub(crate) fn kinds(
    channels: Channels,
    has_alpha_plane: bool,
) -> impl Iterator<Item = (usize, std::ops::Range<usize>)> {
    let color = channels.count() >= 3;
    [(0, 0..1, true), (1, 1..3, color), (2, 3..4, has_alpha_plane)]
        .into_iter()
        .filter(|k| k.2)
        .map(|(kind, planes, _)| (kind, planes))
}

/// State of a tile while it is coded: the contexts of the blocks that follow.
#[derive(Debug)]
pub(crate) struct TileState {
    /// Width and height in cells, rounded up to whole superblocks.
    pub cells: [usize; 2],
    /// The size of the block that each cell lies in, by kind.
    pub sizes: [Vec<u8>; KINDS],
    /// Density of the block that contains each cell, by plane: levels · 1024 / positions.
    density: [Vec<u16>; PLANES],
    pub classes: Vec<u8>,
}

impl TileState {
    /// State of a tile of `width × height` pixels.
    pub(crate) fn new([width, height]: [usize; 2]) -> Self {
        let cells = [width, height].map(|side| side.div_ceil(SUPER) * (SUPER / CELL));
        TileState {
            cells,
            sizes: std::array::from_fn(|_| vec![0; CELLS * CELLS]),
            density: std::array::from_fn(|_| vec![0; CELLS * CELLS]),
            classes: vec![0; SUPERS * SUPERS],
        }
    }

    /// Returns the class of the predicted number of levels of a block, from the blocks above and to the left: the
    /// number of bits of four times that number.
    pub(crate) fn bucket(&self, plane: usize, [x, y]: [usize; 2], size: usize) -> usize {
        let (density, n) = (&self.density[plane], 1usize << size);
        let (mut sum, mut count) = (0u32, 0u32);
        if y > 0 {
            sum += density[(y - 1) * CELLS + x..][..n].iter().map(|&d| u32::from(d)).sum::<u32>();
            count += n as u32;
        }
        if x > 0 {
            sum += (0..n).map(|j| u32::from(density[(y + j) * CELLS + x - 1])).sum::<u32>();
            count += n as u32;
        }
        if count == 0 {
            return 2;
        }
        let quarters = (u64::from(sum) * (64 << (2 * size))).div_ceil(u64::from(FULL_DENSITY * count)) as u32;
        ((32 - quarters.leading_zeros()) as usize).min(BUCKETS - 1)
    }

    /// Returns a class of the density of the planes already coded at the position of a block. It is the context of
    /// whether the block has levels.
    pub(crate) fn others(&self, plane: usize, [x, y]: [usize; 2], size: usize) -> usize {
        if plane == 0 || plane == 3 {
            return 0;
        }
        let n = 1usize << size;
        let sum: u32 = (0..n).flat_map(|j| &self.density[0][(y + j) * CELLS + x..][..n]).map(|&d| u32::from(d)).sum();
        let luma = sum * 16 / FULL_DENSITY;
        match plane {
            1 => ((32 - luma.leading_zeros()) as usize).min(3),
            _ => usize::from(luma > 1) + 2 * usize::from(self.density[1][y * CELLS + x] > 0),
        }
    }

    /// Records that a block of a plane has `count` levels.
    pub(crate) fn fill(&mut self, plane: usize, [x, y]: [usize; 2], size: usize, count: u32) {
        let (n, density) = (1usize << size, (count * FULL_DENSITY / (16 << (2 * size))) as u16);
        for j in 0..n {
            self.density[plane][(y + j) * CELLS + x..][..n].fill(density);
        }
    }

    /// Records the size of a block.
    pub(crate) fn set_size(&mut self, kind: usize, [x, y]: [usize; 2], size: usize) {
        let n = 1usize << size;
        for j in 0..n {
            self.sizes[kind][(y + j) * CELLS + x..][..n].fill(size as u8);
        }
    }

    /// Returns the number of smaller blocks next to a block: the context of whether it is divided.
    pub(crate) fn smaller(&self, kind: usize, [x, y]: [usize; 2], size: usize) -> usize {
        let sizes = &self.sizes[kind];
        let is_smaller = |at: usize| usize::from(usize::from(sizes[at]) < size);
        let above = if y > 0 { is_smaller((y - 1) * CELLS + x) } else { 0 };
        above + if x > 0 { is_smaller(y * CELLS + x - 1) } else { 0 }
    }

    /// Returns the sum of the classes next to a superblock.
    fn classes_near(&self, [x, y]: [usize; 2]) -> usize {
        let left = (x > 0).then(|| self.classes[y * SUPERS + x - 1]);
        let above = (y > 0).then(|| self.classes[(y - 1) * SUPERS + x]);
        let (a, b) = (above.or(left).unwrap_or(1), left.or(above).unwrap_or(1));
        usize::from(a) + usize::from(b)
    }

    /// Returns the superblocks of the tile in coding order, in cells.
    pub(crate) fn superblocks(&self) -> impl Iterator<Item = [usize; 2]> + use<> {
        let step = SUPER / CELL;
        let [width, height] = self.cells;
        (0..height).step_by(step).flat_map(move |y| (0..width).step_by(step).map(move |x| [x, y]))
    }
}

/// The levels of a tile on one side of the coder: a writer's content supplies them, and a reader's receives them.
pub(crate) trait Content {
    /// Returns whether the block is divided; not called when reading.
    fn is_divided(&self, kind: usize, cell: [usize; 2], size: usize) -> bool;
    /// Supplies the levels of a block and returns their number.
    fn bring(&self, plane: usize, cell: [usize; 2], size: usize, block: &mut Block) -> u32;
    /// Receives the levels of a block that has any.
    fn take(&mut self, plane: usize, cell: [usize; 2], size: usize, block: &Block);
    /// Returns the step class of a superblock.
    fn class(&self, superblock: [usize; 2]) -> u8;
}

/// Coder of one tile.
pub(crate) struct TileCoder<'a, D> {
    pub decisions: &'a mut D,
    pub models: &'a mut Models,
    pub state: &'a mut TileState,
    pub head: &'a DetailHead,
    pub channels: Channels,
    pub block: &'a mut Block,
}

impl<D: Decisions> TileCoder<'_, D> {
    /// Codes all superblocks.
    pub(crate) fn tile(&mut self, content: &mut impl Content) -> Result<(), Broken> {
        self.state.superblocks().try_for_each(|at| self.superblock(at, content))
    }

    /// Codes one superblock.
    pub(crate) fn superblock(&mut self, at: [usize; 2], content: &mut impl Content) -> Result<(), Broken> {
        if self.head.classes > 1 {
            let place = at.map(|c| c / (SUPER / CELL));
            let near = self.state.classes_near(place);
            let class =
                code_class(self.decisions, &mut self.models.class[near], self.head.classes, content.class(place));
            self.state.classes[place[1] * SUPERS + place[0]] = class;
        }
        kinds(self.channels, self.head.alpha).try_for_each(|(kind, planes)| self.tree(kind, planes, at, ROOT, content))
    }

    fn tree(
        &mut self,
        kind: usize,
        planes: std::ops::Range<usize>,
        cell: [usize; 2],
        size: usize,
        content: &mut impl Content,
    ) -> Result<(), Broken> {
        let [least, most] = self.head.sizes(kind);
        let is_divided = size > most || {
            size > least && {
                let near = self.state.smaller(kind, cell, size);
                let given = content.is_divided(kind, cell, size);
                self.decisions.bit(&mut self.models.kinds[kind].divide[size][near], given)
            }
        };
        if is_divided {
            let half = 1 << (size - 1);
            for [i, j] in [[0, 0], [1, 0], [0, 1], [1, 1]] {
                self.tree(kind, planes.clone(), [cell[0] + i * half, cell[1] + j * half], size - 1, content)?;
            }
            return Ok(());
        }
        self.state.set_size(kind, cell, size);
        for plane in planes {
            self.leaf(kind, plane, cell, size, content)?;
        }
        Ok(())
    }

    fn leaf(
        &mut self,
        kind: usize,
        plane: usize,
        cell: [usize; 2],
        size: usize,
        content: &mut impl Content,
    ) -> Result<(), Broken> {
        let bucket = self.state.bucket(plane, cell, size);
        let others = self.state.others(plane, cell, size);
        let given = content.bring(plane, cell, size, self.block);
        let filled = &mut self.models.filled[plane][size][bucket][others];
        let mut count = 0;
        if self.decisions.bit(filled, given > 0) {
            let context = Context::new(size, bucket);
            count = block::code(self.decisions, &mut self.models.kinds[kind], self.block, context, given)?;
            content.take(plane, cell, size, self.block);
            self.block.clear();
        }
        self.state.fill(plane, cell, size, count);
        Ok(())
    }
}

/// Codes a step class in unary.
pub(crate) fn code_class<D: Decisions>(d: &mut D, models: &mut [Adaptive; CLASSES], classes: u8, given: u8) -> u8 {
    let mut class = 0;
    while class + 1 < classes && d.bit(&mut models[usize::from(class)], given > class) {
        class += 1;
    }
    class
}

/// Appends a block and its levels to a tile.
#[inline(always)]
pub(crate) fn push(tile: &mut TileLevels, plane: usize, cell: [usize; 2], size: usize, block: &Block) {
    tile.levels.extend(block.found.iter().map(|&at| {
        let at = usize::from(at);
        Level { u: (at % STRIDE) as u8, v: (at / STRIDE) as u8, value: block.levels[at] }
    }));
    let end = tile.levels.len() as u32;
    let cell = cell.map(|c| c as u8);
    tile.blocks.push(CodedBlock { cell, plane: plane as u8, size: size as u8, end });
}

/// Receives the levels of a tile that is read.
struct Reading {
    tile: TileLevels,
    /// Number of levels found, including those that are not kept.
    found: usize,
    /// Number of levels for which memory is reserved.
    most: usize,
    /// Whether there are more.
    is_more: bool,
}

impl Content for Reading {
    fn is_divided(&self, _kind: usize, _cell: [usize; 2], _size: usize) -> bool {
        false
    }

    #[inline(always)]
    fn bring(&self, _plane: usize, _cell: [usize; 2], _size: usize, _block: &mut Block) -> u32 {
        0
    }

    #[inline(always)]
    fn take(&mut self, plane: usize, cell: [usize; 2], size: usize, block: &Block) {
        self.found += block.found.len();
        if self.tile.levels.len() + block.found.len() > self.most {
            self.is_more = true;
            return;
        }
        push(&mut self.tile, plane, cell, size, block);
    }

    fn class(&self, _superblock: [usize; 2]) -> u8 {
        0
    }
}

/// Parameters of a tile that is read: the layer's head, its channels, and its size in pixels.
pub(crate) type Shape<'a> = (&'a DetailHead, Channels, [usize; 2]);

/// Bound on the levels of a tile, and the number of levels read.
#[derive(Debug)]
pub(crate) struct Count {
    /// Number of levels for which memory is reserved.
    pub most: usize,
    /// Number of levels read, including those of an invalid stream.
    pub read: usize,
}

impl Count {
    /// Returns a count that allows `most` levels.
    pub(crate) fn up_to(most: usize) -> Self {
        Count { most, read: 0 }
    }
}

/// Reads a tile with models in their initial state; returns `None` if it has more levels than `count` allows.
pub(crate) fn read_with<D: Decisions>(
    decisions: &mut D,
    models: &mut Models,
    (head, channels, size): Shape<'_>,
    count: &mut Count,
) -> Result<Option<TileLevels>, Broken> {
    let mut state = TileState::new(size);
    let mut block = Block::default();
    let mut reading = Reading { tile: TileLevels::default(), found: 0, most: count.most, is_more: false };
    let coded =
        TileCoder { decisions, models, state: &mut state, head, channels, block: &mut block }.tile(&mut reading);
    // An invalid block keeps the levels before the invalid one.
    count.read += reading.found + block.found.len();
    coded?;
    let Reading { mut tile, is_more, .. } = reading;
    if is_more {
        return Ok(None);
    }
    if tile.levels.is_empty() {
        // A tile without levels has no stream.
        return Err(Broken { field: "levels of a tile", value: 0 });
    }
    for (kind, _) in kinds(channels, head.alpha) {
        tile.sizes[kind] = std::mem::take(&mut state.sizes[kind]);
    }
    if head.classes > 1 {
        tile.classes = state.classes;
    }
    tile.levels.shrink_to_fit();
    tile.blocks.shrink_to_fit();
    Ok(Some(tile))
}

/// Reads the stream of a tile; returns `None` if it has more levels than `count` allows.
pub(crate) fn read(stream: &[u8], shape: Shape<'_>, count: &mut Count) -> Result<Option<TileLevels>, Broken> {
    let mut decoder = Decoder::new(stream)?;
    let tile = read_with(&mut decoder, &mut Models::start(), shape, count)?;
    decoder.finish()?;
    Ok(tile)
}

/// Writes the stream of a tile of this size in pixels, and returns the final state of its models.
pub(crate) fn write(
    content: &mut impl Content,
    head: &DetailHead,
    channels: Channels,
    size: [usize; 2],
) -> (Vec<u8>, Models) {
    let mut encoder = Encoder::default();
    let (mut models, mut block) = (Models::start(), Block::default());
    let mut state = TileState::new(size);
    TileCoder { decisions: &mut encoder, models: &mut models, state: &mut state, head, channels, block: &mut block }
        .tile(content)
        .expect("what is written is within the format");
    (encoder.finish(), models)
}
