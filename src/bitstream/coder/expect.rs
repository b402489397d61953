//! Estimates the cost in bits of other integers for a Gaussian, from the predictions of the entropy coder (spec
//! §8.6).
//!
//! The coder predicts the aspect, the angle and the colour of a Gaussian from its neighbours, with adaptive spreads.
//! A [`Recorder`] takes the coder's place and records both. The record is a snapshot: it is valid as long as the
//! neighbours do not change.

use super::attributes::{MINOR_GROWTH, angles, aspects, legal};
use super::coded::{Group, sort};
use super::range::{Coder, Cumulative, Prediction};
use super::spread::{Bounded, FINE, Near, Open};
use crate::bitstream::groups;
use crate::bitstream::header::Grouping;
use crate::bitstream::region::Region;
use crate::bitstream::splats::{Layout, PackedGaussian, PackedSplats};
use crate::error::Result;
use crate::parallel;

/// Spread of an angle over half a turn without any prediction, in sixteenths of octaves.
const ANGLE_SPREAD: i32 = 112;

/// Prediction of a channel's colour.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Color {
    place: i32,
    /// Weights of the prediction errors of the first two channels, in 256ths.
    cross: [i16; 2],
    spread: i16,
}

/// Predictions for one Gaussian.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct PredictedCost {
    /// The major scale for which the aspect was predicted.
    major: u8,
    direction: u8,
    aspect_spread: i16,
    angle_spread: i16,
    aspect: i32,
    colors: [Color; 4],
}

impl PredictedCost {
    /// Returns the cost in bits of `minor` after `major`.
    #[inline(always)]
    pub(crate) fn aspect(&self, major: u8, minor: u8) -> f32 {
        let place = i64::from(self.aspect) + (FINE - MINOR_GROWTH) * (i64::from(major) - i64::from(self.major));
        let near = Near::new(place, self.aspect_spread.into());
        let mut price = Price::default();
        price.choose(&aspects(near, major), i32::from(major) - i32::from(minor));
        price.bits
    }

    /// Returns the distribution of one of `n` angles; `None` if there is only one angle.
    #[inline(always)]
    pub(crate) fn angles(&self, n: u16) -> Option<Angles> {
        let several = n > 1;
        several.then(|| {
            let (choice, low) = angles(self.direction.into(), n.into(), self.angle_spread.into());
            Angles { choice, low, n: n.into() }
        })
    }

    /// Returns the cost in bits of a colour with this many channels.
    #[inline(always)]
    pub(crate) fn color(&self, color: [i16; 4], channels: usize) -> f32 {
        let mut surprises = [0i64; 2];
        let mut price = Price::default();
        for (k, expected) in self.colors[..channels].iter().enumerate() {
            let [first, second] = [0, 1].map(|j| i64::from(expected.cross[j]) * surprises[j] >> 8);
            let (place, value) = (i64::from(expected.place), i64::from(color[k]));
            Open::new(Near::new(legal(place + first + second), expected.spread.into())).code(&mut price, value);
            if let Some(surprise) = surprises.get_mut(k) {
                *surprise = value * FINE - place;
            }
        }
        price.bits
    }

    /// Returns a lower bound of the cost in bits of any colour with this many channels.
    #[inline(always)]
    pub(crate) fn least_color(&self, channels: usize) -> f32 {
        let mut price = Price::default();
        for expected in &self.colors[..channels] {
            price.choose(&Open::new(Near::new(0, expected.spread.into())), 0);
        }
        price.bits
    }
}

/// Distribution of the angles of a Gaussian that has more than one possible angle.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Angles {
    choice: Bounded,
    low: i64,
    n: i64,
}

impl Angles {
    /// Returns the cost in bits of an angle.
    #[inline(always)]
    pub(crate) fn bits(&self, angle: u16) -> f32 {
        let mut price = Price::default();
        price.choose(&self.choice, (i64::from(angle) - self.low).rem_euclid(self.n) as i32);
        price.bits
    }
}

/// Sums the cost of values.
#[derive(Debug, Default)]
struct Price {
    bits: f32,
}

impl Coder for Price {
    fn bit(&mut self, one: u32, bit: u32) -> u32 {
        self.bits += 16.0 - log2(if bit != 0 { one } else { 65536 - one });
        bit
    }

    #[inline]
    fn uniform(&mut self, total: u32, value: u32) -> u32 {
        self.bits += log2(total);
        value
    }

    #[inline(always)]
    fn share(&mut self, frequencies: &impl Cumulative, value: i32) -> (i32, [u32; 2]) {
        let [low, high] = [value, value + 1].map(|v| frequencies.below(v));
        self.bits += log2(frequencies.total()) - log2(high - low);
        (value, [low, high])
    }
}

/// Returns `log₂` of a positive number within 0.0007, by a cubic polynomial of its mantissa.
#[inline(always)]
fn log2(value: u32) -> f32 {
    let bits = (value as f32).to_bits();
    let m = f32::from_bits(bits & 0x007f_ffff | 0x3f80_0000);
    let exponent = (bits >> 23) as i32 - 127;
    exponent as f32 + ((0.158_248_7 * m - 1.051_875) * m + 3.047_884) * m - 2.153_620_7
}

/// Processes the Gaussians as a writer does, and records the prediction of each.
#[derive(Debug, Default)]
struct Recorder(Vec<PredictedCost>);

impl Coder for Recorder {
    fn bit(&mut self, _one: u32, bit: u32) -> u32 {
        bit
    }

    fn uniform(&mut self, _total: u32, value: u32) -> u32 {
        value
    }

    fn share(&mut self, frequencies: &impl Cumulative, value: i32) -> (i32, [u32; 2]) {
        (value, [value, value + 1].map(|v| frequencies.below(v)))
    }

    fn expect(&mut self, prediction: Prediction) {
        if let Prediction::Aspect { major, place, spread } = prediction {
            // A single possible angle is not predicted.
            self.0.push(PredictedCost {
                major,
                direction: 0,
                aspect_spread: spread as i16,
                angle_spread: ANGLE_SPREAD as i16,
                aspect: place as i32,
                colors: [Color::default(); 4],
            });
        }
        let Some(last) = self.0.last_mut() else { return };
        match prediction {
            Prediction::Aspect { .. } => {}
            Prediction::Angle { direction, spread } => {
                (last.direction, last.angle_spread) = (direction as u8, spread as i16);
            }
            Prediction::Color { channel, place, cross, spread } => {
                let cross = cross.map(|c| c as i16);
                last.colors[channel] = Color { place: place as i32, cross, spread: spread as i16 };
            }
        }
    }
}

/// Sorts the Gaussians of `splats` into the order of the file, and returns the coder's predictions for each. Returns
/// nothing for other layouts and for colours in a codebook, which are not predicted.
///
/// # Errors
/// [`Error::Parameter`](crate::Error::Parameter) if the integers break spec §4.
pub(crate) fn expected(splats: &mut PackedSplats) -> Result<Vec<PredictedCost>> {
    if splats.layout != Layout::Coded || splats.codebook.is_some() {
        return Ok(Vec::new());
    }
    let (grouping, levels) = (groups::grouping(splats), groups::levels(splats));
    let mut sorted = std::mem::take(&mut splats.gaussians);
    let group = Group::new(splats, None)?;
    let parts: Vec<(Region, &[PackedGaussian])> = match grouping {
        Grouping::Single => {
            let region = group.rules.region();
            sort(&mut sorted, &group.rules, region);
            vec![(region, &sorted)]
        }
        Grouping::Groups => groups::parts(&mut sorted, &levels, &group.rules, &mut Vec::new()),
    };
    let recorded = parallel::map(parts.len(), |i| {
        let (region, part) = parts[i];
        let mut recorder = Recorder(Vec::with_capacity(part.len()));
        group.code(&mut recorder, region, Some(part), part.len() as u32).map(|_| recorder.0)
    });
    let recorded = recorded.into_iter().collect::<std::result::Result<Vec<_>, _>>()?.concat();
    splats.gaussians = sorted;
    Ok(recorded)
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;
    use crate::bitstream::rules::Rules;
    use crate::bitstream::splats::{Metadata, Steps};
    use crate::bitstream::{inspect, to_bytes};
    use crate::gaussian::{Blend, Channels};
    use crate::limits::Limits;
    use crate::pixels::Depth;

    /// Returns Gaussians whose colours and angles depend on their position, with some random ones.
    fn made_up(count: usize, channels: Channels) -> PackedSplats {
        let mut splats = PackedSplats {
            width: 700,
            height: 500,
            channels,
            depth: Depth::Eight,
            blend: Blend::Normalized,
            layout: Layout::Coded,
            steps: Steps { scale: 4, angle: 1, position: 6, coarsest: 3, range: 7, luma: 6, chroma: 1 },
            background: [40, 0, 0, 0],
            codebook: None,
            gaussians: Vec::new(),
            levels: Vec::new(),
            detail: None,
            exact: None,
            metadata: Metadata::default(),
        };
        let rules = Rules::of(&splats);
        let mut rng = Pcg64Mcg::seed_from_u64(5);
        while splats.gaussians.len() < count {
            let major = rng.random_range(4..22u8);
            let minor = rng.random_range(0..=major);
            let n = rules.lattice.angles(major, minor);
            let at = [rng.random::<f32>(), rng.random::<f32>()];
            let angle = ((at[0] + 0.2 * rng.random::<f32>()).fract() * f32::from(n)) as u16 % n;
            let logs = rules.logs(major, minor, angle);
            let [x, y] = [0, 1].map(|k| (at[k] * rules.grid()[k] as f32) as u32 >> logs[k]);
            let mut color = [0i16; 4];
            for (k, c) in color[..channels.count()].iter_mut().enumerate() {
                // Some lie outside the range of an open distribution.
                let far = if rng.random::<f32>() < 0.02 { 500.0 } else { 6.0 };
                *c = (60.0 * at[k % 2] + far * (rng.random::<f32>() - 0.5)) as i16;
            }
            let p = PackedGaussian { x, y, major, minor, angle, color };
            if rules.gaussian(&p).is_ok() {
                splats.gaussians.push(p);
            }
        }
        splats
    }

    #[test]
    fn predicted_costs_match_the_bits_of_the_coder() {
        for (count, levels, channels) in [
            (3, vec![], Channels::Rgb),
            (900, vec![], Channels::Grey),
            (2000, vec![], Channels::Rgba),
            (3000, vec![400, 2600], Channels::Rgb),
        ] {
            let mut splats = PackedSplats { levels, ..made_up(count, channels) };
            let (_, report) = inspect(&to_bytes(&splats).unwrap(), &Limits::default()).unwrap();
            let real = |names: &[&str]| -> f64 {
                report.fields.iter().filter(|f| names.contains(&f.name)).map(|f| f.bits).sum()
            };
            let expected = expected(&mut splats).unwrap();
            assert_eq!(expected.len(), count);
            let lattice = Rules::of(&splats).lattice;
            let sum = |cost: &dyn Fn(&PredictedCost, &PackedGaussian) -> f32| -> f64 {
                expected.iter().zip(&splats.gaussians).map(|(e, g)| f64::from(cost(e, g))).sum()
            };
            let aspect = sum(&|e, g| e.aspect(g.major, g.minor));
            let angle = sum(&|e, g| e.angles(lattice.angles(g.major, g.minor)).map_or(0.0, |a| a.bits(g.angle)));
            let color = sum(&|e, g| e.color(g.color, channels.count()));
            let least = sum(&|e, _| e.least_color(channels.count()));
            assert!(0.0 < least && least < color, "{least} {color}");
            let fields: [(f64, &[&str]); 3] = [
                (aspect, &["minor scale"]),
                (angle, &["angle"]),
                (color, &["colour 0", "colour 1", "colour 2", "colour 3"]),
            ];
            for (found, names) in fields {
                let real = real(names);
                // The error of the polynomial, once per value.
                assert!(real > 0.0 && (found - real).abs() < 0.0015 * 4.0 * count as f64, "{names:?}: {found} {real}");
                assert!((found / real - 1.0).abs() < 2e-3, "{names:?} of {count}: {found} {real}");
            }
        }
    }

    #[test]
    fn layouts_without_predictions_return_none() {
        let mut packed = PackedSplats { layout: Layout::Planes, ..made_up(10, Channels::Rgb) };
        assert!(expected(&mut packed).unwrap().is_empty());
        let mut of_book = made_up(10, Channels::Rgb);
        of_book.codebook = Some(vec![[0; 4]]);
        assert!(expected(&mut of_book).unwrap().is_empty());
        assert!(expected(&mut made_up(0, Channels::Rgb)).unwrap().is_empty());
    }

    #[cfg(feature = "rayon")]
    #[test]
    fn predictions_do_not_depend_on_the_thread_count() {
        let splats = PackedSplats { levels: vec![1000, 3000], ..made_up(4000, Channels::Rgb) };
        let with = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let mut splats = splats.clone();
            let expected = pool.install(|| expected(&mut splats).unwrap());
            (expected, splats.gaussians)
        };
        assert!(with(1) == with(3));
    }

    #[test]
    fn logarithms_are_within_their_bound() {
        for v in (1..=1 << 18).step_by(7) {
            let off = f64::from(log2(v)) - f64::from(v).log2();
            assert!(off.abs() < 7e-4, "{v}: {off}");
        }
    }
}
