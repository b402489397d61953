//! Codes shape and colour of the Gaussians of a group, in contexts of their neighbours (spec §8.5, §8.6).

use std::sync::LazyLock;

use super::model::Field;
use super::neighbours::{Buckets, COUNT, LANES};
use super::range::{Coder, Cumulative, Prediction};
use super::spread::{Bounded, FINE, Gains, MEAN, Near, Open, Shifts, log16};
use crate::angle::sin_cos;
use crate::bitstream::broken::Broken;
use crate::bitstream::region::Square;
use crate::bitstream::rules::Rules;
use crate::bitstream::splats::{PackedGaussian, Steps};
use crate::gaussian::Channels;

/// Number of quantities that are averaged over the neighbours: two scales and four colours.
const AVERAGED: usize = 6;

// The values from here to `ANGLE_SHARE` were learnt on the odd-numbered Kodak pictures by a study before the first
// release, which is not in the repository. They are part of the format (spec §8.6) and can only change with its
// version.

/// Weight of the prior against the neighbours: for their average, and for their prediction errors.
const PRIOR_WEIGHT: i64 = 40;
const DOUBT_OF_ERRORS: i64 = 512;

/// Initial prediction errors of the four channels, 64ths.
const INITIAL_ERRORS: [i64; 4] = [384, 192, 128, 384];

/// Spread of the major scale within the range that its square allows.
const MAJOR_SPREAD: i32 = 165;

/// Initial spread of the aspect.
const ASPECT_SPREAD: i32 = 152;

/// Spread of the angle over half a turn, by the agreement of the neighbours' axes.
const ANGLE_SPREADS: [i32; 6] = [112, 112, 86, 79, 72, 63];

/// Part of the probability of scales, and of angles, that is distributed equally over all values, 65536ths.
const UNIFORM_SHARE: u32 = 1024;
const ANGLE_SHARE: u32 = 16384;

/// Growth of the predicted minor scale with the major scale, sixteenths.
pub(in crate::bitstream) const MINOR_GROWTH: i64 = 9;

/// Classes of predicted aspects.
const ASPECTS: usize = 40;

/// Colours in the form that the coder uses.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Palette<'a> {
    pub channels: Channels,
    pub background: [i16; 4],
    pub book: Option<&'a [[i16; 4]]>,
}

/// Sums over the neighbouring Gaussians, weighted by distance.
#[derive(Debug, Clone, Copy)]
struct NeighbourSums([i32; LANES]);

impl NeighbourSums {
    #[inline]
    fn weight(&self) -> i32 {
        self.0[COUNT]
    }

    #[inline]
    fn value(&self, k: usize) -> i64 {
        self.0[k].into()
    }

    /// Returns the prediction error of a colour, quarters.
    #[inline]
    fn error(&self, k: usize) -> i64 {
        self.0[ERROR_LANES + k].into()
    }

    /// Returns the direction of the doubled angle; its length grows with the elongation of the Gaussians.
    #[inline]
    fn axis(&self) -> [i64; 2] {
        [self.0[AXIS_LANES].into(), self.0[AXIS_LANES + 1].into()]
    }

    #[inline]
    fn elongation(&self) -> i64 {
        self.0[ELONGATION_LANE].into()
    }

    /// Returns the deviation of the neighbours' average from the mean of a value, reduced if there are few neighbours.
    #[inline]
    fn dev(&self, k: usize, mean: i64, trust: i64) -> i64 {
        (self.value(k) * FINE - mean * i64::from(self.weight())) * trust >> 24
    }

    /// Returns `2²⁴` over the sum of the neighbours' weight and the prior's.
    #[inline]
    fn trust(&self, doubt: i64) -> i64 {
        ((1 << 24) / (self.weight() + doubt as i32)).into()
    }
}

/// Positions in [`LANES`] of the errors, the axis and the elongation; the values come first.
const ERROR_LANES: usize = AVERAGED;
const AXIS_LANES: usize = ERROR_LANES + 4;
const ELONGATION_LANE: usize = AXIS_LANES + 2;

/// Inputs to the prediction of one colour.
#[derive(Debug, Clone, Copy)]
struct ColorContext<'a> {
    around: &'a NeighbourSums,
    /// Weights of the neighbours' average and of their prediction errors.
    trust: [i64; 2],
    /// `0..=15`: the size of the Gaussian relative to the spacing of Gaussians, in octaves of its area.
    size: usize,
    /// `0..=7`: the aspect in octaves.
    aspect: usize,
}

/// A running mean with an initial estimate.
#[derive(Debug, Clone, Copy)]
struct Mean {
    sum: i64,
    count: i64,
    value: i64,
}

impl Mean {
    fn new(guess: i64, count: i64) -> Self {
        Mean { sum: guess * count, count, value: guess }
    }

    fn add(&mut self, value: i64) {
        self.sum += value;
        self.count += 1;
    }

    fn refresh(&mut self) {
        self.value = self.sum.div_euclid(self.count);
    }
}

/// Running linear regression of `y` on `x`, with the slope in 1/256.
#[derive(Debug, Clone, Copy)]
struct Slope {
    xy: i64,
    xx: i64,
    value: i64,
}

impl Slope {
    fn new(guess: i64, weight: i64) -> Self {
        Slope { xy: guess * weight, xx: weight * 256, value: guess }
    }

    fn of(self, x: i64) -> i64 {
        self.value * x >> 8
    }

    fn add(&mut self, x: i64, y: i64) {
        self.xy += x * y;
        self.xx += x * x;
        // Keeps `xy·256` within 64 bits; no real picture comes close. A term is below 2⁴⁸ and adds at least as much to
        // `xx` as its square root adds to `xy`, so that `xx` stays above 0.
        if (self.xx | self.xy.abs()) >> 50 != 0 {
            (self.xx, self.xy) = (self.xx >> 1, self.xy >> 1);
        }
    }

    fn refresh(&mut self) {
        self.value = (self.xy * 256 / self.xx).clamp(-1024, 1024);
    }
}

/// Number of Gaussians after which statistics are no longer refreshed for every Gaussian, but once per this many
/// Gaussians: a division costs more than the refresh gains.
const REFRESH_ALL: u32 = 64;
const REFRESH_EACH: u32 = 8;

/// The model of one channel.
#[derive(Debug)]
struct Color {
    /// Maximum magnitude of the integer.
    most: u64,
    gains: Gains<3>,
    mean: Mean,
    /// Running mean of the prediction errors, 64ths.
    error: Mean,
    /// Regression of a colour on the average of its neighbours.
    follow: Slope,
    /// Regressions of its prediction error on those of the first and the second channel.
    cross: [Slope; 2],
}

/// The models of one group.
#[derive(Debug)]
pub(crate) struct Attributes {
    aspect: Gains<3>,
    aspect_shift: Shifts,
    angle: Gains<3>,
    colors: Vec<Color>,
    index: Field,
    /// Running means of the major and of the minor scale, sixteenths of a scale step.
    means: [Mean; 2],
    seen: u32,
    /// Scale index that corresponds to the spacing of Gaussians, eighths.
    spacing: i64,
}

/// Parameters shared by all Gaussians of a group.
#[derive(Debug, Clone, Copy)]
pub(crate) struct GroupContext<'a> {
    pub rules: &'a Rules,
    pub palette: Palette<'a>,
    pub steps: Steps,
    /// Cells of the finest position step.
    pub grid: [u32; 2],
    /// `16·log₂` of the spacing of Gaussians, pixels.
    pub spacing: i64,
}

impl GroupContext<'_> {
    /// Returns `32·δ`: the step between neighbouring scales in 32nds of an octave.
    fn delta(&self) -> i64 {
        i64::from(self.steps.scale) + 4
    }

    /// Returns the fractional scale index of `log` sixteenths of an octave above one pixel.
    fn scale_of(&self, log: i64) -> i64 {
        (log + 32) * 2 * FINE / self.delta()
    }
}

/// Returns `16·log₂` of the spacing, in cells, of `count` Gaussians on `size` cells.
pub(crate) fn spacing(size: [u32; 2], count: u32) -> i64 {
    let (area, count) = (u64::from(size[0]) * u64::from(size[1]), u64::from(count.max(1)));
    // 256 times the number of cells per Gaussian. If that overflows, only the highest five bits count.
    let log = match (area / count).checked_mul(256) {
        Some(whole) => log16((whole + area % count * 256 / count).max(1)),
        None => log16(area / count >> 8) + 16 * 16,
    };
    i64::from((log - 16 * 8).div_euclid(2))
}

#[inline]
fn class(value: i64, last: i64) -> usize {
    (value.clamp(-last, last) + last) as usize
}

/// Returns 0 for 0, and the number of bits for other values.
fn log_class(value: u32, last: u32) -> usize {
    (32 - value.leading_zeros()).min(last) as usize
}

/// The 64 directions `2π·k/64`, as vectors of length 256.
static DIRECTIONS: LazyLock<[[i32; 2]; 64]> = LazyLock::new(|| {
    std::array::from_fn(|k| {
        let turn = std::f64::consts::TAU * k as f64 / 64.0;
        let (sin, cos) = sin_cos(turn);
        [cos, sin].map(|c| (256.0 * c + 0.5).floor() as i32)
    })
});

/// Returns the nearest of the 64 directions to a sum of vectors, whose length is at most 256 times `total`, and a
/// class of their agreement: 0 (none; the direction is 0) to 5.
fn consensus(axis: [i64; 2], total: i64) -> (u32, usize) {
    let [x, y] = axis.map(|a| a >> 8);
    let square = x * x + y * y;
    let fifths = (1..5).filter(|k| 25 * square >= k * k * total * total).count();
    if total == 0 || fifths == 0 {
        return (0, usize::from(total != 0));
    }
    // Rotated into the first quadrant.
    let (quarter, x, y) = match (x > 0, y >= 0) {
        (true, true) => (0, x, y),
        (false, _) if y > 0 => (1, y, -x),
        (false, _) if x < 0 => (2, -x, -y),
        _ => (3, -y, x),
    };
    let mut steps = 0;
    for half in [8, 4, 2, 1, 1] {
        if y * 4096 >= x * TANGENTS[steps + half - 1] {
            steps += half;
        }
    }
    ((quarter * 16 + steps as u32) % 64, fifths + 1)
}

/// `4096·tan(2π·(j + ½)/64)`, rounded.
static TANGENTS: [i64; 16] =
    [201, 608, 1026, 1466, 1937, 2455, 3038, 3712, 4519, 5523, 6834, 8660, 11448, 16352, 27613, 83376];

/// Returns the distribution of `major − minor`.
#[inline(always)]
pub(in crate::bitstream) fn aspects(near: Near, major: u8) -> Bounded {
    Bounded::new(near, 0, i32::from(major) + 1, UNIFORM_SHARE)
}

/// Returns the distribution of `n` angles, half a turn around one of 64 directions, for a spread over half a turn; and
/// the lowest of them.
#[inline(always)]
pub(in crate::bitstream) fn angles(direction: u32, n: i64, spread: i32) -> (Bounded, i64) {
    let place = i64::from(direction) * n / 4;
    let low = (place - 8 * n + 15) >> 4;
    (Bounded::new(Near::new(place, log16(n as u64) + spread), low, n as i32, ANGLE_SHARE), low)
}

/// Clamps a predicted colour, in sixteenths, to the range of colours.
#[inline(always)]
pub(in crate::bitstream) fn legal(place: i64) -> i64 {
    place.clamp(i64::from(i16::MIN) * FINE, i64::from(i16::MAX) * FINE)
}

/// Codes the part of a position that its square leaves open, in steps of `exponents`. When reading, `position` is
/// ignored.
#[inline(always)]
fn refined<C: Coder>(
    coder: &mut C,
    scene: &GroupContext<'_>,
    square: &Square,
    exponents: [i32; 2],
    position: [u32; 2],
) -> Result<[u32; 2], Broken> {
    let [lx, ly] = scene.rules.in_cells(exponents);
    let bits = [square.log - lx, square.log - ly];
    let rest = coder.pair(bits, [position[0] & ((1 << bits[0]) - 1), position[1] & ((1 << bits[1]) - 1)]);
    let (x, y) = (square.corner[0] >> lx | rest[0], square.corner[1] >> ly | rest[1]);
    if x << lx >= scene.grid[0] {
        return Err(Broken { field: "x", value: x.into() });
    }
    if y << ly >= scene.grid[1] {
        return Err(Broken { field: "y", value: y.into() });
    }
    Ok([x, y])
}

impl Attributes {
    pub(crate) fn new(scene: &GroupContext<'_>) -> Self {
        let palette = &scene.palette;
        let octave = 32 * FINE / scene.delta();
        let spacing = scene.scale_of(scene.spacing);
        let colors = (0..palette.channels.count()).map(|k| Color {
            most: scene.rules.most_color[k].unsigned_abs().into(),
            gains: Gains::new(),
            mean: Mean::new(i64::from(palette.background[k]) * FINE, 4),
            error: Mean::new(INITIAL_ERRORS[k], 4),
            follow: Slope::new(256, 16 * 256),
            cross: [Slope::new(0, 16 * 256); 2],
        });
        Attributes {
            aspect: Gains::new(),
            aspect_shift: Shifts::new(),
            angle: Gains::new(),
            colors: colors.collect(),
            index: Field::new(palette.book.map_or(0, |b| b.len().next_power_of_two().max(2)), 1, 250),
            means: [Mean::new(spacing - octave, 4), Mean::new(spacing - 3 * octave, 4)],
            seen: 0,
            spacing: spacing >> 3,
        }
    }

    /// Refreshes the values that are derived from the statistics.
    #[inline(never)]
    fn refresh(&mut self) {
        self.means.iter_mut().for_each(Mean::refresh);
        for (k, color) in self.colors.iter_mut().enumerate() {
            color.mean.refresh();
            color.error.refresh();
            color.follow.refresh();
            color.cross[..k.min(2)].iter_mut().for_each(Slope::refresh);
        }
    }

    /// Codes the Gaussian in `square`. When reading, `p` is ignored; the returned Gaussian obeys the rules of the
    /// format.
    pub(crate) fn code<C: Coder>(
        &mut self,
        coder: &mut C,
        scene: &GroupContext<'_>,
        buckets: &mut Buckets,
        square: &Square,
        p: &PackedGaussian,
    ) -> Result<PackedGaussian, Broken> {
        if self.seen < REFRESH_ALL || self.seen.is_multiple_of(REFRESH_EACH) {
            self.refresh();
        }
        self.seen = self.seen.wrapping_add(1);
        let log = square.log;
        let spot = buckets.spot(square);
        let around = NeighbourSums(buckets.around(&spot));
        // Both scales are predicted as the group's mean plus the neighbours' deviation, which has less weight if there
        // are few neighbours.
        let trust = around.trust(PRIOR_WEIGHT);
        let means = [self.means[0].value, self.means[1].value];
        let dev = [around.dev(0, means[0], trust), around.dev(1, means[1], trust)];

        // The side of the square follows from the major scale, so the square leaves about an octave of scales.
        let (low, high) = scene.rules.majors(log)?;
        let near = Near::new(means[0] + dev[0], MAJOR_SPREAD);
        let choice = Bounded::new(near, low.into(), i32::from(high - low) + 1, UNIFORM_SHARE);
        let major = low + coder.choose(&choice, i32::from(p.major) - i32::from(low)) as u8;
        coder.account("major scale");

        // The difference of the scales is coded instead of the minor scale, because it determines the number of
        // angles, which is 1 for a circle.
        let difference = self.aspect(coder, major, means, dev, p);
        let minor = major - difference;
        coder.account("minor scale");

        let n = scene.rules.lattice.angles(major, minor);
        let angle = self.angle(coder, n, p.angle, &around);
        debug_assert!(scene.rules.shape(major, minor, angle).is_ok());
        coder.account("angle");

        // The position steps follow from the shape, and are finer than the square in the direction in which the
        // Gaussian is narrow. All cells within the square are about equally likely.
        let exponents = scene.rules.lattice.exponents(major, minor, angle);
        let [x, y] = refined(coder, scene, square, exponents, [p.x, p.y])?;
        coder.account("position refinement");

        let mut errors = [0; 4];
        let color = match scene.palette.book {
            Some(book) => {
                let bits = usize::BITS - (book.len() - 1).leading_zeros();
                let wanted = book.binary_search(&p.color).unwrap_or(0);
                let index = self.index.tree(coder, 0, bits, wanted as u32);
                coder.account("colour index");
                *book.get(index as usize).ok_or(Broken { field: "codebook index", value: index.into() })?
            }
            None => {
                // The spread of colours around their prediction depends on the Gaussian's size and aspect.
                let size = (i64::from(major) + i64::from(minor) - self.spacing) * scene.delta() / 32 + 8;
                let outlook = ColorContext {
                    around: &around,
                    trust: [trust, around.trust(DOUBT_OF_ERRORS)],
                    size: size.clamp(0, 15) as usize,
                    aspect: (i64::from(difference) * scene.delta() / 32).min(7) as usize,
                };
                self.color(coder, &outlook, p.color, &mut errors)?
            }
        };
        let p = PackedGaussian { x, y, major, minor, angle, color };
        buckets.add(&spot, &self.learn(scene, n, &p, &errors));
        Ok(p)
    }

    /// Updates the means with a Gaussian that has `angles` angles and was coded with these errors of its colour.
    /// Returns its contribution to its bucket.
    #[inline(always)]
    fn learn(&mut self, scene: &GroupContext<'_>, angles: u16, p: &PackedGaussian, errors: &[i32; 4]) -> [i32; LANES] {
        let &PackedGaussian { major, minor, angle, color, .. } = p;
        let c = color.map(i32::from);
        let values = [major.into(), minor.into(), c[0], c[1], c[2], c[3]];
        // Means and buckets are updated only with values that a reader knows at this point.
        self.means[0].add(i64::from(major) * FINE);
        self.means[1].add(i64::from(minor) * FINE);
        // An axis is the same after half a turn, so directions are summed as vectors of twice the angle. The vectors
        // of round Gaussians are short, because their angles are arbitrary.
        let octaves = i32::from(major - minor) * (scene.delta() as i32);
        let elongation = 16 * octaves / (octaves + 32);
        let direction = (u32::from(angle) * 64 + u32::from(angles) / 2) / u32::from(angles) % 64;
        let axis = DIRECTIONS[direction as usize].map(|c| c * elongation);
        let mut lanes = [0; LANES];
        lanes[..AVERAGED].copy_from_slice(&values);
        lanes[ERROR_LANES..AXIS_LANES].copy_from_slice(errors);
        lanes[AXIS_LANES..ELONGATION_LANE].copy_from_slice(&axis);
        lanes[ELONGATION_LANE] = elongation;
        lanes[COUNT] = 1;
        lanes
    }

    /// Codes `major − minor`.
    fn aspect<C: Coder>(&mut self, coder: &mut C, major: u8, means: [i64; 2], dev: [i64; 2], p: &PackedGaussian) -> u8 {
        let minor = means[1] + (MINOR_GROWTH * (i64::from(major) * FINE - means[0]) + 10 * dev[1]) / 16;
        let expected = i64::from(major) * FINE - minor;
        let kind = ((expected + FINE / 2) >> 4).clamp(0, ASPECTS as i64 - 1) as usize;
        let place = expected + self.aspect_shift.get(kind);
        let classes = [kind, ASPECTS + class(dev[0] >> 5, 4), ASPECTS + 9 + class(dev[1] >> 5, 4)];
        let spread = ASPECT_SPREAD + self.aspect.log(&classes);
        coder.expect(Prediction::Aspect { major, place, spread });
        let near = Near::new(place, spread);
        let choice = aspects(near, major);
        let difference = coder.choose(&choice, i32::from(p.major) - i32::from(p.minor));
        self.aspect.learn(&classes, near.distance(difference.into()));
        self.aspect_shift.learn(kind, i64::from(difference) * FINE - place);
        difference as u8
    }

    fn angle<C: Coder>(&mut self, coder: &mut C, n: u16, angle: u16, around: &NeighbourSums) -> u16 {
        if n <= 1 {
            return 0;
        }
        let n = i64::from(n);
        let (direction, accord) = consensus(around.axis(), around.elongation());
        let classes = [n.ilog2().min(7) as usize, 8 + accord, 8 + 6 + direction as usize / 4];
        let spread = ANGLE_SPREADS[accord] + self.angle.log(&classes);
        coder.expect(Prediction::Angle { direction, spread });
        let (choice, low) = angles(direction, n, spread);
        let (step, share) = coder.share(&choice, (i64::from(angle) - low).rem_euclid(n) as i32);
        // Distances on a circle are bounded, so the distance is measured as the cumulative probability from the centre
        // of the distribution. No total is above 2¹⁷: 32 bits suffice.
        let (total, middle) = (choice.total(), share[0] + share[1]);
        self.angle.learn(&classes, (2 * MEAN as u32 * middle.abs_diff(total) / total) as i32);
        // The range is from half a turn below 0 to half a turn above a full turn.
        let angle = low + i64::from(step);
        (if angle < 0 {
            angle + n
        } else if angle < n {
            angle
        } else {
            angle - n
        }) as u16
    }

    fn color<C: Coder>(
        &mut self,
        coder: &mut C,
        outlook: &ColorContext<'_>,
        color: [i16; 4],
        errors: &mut [i32; 4],
    ) -> Result<[i16; 4], Broken> {
        let mut out = [0i16; 4];
        // Prediction errors of the first two channels; 0 until they are known.
        let mut surprises = [0i64; 2];
        let mut before = 8;
        for (k, model) in self.colors.iter_mut().enumerate() {
            let mean = model.mean.value;
            let dev = outlook.around.dev(2 + k, mean, outlook.trust[0]);
            let follow = model.follow.of(dev);
            let guess = mean + follow + model.cross[0].of(surprises[0]) + model.cross[1].of(surprises[1]);
            let guess = legal(guess);
            let classes = [outlook.size, 16 + before, 16 + 9 + outlook.aspect];
            let own = model.error.value * DOUBT_OF_ERRORS;
            let error = (outlook.around.error(k) * FINE + own) * outlook.trust[1] >> 24;
            let log = log16(error.max(1) as u64) + 32 + model.gains.log(&classes);
            let cross = [0, 1].map(|j| model.cross[j].value);
            coder.expect(Prediction::Color { channel: k, place: mean + follow, cross, spread: log });
            let near = Near::new(guess, log);
            let value = Open::new(near).code(coder, color[k].into());
            if value.unsigned_abs() > model.most {
                return Err(Broken { field: "colour", value: value.unsigned_abs() });
            }
            out[k] = value as i16;
            model.gains.learn(&classes, near.distance(value));
            let actual = value * FINE;
            errors[k] = ((actual - guess).abs() >> 2).min(1 << 16) as i32;
            before = log_class((value - ((guess + FINE / 2) >> 4)).unsigned_abs() as u32, 7);
            model.mean.add(actual);
            model.error.add(i64::from(errors[k]) * FINE);
            model.follow.add(dev, actual - mean);
            let left = actual - mean - follow;
            // Errors that are not yet known are 0 and do not change the regressions.
            let [first, second] = &mut model.cross;
            first.add(surprises[0], left);
            second.add(surprises[1], left - first.of(surprises[0]));
            if let Some(surprise) = surprises.get_mut(k) {
                *surprise = left;
            }
            coder.account(["colour 0", "colour 1", "colour 2", "colour 3"][k]);
        }
        Ok(out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns whether `v` is further from a rounding boundary than the error of any f64 library.
    fn clear(v: f64) -> bool {
        (v - v.floor() - 0.5).abs() > 1e-9
    }

    #[test]
    fn directions_and_tangents_round_the_same_on_every_machine() {
        for k in 0..64 {
            let turn = std::f64::consts::TAU * f64::from(k) / 64.0;
            assert!(clear(256.0 * turn.cos()) && clear(256.0 * turn.sin()));
        }
        for j in 0..16 {
            let tangent = 4096.0 * (std::f64::consts::TAU * (f64::from(j) + 0.5) / 64.0).tan();
            assert!(clear(tangent) && (tangent + 0.5).floor() as i64 == TANGENTS[j as usize]);
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
