//! Shape and colour of the primitives of a group, each coded knowing its neighbours (spec §8.4, §8.5).

use std::sync::LazyLock;

use super::kd::Place;
use super::model::{Field, SIGNED_NODES};
use super::neighbours::{Buckets, COUNT, LANES};
use super::range::Coder;
use super::rules::{Broken, Rules};
use super::splats::{PackedGaussian, Steps};
use crate::gaussian::Channels;

/// Levels of the angle's tree that adapt.
const ANGLE_NODES: usize = 16;

/// Quantities that are averaged over the neighbours: two scales and four colours.
const QUANTITIES: usize = 6;

/// Fraction bits of predictions.
const FINE: i64 = 16;

/// First opinions of the nodes of each field, in 1/256.
const PRIOR_MAJOR: [u8; 36] = [
    19, 128, 214, 164, 75, 10, 11, 64, 128, 128, 128, 128, 128, 128, 128, 128, 128, 128, 128, 128, 128, 128, 128, 123,
    128, 128, 100, 116, 111, 42, 84, 70, 29, 45, 69, 64,
];
const PRIOR_ASPECT: [u8; 36] = [
    19, 128, 212, 163, 64, 9, 12, 128, 128, 128, 128, 128, 128, 128, 128, 128, 128, 128, 128, 128, 128, 128, 128, 122,
    128, 128, 101, 118, 115, 33, 75, 84, 12, 36, 128, 128,
];
const PRIOR_LUMA: [u8; 36] = [
    11, 128, 232, 202, 137, 49, 5, 25, 128, 128, 128, 128, 128, 128, 128, 128, 128, 128, 128, 128, 128, 128, 128, 128,
    128, 128, 122, 125, 119, 83, 108, 101, 33, 79, 79, 25,
];
const PRIOR_CO: [u8; 36] = [
    105, 128, 95, 68, 30, 21, 44, 128, 128, 128, 128, 128, 128, 128, 128, 128, 128, 128, 128, 128, 128, 128, 128, 78,
    128, 128, 61, 91, 94, 49, 81, 100, 67, 91, 192, 128,
];
const PRIOR_CG: [u8; 36] = [
    149, 128, 55, 34, 15, 47, 64, 128, 128, 128, 128, 128, 128, 128, 128, 128, 128, 128, 128, 128, 128, 128, 128, 62,
    128, 128, 31, 74, 57, 35, 53, 128, 64, 64, 128, 128,
];

/// First opinions, in 1/256 and by the neighbours' accord, that the angle lies in the half, quarter and eighth next to
/// the neighbours' direction.
const PRIOR_HALF: [u8; 6] = [128, 134, 170, 182, 196, 210];
const PRIOR_QUARTER: [u8; 6] = [128, 140, 150, 170, 188, 216];
const PRIOR_EIGHTH: [u8; 6] = [128, 135, 145, 155, 175, 200];

/// Colours as the coder sees them.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Palette<'a> {
    pub channels: Channels,
    pub background: [i16; 4],
    pub book: Option<&'a [[i16; 4]]>,
}

/// Sums over the primitives around, weighted by distance.
#[derive(Debug, Clone, Copy)]
struct Around {
    weight: i64,
    values: [i64; QUANTITIES],
    /// How far the values were from what was expected.
    errors: [i64; QUANTITIES],
    /// Direction of the doubled angle, as long as the primitive is elongated.
    axis: [i64; 2],
    elongation: i64,
}

impl From<[i32; LANES]> for Around {
    fn from(sums: [i32; LANES]) -> Self {
        let sums = sums.map(i64::from);
        Around {
            weight: sums[COUNT],
            values: std::array::from_fn(|k| sums[k]),
            errors: std::array::from_fn(|k| sums[QUANTITIES + k]),
            axis: [sums[12], sums[13]],
            elongation: sums[14],
        }
    }
}

/// What a colour is expected from.
#[derive(Debug, Clone, Copy)]
struct Outlook {
    means: [i64; QUANTITIES],
    /// How far the neighbours' average is from the mean.
    dev: [i64; QUANTITIES],
    around: Around,
    /// `0..=15`: how large the primitive is for the primitives' spacing, in octaves of its area.
    size: usize,
}

/// A running mean that starts at a guess.
#[derive(Debug, Clone, Copy)]
struct Mean {
    sum: i64,
    count: i64,
}

impl Mean {
    fn new(guess: i64, count: i64) -> Self {
        Mean { sum: guess * count, count }
    }

    fn get(self) -> i64 {
        self.sum.div_euclid(self.count)
    }

    fn add(&mut self, value: i64) {
        self.sum += value;
        self.count += 1;
    }
}

/// Running regression of one quantity on another: how much of `x` shows in `y`, in 1/256.
#[derive(Debug, Clone, Copy)]
struct Slope {
    xy: i64,
    xx: i64,
}

impl Slope {
    fn new(guess: i64, weight: i64) -> Self {
        Slope { xy: guess * weight, xx: weight * 256 }
    }

    fn of(self, x: i64) -> i64 {
        (self.xy * 256 / self.xx).clamp(-1024, 1024) * x >> 8
    }

    fn add(&mut self, x: i64, y: i64) {
        self.xy += x * y;
        self.xx += x * x;
        // No real picture comes near: this keeps `xy·256` within 64 bits. A term is below 2⁴⁸ and adds to `xx` no less
        // than its root does to `xy`, so that `xx` stays above 0.
        if self.xx.max(self.xy.abs()) >> 50 != 0 {
            (self.xx, self.xy) = (self.xx >> 1, self.xy >> 1);
        }
    }
}

/// The models of one group.
#[derive(Debug)]
pub(crate) struct Attributes {
    major: Field<2>,
    aspect: Field<2>,
    angle: Field<2>,
    colors: Vec<Field<2>>,
    index: Field<1>,
    means: [Mean; QUANTITIES],
    /// How much a colour follows the average of its neighbours.
    follow: [Slope; 4],
    /// How much a colour's surprise follows the first and the second channel's.
    cross: [[Slope; 2]; 4],
}

/// What all primitives of a group share.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Scene<'a> {
    pub rules: &'a Rules,
    pub palette: Palette<'a>,
    pub steps: Steps,
    /// Exponent of the finest position step.
    pub finest: i32,
    /// `16·log₂` of the primitives' spacing, pixels.
    pub spacing: i64,
}

impl Scene<'_> {
    /// `32·δ`: 32nds of an octave between neighbouring scales.
    fn delta(&self) -> i64 {
        i64::from(self.steps.scale) + 4
    }

    /// Scale index, with fraction, of `log` sixteenths of an octave above a pixel.
    fn scale_of(&self, log: i64) -> i64 {
        (log + 32) * 2 * FINE / self.delta()
    }
}

/// `16·log₂` of the spacing, in cells, of `count` primitives on `size` cells.
pub(crate) fn spacing(size: [u32; 2], count: u32) -> i64 {
    let area = u128::from(size[0]) * u128::from(size[1]) * 256 / u128::from(count.max(1));
    (log16(area.max(1)) - 16 * 8).div_euclid(2)
}

/// `16·log₂`, linear between powers of two.
fn log16(value: u128) -> i64 {
    let log = value.ilog2();
    let rest = if log >= 4 { value >> (log - 4) } else { value << (4 - log) };
    16 * i64::from(log) + (rest & 15) as i64
}

fn class(value: i64, last: i64) -> usize {
    (value.clamp(-last, last) + last) as usize
}

/// 0 for 0, then the number of bits.
fn log_class(value: u64, last: u32) -> usize {
    (64 - value.leading_zeros()).min(last) as usize
}

/// The angle's field: the better the neighbours agree, the higher the first opinion of the middle.
fn angle_field() -> Field<2> {
    let mut field = Field::new(ANGLE_NODES, [8 * 6, 16 * 6], 250);
    for (k, contexts) in [8 * 6, 16 * 6].into_iter().enumerate() {
        for context in 0..contexts {
            for (node, chances) in [(2, PRIOR_HALF), (5, PRIOR_QUARTER), (11, PRIOR_EIGHTH)] {
                let one = u32::from(chances[context % 6]) << 8;
                let count = [6, 2][k];
                field.set(k, context, node, one, count);
                // The node on the other side of the middle.
                field.set(k, context, 3 * (node + 1).next_power_of_two() / 2 - 1 - node, 65536 - one, count);
            }
        }
    }
    field
}

/// The 64 directions `2π·k/64`, 256 long.
static DIRECTIONS: LazyLock<[[i32; 2]; 64]> = LazyLock::new(|| {
    std::array::from_fn(|k| {
        let turn = std::f64::consts::TAU * k as f64 / 64.0;
        [turn.cos(), turn.sin()].map(|c| (256.0 * c + 0.5).floor() as i32)
    })
});

/// The nearest of the 64 directions to a sum of vectors of 256 times `total` length at most, and how well they agree: 0
/// for no opinion, in which case the direction is 0, to 5.
fn consensus(axis: [i64; 2], total: i64) -> (u32, usize) {
    let [x, y] = axis.map(|a| a >> 8);
    let square = x * x + y * y;
    let fifths = (1..5).filter(|k| 25 * square >= k * k * total * total).count();
    if total == 0 || fifths == 0 {
        return (0, usize::from(total != 0));
    }
    // Turned into the first quadrant.
    let (quarter, x, y) = match (x > 0, y >= 0) {
        (true, true) => (0, x, y),
        (false, _) if y > 0 => (1, y, -x),
        (false, _) if x < 0 => (2, -x, -y),
        _ => (3, -y, x),
    };
    let steps = (0..16).filter(|&j| {
        let tangent = (std::f64::consts::TAU * (f64::from(j) + 0.5) / 64.0).tan();
        y * 4096 >= x * (4096.0 * tangent + 0.5).floor() as i64
    });
    ((quarter * 16 + steps.count() as u32) % 64, fifths + 1)
}

impl Attributes {
    pub fn new(scene: &Scene<'_>) -> Self {
        let palette = &scene.palette;
        let n = SIGNED_NODES;
        let fields = if palette.book.is_some() { 0 } else { palette.channels.count() };
        let octave = 32 * FINE / scene.delta();
        let spacing = scene.scale_of(scene.spacing);
        let color = palette.background.map(|b| Mean::new(i64::from(b) * FINE, 4));
        Attributes {
            major: Field::new(n, [16 * 9, 8], 250).prior(&PRIOR_MAJOR, [6, 6]),
            aspect: Field::new(n, [40, 9 * 9], 250).prior(&PRIOR_ASPECT, [3, 3]),
            angle: angle_field(),
            colors: (0..fields)
                .map(|k| {
                    Field::new(n, [128, 64], 250).prior([&PRIOR_LUMA, &PRIOR_CO, &PRIOR_CG, &PRIOR_LUMA][k], [3, 3])
                })
                .collect(),
            index: Field::new(palette.book.map_or(0, |b| b.len().next_power_of_two().max(2)), [1], 250),
            means: [
                Mean::new(spacing - octave, 4),
                Mean::new(spacing - 3 * octave, 4),
                color[0],
                color[1],
                color[2],
                color[3],
            ],
            follow: [Slope::new(256, 16 * 256); 4],
            cross: [[Slope::new(0, 16 * 256); 2]; 4],
        }
    }

    /// Codes the primitive at `place`; a reader's `p` is ignored, and the one that comes back obeys the rules.
    pub fn code<C: Coder>(
        &mut self,
        coder: &mut C,
        scene: &Scene<'_>,
        buckets: &mut Buckets,
        place: Place,
        p: &PackedGaussian,
    ) -> Result<PackedGaussian, Broken> {
        let log = place.log.0;
        let around = Around::from(buckets.around(&place));
        let means = self.means.map(Mean::get);
        // Deviation of the neighbours' average from the mean, shrunk where few are near.
        let dev: [i64; QUANTITIES] =
            std::array::from_fn(|k| (around.values[k] * FINE - means[k] * around.weight) / (around.weight + 40));
        let mut errors = [0i32; QUANTITIES];

        // The step's octave bounds the major scale; the mean says where it lies therein.
        let exponent = i64::from(scene.finest) + i64::from(log);
        let octave = scene.scale_of(16 * exponent + 4 * i64::from(scene.steps.position));
        let expected = ((octave + 8) >> 4).max(0);
        let near = class((means[0] - octave) * scene.delta() / (8 * FINE), 4);
        let level = (exponent + 8).clamp(0, 15) as usize;
        let activity = around.errors[0] * 4 / (around.weight + 40);
        let contexts = [level * 9 + near, log_class(activity as u64, 7)];
        let off = i64::from(self.major.signed(coder, &contexts, i32::from(p.major) - expected as i32));
        let major = u8::try_from(expected + off).map_err(|_| Broken { field: "major scale", value: off as u64 })?;
        errors[0] = off as i32;
        if scene.rules.seat(major) != log {
            return Err(Broken { field: "major scale", value: major.into() });
        }
        coder.account("major scale");

        let surprise = i64::from(major) * FINE - means[0];
        let guess = means[1] + (9 * surprise + 7 * dev[1] - dev[0]) / 16;
        let expected = (i64::from(major) - ((guess + 8) >> 4)).max(0);
        let contexts = [expected.min(39) as usize, class(off / 2, 4) * 9 + class(dev[1] >> 5, 4)];
        let off = self.aspect.signed(coder, &contexts, i32::from(p.major) - i32::from(p.minor) - expected as i32);
        let minor = i64::from(major) - expected - i64::from(off);
        let minor = u8::try_from(minor).map_err(|_| Broken { field: "minor scale", value: minor as u64 })?;
        errors[1] = off;
        coder.account("minor scale");

        let n = scene.rules.lattice.angles(major, minor);
        let angle = self.angle(coder, n, p.angle, &around);
        scene.rules.shape(major, minor, angle)?;
        coder.account("angle");

        // The rest of the position.
        let exponents = scene.rules.lattice.exponents(major, minor, angle);
        let [lx, ly] = scene.rules.in_cells(exponents);
        let rest = |coder: &mut C, corner: u32, v: u32, l: u32| {
            let count = log - l;
            corner >> l | coder.raw(count, v & ((1u32 << count) - 1))
        };
        let x = rest(coder, place.corner[0], p.x, lx);
        let y = rest(coder, place.corner[1], p.y, ly);
        scene.rules.position([x, y], exponents)?;
        coder.account("position refinement");

        let color = match scene.palette.book {
            Some(book) => {
                let bits = usize::BITS - (book.len() - 1).leading_zeros();
                let wanted = book.binary_search(&p.color).unwrap_or(0);
                let index = self.index.tree(coder, &[0], 0, bits, wanted as u32);
                coder.account("colour index");
                *book.get(index as usize).ok_or(Broken { field: "codebook index", value: index.into() })?
            }
            None => {
                let spacing = scene.scale_of(scene.spacing) >> 3;
                let size = (i64::from(major) + i64::from(minor) - spacing) * scene.delta() / 32 + 8;
                let outlook = Outlook { means, dev, around, size: size.clamp(0, 15) as usize };
                self.color(coder, &outlook, p.color, &mut errors)?
            }
        };
        let p = PackedGaussian { x, y, major, minor, angle, color };
        let c = color.map(i32::from);
        let values = [major.into(), minor.into(), c[0], c[1], c[2], c[3]];
        for (mean, v) in self.means.iter_mut().zip(values) {
            mean.add(i64::from(v) * FINE);
        }
        let octaves = i32::from(major - minor) * (scene.delta() as i32);
        let elongation = 16 * octaves / (octaves + 32);
        let direction = (u32::from(angle) * 64 + u32::from(n) / 2) / u32::from(n) % 64;
        let axis = DIRECTIONS[direction as usize].map(|c| c * elongation);
        let mut lanes = [0; LANES];
        lanes[..QUANTITIES].copy_from_slice(&values);
        lanes[QUANTITIES..2 * QUANTITIES].copy_from_slice(&errors.map(i32::abs));
        lanes[12..14].copy_from_slice(&axis);
        lanes[14] = elongation;
        lanes[COUNT] = 1;
        buckets.add(&place, &lanes);
        Ok(p)
    }

    fn angle<C: Coder>(&mut self, coder: &mut C, n: u16, angle: u16, around: &Around) -> u16 {
        if n <= 1 {
            return 0;
        }
        let n = u32::from(n);
        let (direction, accord) = consensus(around.axis, around.elongation);
        let guess = (direction * n + 32) / 64 % n;
        let size = (n.ilog2() as usize).min(7);
        let contexts = [size * 6 + accord, (direction / 4) as usize * 6 + accord];
        let wanted = (u32::from(angle) + 2 * n - guess + n / 2) % n;
        let (mut low, mut high, mut node) = (0, n, 1usize);
        while high - low > 1 && node < ANGLE_NODES {
            let middle = low + (high - low) / 2;
            if self.angle.bit(coder, &contexts, node, u32::from(wanted >= middle)) != 0 {
                (low, node) = (middle, 2 * node + 1);
            } else {
                (high, node) = (middle, 2 * node);
            }
        }
        low += coder.uniform(high - low, wanted.wrapping_sub(low));
        ((low + guess + n - n / 2) % n) as u16
    }

    fn color<C: Coder>(
        &mut self,
        coder: &mut C,
        &Outlook { means, dev, around, size }: &Outlook,
        color: [i16; 4],
        errors: &mut [i32; QUANTITIES],
    ) -> Result<[i16; 4], Broken> {
        let mut out = [0i16; 4];
        let mut surprises = [0i64; 4];
        let mut before = 0;
        for k in 0..self.colors.len() {
            let follow = self.follow[k].of(dev[2 + k]);
            let mut guess = means[2 + k] + follow;
            for (slope, &s) in self.cross[k].iter().zip(&surprises[..k]) {
                guess += slope.of(s);
            }
            let guess = guess.clamp(i64::from(i16::MIN) * FINE, i64::from(i16::MAX) * FINE);
            let expected = ((guess + 8) >> 4) as i32;
            let activity = log_class((around.errors[2 + k] * 4 / (around.weight + 20)) as u64, 7);
            let phase = ((guess + 8) & 15) as usize / 4;
            let contexts = match k {
                0 => [size * 8 + activity, phase * 8 + activity],
                _ => [before * 8 + activity, phase * 16 + size],
            };
            let off = self.colors[k].signed(coder, &contexts, i32::from(color[k]) - expected);
            errors[2 + k] = off;
            before = log_class(off.unsigned_abs().into(), 7);
            let value = expected + off;
            out[k] = i16::try_from(value).map_err(|_| Broken { field: "colour", value: value as u64 })?;
            let actual = i64::from(value) * FINE;
            self.follow[k].add(dev[2 + k], actual - means[2 + k]);
            let left = actual - means[2 + k] - follow;
            let mut rest = left;
            for (slope, &s) in self.cross[k].iter_mut().zip(&surprises[..k]) {
                slope.add(s, rest);
                rest -= slope.of(s);
            }
            surprises[k] = left;
            coder.account(["colour 0", "colour 1", "colour 2", "colour 3"][k]);
        }
        Ok(out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Further from a rounding boundary than any f64 library is from the true value.
    fn clear(v: f64) -> bool {
        (v - v.floor() - 0.5).abs() > 1e-9
    }

    #[test]
    fn directions_and_tangents_round_alike_everywhere() {
        for k in 0..64 {
            let turn = std::f64::consts::TAU * f64::from(k) / 64.0;
            assert!(clear(256.0 * turn.cos()) && clear(256.0 * turn.sin()));
        }
        for j in 0..16 {
            assert!(clear(4096.0 * (std::f64::consts::TAU * (f64::from(j) + 0.5) / 64.0).tan()));
        }
    }

    #[test]
    fn slopes_stay_in_range_under_the_largest_terms() {
        for (x, y) in [(1 << 23, 1 << 24), (1, 1 << 24), (-(1 << 23), 1 << 24)] {
            let mut slope = Slope::new(0, 16 * 256);
            for _ in 0..1 << 20 {
                slope.add(x, y);
                assert!(slope.xx > 0 && slope.xy.abs() < 1 << 51);
            }
            slope.of(x);
        }
    }
}
