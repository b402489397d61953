//! A tile's levels to what it adds to the samples of its pixels (spec §11.5).

use super::lap;
use super::steps::PlaneSteps;
use super::transform::{self, Coefficient};
use crate::bitstream::detail::head::DetailHead;
use crate::bitstream::detail::levels::{CELL, CELLS, SUPER, SUPERS, TILE, TileLevels};
use crate::bitstream::detail::model::{CLASSES, PLANES};
use crate::gaussian::Channels;
use crate::simd::{self, Simd, Task};

/// Additions are counted in this part of an 8-bit code value.
pub(crate) const UNIT: f32 = 1.0 / 32.0;

/// What a tile adds, channel by channel, 1/32 code value; rows are [`TILE`] apart.
#[derive(Debug, Clone, Default)]
pub(crate) struct TilePlanes {
    pub channels: Vec<Vec<i16>>,
}

/// Planes to work in, to be reused.
#[derive(Debug, Default)]
pub(crate) struct Scratch {
    planes: [Vec<i32>; PLANES],
    filled: Vec<bool>,
    coefficients: Vec<Coefficient>,
}

struct Reconstruct<'a> {
    tile: &'a TileLevels,
    head: &'a DetailHead,
    channels: Channels,
    /// Width and height, pixels.
    size: [usize; 2],
    scratch: &'a mut Scratch,
    out: &'a mut TilePlanes,
}

/// Makes the planes of a tile of so many pixels.
pub(crate) fn reconstruct(
    tile: &TileLevels,
    (head, channels, size): (&DetailHead, Channels, [usize; 2]),
    scratch: &mut Scratch,
    out: &mut TilePlanes,
) {
    simd::dispatch(Reconstruct { tile, head, channels, size, scratch, out });
}

impl Task for Reconstruct<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, _: S) {
        let Reconstruct { tile, head, channels, size, scratch, out } = self;
        let cells = size.map(|side| side.div_ceil(SUPER) * (SUPER / CELL));
        let has = [true, channels.count() >= 3, channels.count() >= 3, head.alpha];
        let mut start = 0;
        let mut is_empty = [true; PLANES];
        for (plane, values) in scratch.planes.iter_mut().enumerate() {
            if has[plane] {
                values.clear();
                values.resize(TILE * TILE, 0);
            }
        }
        let steps: [[PlaneSteps; CLASSES]; PLANES] =
            std::array::from_fn(|plane| std::array::from_fn(|class| PlaneSteps::new(head, plane, class as u8)));
        for block in &tile.blocks {
            let levels = &tile.levels[start..block.end as usize];
            start = block.end as usize;
            let [x, y] = block.cell.map(usize::from);
            let place = y / (SUPER / CELL) * SUPERS + x / (SUPER / CELL);
            let class = tile.classes.get(place).map_or(0, |&class| usize::from(class) % CLASSES);
            let (plane, side) = (usize::from(block.plane) % PLANES, usize::from(block.size));
            let steps = &steps[plane][class];
            scratch.coefficients.clear();
            for level in levels {
                let value = steps.value(side, level.u.into(), level.v.into(), level.value);
                scratch.coefficients.push(Coefficient { u: level.u, v: level.v, value });
            }
            let values = &mut scratch.planes[plane][y * CELL * TILE + x * CELL..];
            transform::inverse(side, &scratch.coefficients, values, TILE);
            is_empty[plane] = false;
        }
        for plane in 0..PLANES {
            if !has[plane] || is_empty[plane] {
                continue;
            }
            scratch.filled.clear();
            scratch.filled.resize(CELLS * CELLS, false);
            for block in tile.blocks.iter().filter(|block| usize::from(block.plane) == plane) {
                let ([x, y], n) = (block.cell.map(usize::from), 1usize << block.size);
                for row in y..y + n {
                    scratch.filled[row * CELLS + x..][..n].fill(true);
                }
            }
            let kind = [0, 1, 1, 2][plane];
            lap::invert(&mut scratch.planes[plane], cells, &tile.sizes[kind], &scratch.filled);
        }
        out.channels.resize_with(channels.count(), Vec::new);
        out.channels.iter_mut().for_each(|channel| channel.resize(TILE * TILE, 0));
        let [y, orange, green, alpha] = &scratch.planes;
        let rows = size[1] * TILE;
        match &mut out.channels[..] {
            [r, g, b, rest @ ..] => {
                for i in 0..rows {
                    let (y, o, n) = (y[i].wrapping_mul(2), orange[i], green[i]);
                    let low = y.wrapping_sub(n);
                    r[i] = narrow(low.wrapping_add(o));
                    g[i] = narrow(y.wrapping_add(n));
                    b[i] = narrow(low.wrapping_sub(o));
                }
                rest.iter_mut().for_each(|a| double(a, alpha, rows, head.alpha));
            }
            [grey, rest @ ..] => {
                double(grey, y, rows, true);
                rest.iter_mut().for_each(|a| double(a, alpha, rows, head.alpha));
            }
            [] => {}
        }
    }
}

#[inline(always)]
fn narrow(v: i32) -> i16 {
    v.clamp(i16::MIN.into(), i16::MAX.into()) as i16
}

#[inline(always)]
fn double(out: &mut [i16], plane: &[i32], rows: usize, is_there: bool) {
    if !is_there {
        out.fill(0);
        return;
    }
    for (out, &v) in out[..rows].iter_mut().zip(plane) {
        *out = narrow(v.wrapping_mul(2));
    }
}
