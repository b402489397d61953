//! Rules for the integers of a picture, whether they come from a file or from a caller (spec §4).

use super::broken::Broken;
use super::header::{MAX_SIDE, MIN_EXPONENT};
use super::lattice::Lattice;
use super::region::{Place, Region};
use super::splats::{Layout, PackedGaussian, PackedSplats, Steps};
use crate::error::{Error, Result};
use crate::gaussian::{CUTOFF, Channels};
use crate::parameter::Parameter;

/// Maximum number of colours in a codebook.
pub const MAX_CODEBOOK: usize = 1 << 16;

/// Maximum number of progressive levels.
pub const MAX_LEVELS: usize = 8;

/// Maximum grey, luma, chroma and alpha, where 1 is white. Within this range, single precision renders all visible
/// colours exactly enough (spec §4). Red, green and blue can be at most twice as large.
#[cfg(feature = "encode")]
pub const MAX_COLOR: f32 = 8.0;

/// Chroma steps in units of half a luma step (spec §4.1).
const CHROMA_HALVES: [u64; 4] = [2, 3, 4, 6];

/// Returns the maximum magnitude of each of the four colour integers with these steps: that of [`MAX_COLOR`].
/// `1..=1024`.
#[must_use]
pub fn most_color(steps: &Steps, channels: Channels) -> [i16; 4] {
    // n · ratio · 2^(luma/3 − 7) ≤ 8, cubed so that it can be computed in integers.
    let most = |halves: u64| {
        let cubed = |n: i16| (n as u64 * halves).pow(3) << steps.luma;
        (1..=1024).rev().find(|&n| cubed(n) <= 1 << 33).expect("the least is 3")
    };
    let luma = most(CHROMA_HALVES[0]);
    match channels {
        Channels::Grey | Channels::GreyAlpha => [luma; 4],
        Channels::Rgb | Channels::Rgba => {
            let chroma = most(CHROMA_HALVES[usize::from(steps.chroma & 3)]);
            [luma, chroma, chroma, luma]
        }
    }
}

/// Returns the maximum number of Gaussians in a payload of `bytes` bytes. Real Gaussians take 20 bits or more, and a
/// file of a few bytes that claims millions must not cost the work of millions.
pub(crate) fn most_gaussians(bytes: u64) -> u64 {
    bytes.saturating_mul(8).saturating_add(1024)
}

/// The rules of one picture.
#[derive(Debug, Clone)]
pub(crate) struct Rules {
    pub lattice: Lattice,
    pub size: [u32; 2],
    pub coarsest: i32,
    range: u32,
    /// `32·δ`.
    delta: i32,
    position: i32,
    /// Largest valid scale index.
    pub top: u8,
    pub channels: usize,
    /// Maximum magnitude of the colour integers.
    pub most_color: [i16; 4],
    /// The first and the last major scale for each square; none if the first is larger.
    majors: [(u8, u8); 16],
}

impl Rules {
    pub(crate) fn new(steps: &Steps, layout: Layout, size: [u32; 2], channels: Channels) -> Self {
        let mut rules = Rules {
            lattice: Lattice::new(steps, layout),
            size,
            coarsest: steps.coarsest.into(),
            range: steps.range.into(),
            delta: i32::from(steps.scale) + 4,
            position: steps.position.into(),
            // i·δ − 2 ≤ 20 with δ = (scale + 4)/32.
            top: (22 * 32 / (u32::from(steps.scale) + 4)).min(255) as u8,
            channels: channels.count(),
            most_color: most_color(steps, channels),
            majors: [(u8::MAX, 0); 16],
        };
        for major in 0..=rules.top {
            let (low, high) = &mut rules.majors[rules.seat(major) as usize];
            (*low, *high) = (major.min(*low), major);
        }
        rules
    }

    pub(crate) fn of(splats: &PackedSplats) -> Self {
        Rules::new(&splats.steps, splats.layout, [splats.width, splats.height], splats.channels)
    }

    /// Returns the exponent of the finest position step.
    pub(crate) fn finest(&self) -> i32 {
        self.coarsest - self.range as i32
    }

    /// Returns the number of octaves between the finest and the coarsest position step.
    pub(crate) fn range(&self) -> u32 {
        self.range
    }

    /// Returns the number of cells of the finest step along each side.
    pub(crate) fn grid(&self) -> [u32; 2] {
        self.size.map(|side| Lattice::positions(side, self.finest()))
    }

    /// Returns the region that contains every Gaussian.
    pub(crate) fn region(&self) -> Region {
        Region::whole(self.grid(), self.range)
    }

    /// Returns the binary logarithms of the position steps of a shape, in finest cells.
    pub(crate) fn logs(&self, major: u8, minor: u8, angle: u16) -> [u32; 2] {
        self.in_cells(self.lattice.exponents(major, minor, angle))
    }

    /// Returns the binary logarithms, in finest cells, of position steps of `2^exponents` pixels.
    pub(crate) fn in_cells(&self, exponents: [i32; 2]) -> [u32; 2] {
        exponents.map(|e| (e - self.finest()) as u32)
    }

    /// Returns the binary logarithm of the side, in finest cells, of the square that contains a Gaussian of this
    /// major scale: the position step that it would have along its major axis, which is the coarsest that its shape
    /// can have.
    pub(crate) fn seat(&self, major: u8) -> u32 {
        let log64 = 2 * (i32::from(major) * self.delta - 64 - 8 * self.position) - 1;
        ((log64 + 32).div_euclid(64).clamp(self.finest(), self.coarsest) - self.finest()) as u32
    }

    /// Returns the smallest and the largest major scale of Gaussians in squares of side `2^log` cells.
    pub(crate) fn majors(&self, log: u32) -> Result<(u8, u8), Broken> {
        let (low, high) = self.majors[log as usize];
        if low > high { Err(Broken { field: "square without a scale", value: log.into() }) } else { Ok((low, high)) }
    }

    /// Returns an upper bound of half the longest axis of the support of a Gaussian of this major scale, pixels.
    pub(crate) fn reach(&self, major: u8) -> f64 {
        let log2 = f64::from(i32::from(major) * self.delta) / 32.0 - 2.0;
        f64::from(CUTOFF) * log2.exp2() * (1.0 + 1e-6)
    }

    /// Returns the square that contains a Gaussian.
    pub(crate) fn place(&self, p: &PackedGaussian, region: Region) -> Place {
        let [lx, ly] = self.logs(p.major, p.minor, p.angle);
        region.place([p.x << lx, p.y << ly], self.seat(p.major))
    }

    pub(crate) fn shape(&self, major: u8, minor: u8, angle: u16) -> Result<(), Broken> {
        let broken = |field, value| Err(Broken { field, value });
        if major > self.top {
            return broken("major scale", major.into());
        }
        if minor > major {
            return broken("minor scale", minor.into());
        }
        if angle >= self.lattice.angles(major, minor) {
            return broken("angle", angle.into());
        }
        Ok(())
    }

    pub(crate) fn color(&self, color: [i16; 4]) -> Result<(), Broken> {
        let broken = |field, value: i16| Err(Broken { field, value: value.unsigned_abs().into() });
        for (k, (&c, most)) in color.iter().zip(self.most_color).enumerate() {
            if k >= self.channels && c != 0 {
                return broken("colour of an absent channel", c);
            }
            if c.unsigned_abs() > most.unsigned_abs() {
                return broken("colour", c);
            }
        }
        Ok(())
    }

    /// Checks the colours of a palette: background and codebook.
    pub(crate) fn palette(&self, splats: &PackedSplats) -> Result<(), Broken> {
        let named = |field| move |Broken { value, .. }: Broken| Broken { field, value };
        self.color(splats.background).map_err(named("background"))?;
        let mut book = splats.codebook.iter().flatten();
        book.try_for_each(|&c| self.color(c)).map_err(named("codebook"))
    }

    pub(crate) fn gaussian(&self, p: &PackedGaussian) -> Result<(), Broken> {
        self.shape(p.major, p.minor, p.angle)?;
        self.position([p.x, p.y], self.lattice.exponents(p.major, p.minor, p.angle))?;
        self.color(p.color)
    }

    /// Checks that a position in steps of `2^exponents` pixels lies in the picture.
    pub(crate) fn position(&self, position: [u32; 2], exponents: [i32; 2]) -> Result<(), Broken> {
        for (k, field) in ["x", "y"].into_iter().enumerate() {
            if position[k] >= Lattice::positions(self.size[k], exponents[k]) {
                return Err(Broken { field, value: position[k].into() });
            }
        }
        Ok(())
    }
}

/// Checks everything in `splats` that a caller can set.
///
/// # Errors
/// [`Error::Parameter`] with the name of the field.
pub(crate) fn check(splats: &PackedSplats) -> Result<()> {
    check_all(splats).map_err(|b| Error::Parameter {
        parameter: parameter_of(b.field),
        problem: format!("{} is against the format", b.value),
    })
}

/// Returns the parameter that sets a field.
fn parameter_of(field: &'static str) -> Parameter {
    match field {
        "width" => Parameter::Width,
        "height" => Parameter::Height,
        field => Parameter::Other(field),
    }
}

fn check_all(splats: &PackedSplats) -> Result<(), Broken> {
    let s = &splats.steps;
    let in_range = |field, ok: bool, value: u64| if ok { Ok(()) } else { Err(Broken { field, value }) };
    for (field, side) in [("width", splats.width), ("height", splats.height)] {
        in_range(field, (1..=MAX_SIDE).contains(&side), side.into())?;
    }
    for (field, value, last) in [
        ("scale step", s.scale, 15),
        ("angle step", s.angle, 3),
        ("position step", s.position, 15),
        ("luma step", s.luma, 15),
        ("chroma step", s.chroma, 3),
        ("position range", s.range, if splats.layout == Layout::Packed { 0 } else { 15 }),
    ] {
        in_range(field, value <= last, value.into())?;
    }
    if let Some(layer) = &splats.detail {
        in_range("layout of a file with a detail layer", splats.layout == Layout::Coded, splats.layout as u64)?;
        super::detail::head::check(&layer.head)?;
        super::detail::head::check_alpha(&layer.head, splats.channels)?;
        let fits = layer.fits([splats.width, splats.height], splats.channels);
        in_range("tiles of the detail layer", fits, layer.tiles.len() as u64)?;
    }
    if let Some(layer) = &splats.exact {
        in_range("layout of a file with an exact layer", splats.layout == Layout::Coded, splats.layout as u64)?;
        super::exact::head::check_side(layer.side)?;
        let fits = layer.fits([splats.width, splats.height], splats.channels, splats.depth);
        in_range("tiles of the exact layer", fits, layer.tiles.len() as u64)?;
    }
    in_range("coarsest step", (-6..=9).contains(&s.coarsest), s.coarsest as u64)?;
    in_range("position range", i32::from(s.coarsest) - i32::from(s.range) >= MIN_EXPONENT, s.range.into())?;
    in_range("number of Gaussians", u32::try_from(splats.gaussians.len()).is_ok(), splats.gaussians.len() as u64)?;
    let leveled = splats.levels.iter().map(|&n| u64::from(n)).sum::<u64>();
    in_range("levels", splats.levels.is_empty() || leveled == splats.gaussians.len() as u64, leveled)?;
    in_range("levels", !splats.levels.contains(&0), 0)?;
    in_range("levels", splats.levels.len() <= MAX_LEVELS, splats.levels.len() as u64)?;
    in_range("levels", splats.levels.len() <= 1 || splats.layout == Layout::Coded, splats.levels.len() as u64)?;
    let rules = Rules::of(splats);
    if let Some(codebook) = &splats.codebook {
        in_range("codebook size", (1..=MAX_CODEBOOK).contains(&codebook.len()), codebook.len() as u64)?;
    }
    rules.palette(splats)?;
    splats.gaussians.iter().try_for_each(|p| rules.gaussian(p))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colour_integers_reach_the_largest_colour_and_no_further() {
        for luma in 0..16u8 {
            for (chroma, ratio) in [1.0, 1.5, 2.0, 3.0].into_iter().enumerate() {
                let chroma = chroma as u8;
                let steps = Steps { scale: 0, angle: 1, position: 5, coarsest: 2, range: 4, luma, chroma };
                let step = (f64::from(luma) / 3.0 - 7.0).exp2();
                let [y, co, cg, a] = most_color(&steps, Channels::Rgba);
                assert_eq!((y, co), (a, cg));
                for (most, step) in [(y, step), (co, step * ratio)] {
                    // Some values are exactly at the bound.
                    let bound = f64::from(MAX_COLOR) * (1.0 + 1e-12);
                    assert!(f64::from(most) * step <= bound && f64::from(most + 1) * step > bound, "{luma} {chroma}");
                }
                assert_eq!(most_color(&steps, Channels::GreyAlpha), [y; 4]);
            }
        }
    }

    #[test]
    fn top_is_the_last_index_below_the_largest_scale() {
        for scale in 0..16u8 {
            let steps = Steps { scale, angle: 1, position: 5, coarsest: 2, range: 4, luma: 4, chroma: 1 };
            let top = Rules::new(&steps, Layout::Coded, [1, 1], Channels::Rgb).top;
            let log = |i: f64| i * (f64::from(scale) + 4.0) / 32.0 - 2.0;
            assert!(log(top.into()) <= 20.0 && (top == 255 || log(f64::from(top) + 1.0) > 20.0));
        }
    }
}
