//! Shape and colour of the primitives of a group, each coded knowing its neighbours (spec §8.4, §8.5).

use super::model::{Field, SIGNED_NODES};
use super::neighbours::Buckets;
use super::range::Coder;
use super::rules::{Broken, Rules};
use super::splats::PackedGaussian;
use crate::gaussian::Channels;

/// Levels of the angle's tree that adapt.
const ANGLE_NODES: usize = 16;

/// Colours as the coder sees them.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Palette<'a> {
    pub channels: Channels,
    pub background: [i16; 4],
    pub book: Option<&'a [[i16; 4]]>,
}

/// A coded primitive as a neighbour.
#[derive(Debug, Clone, Copy)]
struct Seen {
    /// Centre in half steps of the finest lattice.
    at: [i64; 2],
    p: PackedGaussian,
    angles: u16,
}

/// The models of one group.
#[derive(Debug)]
pub(crate) struct Attributes {
    major: Field<3>,
    aspect: Field<3>,
    angle: Field<3>,
    colors: Vec<Field<3>>,
    index: Field<1>,
    seen: Vec<Seen>,
    /// Sum and number of the majors' distances from their expectation.
    drift: [i32; 2],
    sums: [i64; 4],
}

impl Attributes {
    pub fn new(count: usize, palette: &Palette<'_>) -> Self {
        let n = SIGNED_NODES;
        let fields = if palette.book.is_some() { 0 } else { palette.channels.count() };
        Attributes {
            major: Field::new(n, [16, 19, 16 * 8], 250),
            aspect: Field::new(n, [17, 24, 16 * 9], 250),
            angle: Field::new(ANGLE_NODES, [8 * 3, 17 * 3, 8 * 12], 250),
            colors: (0..fields).map(|_| Field::new(n, [1, 16, 64], 250)).collect(),
            index: Field::new(palette.book.map_or(0, |b| b.len().next_power_of_two().max(2)), [1], 250),
            seen: Vec::with_capacity(count),
            drift: [0; 2],
            sums: [0; 4],
        }
    }
}

/// What all primitives of a group share.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Scene<'a> {
    pub rules: &'a Rules,
    pub palette: Palette<'a>,
    /// Position steps reach down to `coarsest − range`.
    pub range: u32,
    /// Expected major scale index.
    pub typical: i32,
}

/// The major scale index to expect for `count` primitives on a picture: in proportion to their spacing.
pub(crate) fn typical_major(size: [u32; 2], count: u32, scale_step: u8) -> i32 {
    let area = u64::from(size[0]) * u64::from(size[1]) * 256 / u64::from(count.max(1));
    let area = area.max(16);
    let log = area.ilog2();
    // 16·log₂ of the area in pixels², linear between powers of two.
    let log16 = 16 * (i64::from(log) - 8) + (area >> (log - 4) & 15) as i64;
    ((log16 + 56) / (i64::from(scale_step) + 4)).clamp(0, 255) as i32
}

fn class(value: i32, last: i32) -> usize {
    (value.clamp(-last, last) + last) as usize
}

fn log_class(value: u64, last: u32) -> usize {
    (64 - value.leading_zeros()).min(last) as usize
}

impl Attributes {
    /// Codes the primitive in `cell`; a reader's `p` is ignored, and the one that comes back obeys the rules.
    pub fn code<C: Coder>(
        &mut self,
        coder: &mut C,
        scene: &Scene<'_>,
        buckets: &mut Buckets,
        cell: [u32; 2],
        p: &PackedGaussian,
    ) -> Result<PackedGaussian, Broken> {
        let center = cell.map(|c| (2 * i64::from(c) + 1) << scene.range);
        let mut near = [(i64::MAX, usize::MAX); 2];
        let [total, places] = buckets.around(cell, |j| {
            let d = [0, 1].map(|k| self.seen[j].at[k] - center[k]);
            let d = d[0] * d[0] + d[1] * d[1];
            if d < near[0].0 {
                near = [(d, j), near[0]];
            } else if d < near[1].0 {
                near[1] = (d, j);
            }
        });
        let first = self.seen.get(near[0].1).copied();
        let second = self.seen.get(near[1].1).copied();
        let density = log_class(u64::from(total) * 9 * 9 / (u64::from(places) * 9), 15);

        // Shape.
        let expected = scene.typical + self.drift[0] / (self.drift[1] + 3);
        let beside = first.map_or(18, |s| class((i32::from(s.p.major) - expected) / 2, 8));
        let beside_minor = first.map_or(7, |s| class((i32::from(s.p.minor) - expected + 4) / 4, 3));
        let contexts = [density, beside, density * 8 + beside_minor];
        let major = expected + self.major.signed(coder, &contexts, i32::from(p.major) - expected);
        let major = u8::try_from(major).map_err(|_| Broken { field: "major scale", value: major as u64 })?;
        self.drift[0] += i32::from(major) - scene.typical;
        self.drift[1] += 1;
        coder.account("major scale");

        let off = i32::from(major) - expected;
        let aspect_beside = first.map_or(23, |s| (s.p.major - s.p.minor).min(22).into());
        let contexts = [class(off / 2, 8), aspect_beside, density * 9 + class(off / 4, 4)];
        let aspect = self.aspect.unsigned(coder, &contexts, u32::from(p.major.saturating_sub(p.minor)));
        let minor = u8::try_from(i64::from(major) - i64::from(aspect))
            .map_err(|_| Broken { field: "minor scale", value: aspect.into() })?;
        coder.account("minor scale");

        let n = scene.rules.lattice.angles(major, minor);
        let angle = self.angle(coder, n, p.angle, [first, second]);
        scene.rules.shape(major, minor, angle)?;
        coder.account("angle");

        // The rest of the position.
        let [fx, fy] = scene.rules.refinement(major, minor, angle);
        let low = |v: u32, bits: u32| v & ((1u32 << bits) - 1);
        let x = cell[0] << fx | coder.raw(fx, low(p.x, fx));
        let y = cell[1] << fy | coder.raw(fy, low(p.y, fy));
        coder.account("position refinement");

        let at = [(x, fx), (y, fy)].map(|(v, f)| (2 * i64::from(v) + 1) << (scene.range - f));
        let color = self.color(coder, scene, at, [first, second], p.color, (major, minor))?;
        let p = PackedGaussian { x, y, major, minor, angle, color };
        scene.rules.primitive(&p)?;
        self.seen.push(Seen { at, p, angles: n });
        buckets.add(cell);
        Ok(p)
    }

    fn angle<C: Coder>(&mut self, coder: &mut C, n: u16, angle: u16, near: [Option<Seen>; 2]) -> u16 {
        if n <= 1 {
            return 0;
        }
        let n = u32::from(n);
        let (mut strength, mut guess, mut apart) = (0, 0, 16);
        for s in near.into_iter().flatten() {
            if s.angles > 4 {
                strength = if s.angles > 12 { 2 } else { 1 };
                guess = (2 * u32::from(s.p.angle) * n / u32::from(s.angles)).div_ceil(2) % n;
                apart = u32::from(s.p.angle) * 16 / u32::from(s.angles);
                break;
            }
        }
        let size = (n.ilog2() as usize).min(7);
        let contexts = [size * 3 + strength, apart as usize * 3 + strength, size * 12 + strength];
        let wanted = (u32::from(angle) + 2 * n - guess + n / 2) % n;
        let (mut low, mut high, mut node) = (0, n, 1usize);
        while high - low > 1 {
            let middle = low + (high - low) / 2;
            let bit = u32::from(wanted >= middle);
            let bit = if node < ANGLE_NODES {
                self.angle.bit(coder, &contexts, node, bit)
            } else {
                coder.bit(65536 * (high - middle) / (high - low), bit)
            };
            if bit != 0 {
                low = middle
            } else {
                high = middle
            }
            node = node << 1 | bit as usize;
        }
        ((low + guess + n - n / 2) % n) as u16
    }

    fn color<C: Coder>(
        &mut self,
        coder: &mut C,
        scene: &Scene<'_>,
        _at: [i64; 2],
        near: [Option<Seen>; 2],
        color: [i16; 4],
        (major, minor): (u8, u8),
    ) -> Result<[i16; 4], Broken> {
        if let Some(book) = scene.palette.book {
            let bits = usize::BITS - (book.len() - 1).leading_zeros();
            let wanted = book.binary_search(&color).unwrap_or(0);
            let index = self.index.tree(coder, &[0], 0, bits, wanted as u32);
            coder.account("colour index");
            return book.get(index as usize).copied().ok_or(Broken { field: "codebook index", value: index.into() });
        }
        let mut out = [0i16; 4];
        let mut before = 0;
        let seen = self.seen.len() as i64;
        for k in 0..self.colors.len() {
            let background = i64::from(scene.palette.background[k]);
            let mean = (self.sums[k] + 4 * background) / (seen + 4);
            let (guess, contrast) = match near {
                [Some(a), Some(b)] => {
                    let (a, b) = (i64::from(a.p.color[k]), i64::from(b.p.color[k]));
                    ((a + b + mean).div_euclid(3), (a - b).unsigned_abs())
                }
                [Some(a), None] => ((i64::from(a.p.color[k]) + mean).div_euclid(2), 0),
                _ => (mean, 0),
            };
            let contrast = log_class(contrast, 7);
            let size = ((usize::from(major) + usize::from(minor)) / 8).min(15);
            let contexts = [0, contrast * 2, (before * 8 + contrast).min(63)];
            let _ = size;
            let guess = guess.clamp(i64::from(i16::MIN), i64::from(i16::MAX)) as i32;
            let off = self.colors[k].signed(coder, &contexts, i32::from(color[k]) - guess);
            before = log_class(off.unsigned_abs().into(), 7);
            let value = guess + off;
            out[k] = i16::try_from(value).map_err(|_| Broken { field: "colour", value: value as u64 })?;
            self.sums[k] += i64::from(value);
            coder.account(["colour 0", "colour 1", "colour 2", "colour 3"][k]);
        }
        Ok(out)
    }
}
