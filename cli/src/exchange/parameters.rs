//! Exchanged data: the Gaussians of a picture, with their layout and steps if they come from an .ssplat file. They can
//! be read from and written to `.npz` archives.
//!
//! Means, scales and covariances are in pixels with pixel centres at +0.5, rotations in radians from the x axis (right)
//! towards the y axis (down), colours in encoded sRGB values, nominally from 0 to 1.

use std::collections::BTreeMap;
use std::ops::Index;

use ssplat::unstable::bitstream::splats::{Layout, Steps};
use ssplat::{Blend, Channels, Depth, Gaussian, Gaussians, Limits, SsplatImage};

use super::npy::{self, Array, Values};
use super::npz;
use super::problem::{Problem, shown};
use crate::names;

/// Names of the arrays of ssplat's archives.
pub const ARRAYS: [&str; 11] = [
    "means",
    "scales",
    "rotations",
    "covariances",
    "colors",
    "background",
    "size",
    "blend",
    "layout",
    "depth",
    "steps",
];

/// Largest number of elements of an array that describes the whole picture.
pub const MOST_NUMBERS: usize = 16;

/// The Gaussians of a picture.
#[derive(Debug, Clone, PartialEq)]
pub struct Parameters {
    pub picture: Gaussians,
    /// Layout and steps of the .ssplat file that they come from; with these, they are quantized to the same integers
    /// again.
    pub stored: Option<(Layout, Steps)>,
}

/// Properties that the caller states for parameters that lack them.
#[derive(Debug, Clone, Copy, Default)]
pub struct Given {
    pub size: Option<[u32; 2]>,
    pub blend: Option<Blend>,
}

impl Given {
    pub fn size(&self, stated: Option<[u32; 2]>) -> Result<[u32; 2], Problem> {
        let problem = || Problem::Unstated("the picture's size is not stated: give --size WxH".into());
        self.size.or(stated).ok_or_else(problem)
    }

    pub fn blend(&self, stated: Option<Blend>) -> Result<Blend, Problem> {
        let problem = || Problem::Unstated("the blend is not stated: give --blend sum or --blend normalized".into());
        self.blend.or(stated).ok_or_else(problem)
    }
}

impl Parameters {
    /// Returns the Gaussians of a file, with its layout and steps.
    ///
    /// # Errors
    /// As [`SsplatImage::gaussians`].
    pub fn of(image: &SsplatImage) -> ssplat::Result<Self> {
        let splats = image.splats();
        Ok(Parameters { picture: image.gaussians()?, stored: Some((splats.layout, splats.steps)) })
    }

    /// Returns an archive of the arrays [`ARRAYS`].
    pub fn to_npz(&self) -> Result<Vec<u8>, String> {
        let p = &self.picture;
        let (gaussians, n, channels) = (&p.list, p.list.len(), p.channels.count());
        let covariances = gaussians.iter().flat_map(|g| {
            let [xx, xy, yy] = covariance(g);
            [xx, xy, xy, yy]
        });
        let mut arrays = vec![
            ("means", npy::floats(&[n, 2], gaussians.iter().flat_map(|g| g.mean))),
            ("scales", npy::floats(&[n, 2], gaussians.iter().flat_map(|g| g.scale))),
            ("rotations", npy::floats(&[n], gaussians.iter().map(|g| g.rotation))),
            ("covariances", npy::floats(&[n, 2, 2], covariances)),
            ("colors", npy::floats(&[n, channels], gaussians.iter().flat_map(|g| g.color[..channels].to_vec()))),
            ("background", npy::floats(&[channels], p.background[..channels].to_vec())),
            ("size", npy::integers(&[p.width as i32, p.height as i32])),
            ("blend", npy::text(names::blend_name(p.blend))),
            ("depth", npy::integers(&[8 * p.depth.bytes() as i32])),
        ];
        if let Some((layout, steps)) = self.stored {
            arrays.push(("layout", npy::text(names::layout_name(layout))));
            arrays.push(("steps", npy::integers(&numbers_of(&steps))));
        }
        npz::write(&arrays)
    }

    /// Reads such arrays. Means, colours, and either scales with rotations or covariances are required.
    pub fn from_arrays(arrays: &BTreeMap<String, Array>, given: Given) -> Result<Self, Problem> {
        let means = rows(arrays, "means", Some(2))?;
        let colors = rows(arrays, "colors", None)?;
        let count = colors.width;
        let channels =
            Channels::from_count(count).ok_or_else(|| format!("colors have {count} channels, not 1 to 4"))?;
        let mut gaussians = Vec::with_capacity(means.len());
        if arrays.contains_key("scales") {
            let (scales, rotations) = (rows(arrays, "scales", Some(2))?, rows(arrays, "rotations", Some(1))?);
            same_length(
                means.len(),
                &[("colors", colors.len()), ("scales", scales.len()), ("rotations", rotations.len())],
            )?;
            for i in 0..means.len() {
                let (scale, rotation) = ordered([scales[i][0], scales[i][1]], rotations[i][0]);
                gaussians.push(gaussian([means[i][0], means[i][1]], scale, rotation, &colors[i]));
            }
        } else {
            let covariances = rows(arrays, "covariances", Some(4))?;
            same_length(means.len(), &[("colors", colors.len()), ("covariances", covariances.len())])?;
            for i in 0..means.len() {
                let (scale, rotation) = of_covariance([covariances[i][0], covariances[i][1], covariances[i][3]])
                    .ok_or_else(|| {
                        format!("array covariances, row {i}: {:?} is not positive definite", &covariances[i])
                    })?;
                gaussians.push(gaussian([means[i][0], means[i][1]], scale, rotation, &colors[i]));
            }
        }
        let [width, height] = given.size(whole(arrays, "size")?)?;
        let blend = given.blend(text(arrays, "blend")?.map(blend_of).transpose()?)?;
        let mut background = [0.0; 4];
        if let Some(values) = numbers(arrays, "background")? {
            if values.len() != count {
                return Err(format!("background has {} channels, colors have {}", values.len(), count).into());
            }
            values.iter().zip(&mut background).for_each(|(v, b)| *b = *v as f32);
        }
        let depth = whole(arrays, "depth")?.map(|[bits]: [u32; 1]| depth_of(bits)).transpose()?.unwrap_or(Depth::Eight);
        let layout = text(arrays, "layout")?.map(layout_of).transpose()?;
        let steps = numbers(arrays, "steps")?.map(steps_of).transpose()?;
        let picture = Gaussians { width, height, channels, depth, blend, background, list: gaussians };
        Ok(Parameters { picture, stored: layout.zip(steps) })
    }
}

/// Returns a Gaussian from values in double precision.
pub fn gaussian(mean: [f64; 2], scale: [f64; 2], rotation: f64, color: &[f64]) -> Gaussian {
    let mut g = Gaussian {
        mean: mean.map(|v| v as f32),
        scale: scale.map(|v| v as f32),
        rotation: rotation as f32,
        color: [0.0; 4],
    };
    color.iter().zip(&mut g.color).for_each(|(v, c)| *c = *v as f32);
    g
}

/// Returns the covariance `[xx, xy, yy]` in pixels².
pub fn covariance(g: &Gaussian) -> [f32; 3] {
    let ([a, b], (sin, cos)) = (g.scale.map(|s| s * s), g.rotation.sin_cos());
    [a * cos * cos + b * sin * sin, (a - b) * sin * cos, a * sin * sin + b * cos * cos]
}

/// Returns the scales, the larger first, and the rotation of the larger, of a covariance `[xx, xy, yy]`; `None` if it
/// is not positive definite.
pub fn of_covariance([xx, xy, yy]: [f64; 3]) -> Option<([f64; 2], f64)> {
    let (middle, half) = (0.5 * (xx + yy), (0.5 * (xx - yy)).hypot(xy));
    // The smaller root comes from the product, because the difference cancels for thin Gaussians.
    let large = middle + half;
    let small = (xx * yy - xy * xy) / large;
    let rotation = (0.5 * (2.0 * xy).atan2(xx - yy)).rem_euclid(std::f64::consts::PI);
    (large.is_finite() && small > 0.0).then(|| ([large.sqrt(), small.sqrt()], rotation))
}

/// Puts the larger scale first, and its rotation into `0..π`.
pub fn ordered(scale: [f64; 2], rotation: f64) -> ([f64; 2], f64) {
    let [a, b] = scale;
    let turned = if a < b { ([b, a], rotation + std::f64::consts::FRAC_PI_2) } else { (scale, rotation) };
    (turned.0, turned.1.rem_euclid(std::f64::consts::PI))
}

/// Refuses arrays with another length than the means.
pub fn same_length(means: usize, others: &[(&str, usize)]) -> Result<(), Problem> {
    match others.iter().find(|o| o.1 != means) {
        Some((name, length)) => Err(format!("there are {means} means but {length} {name}").into()),
        None => Ok(()),
    }
}

/// The numbers of an array, in rows.
pub struct Rows<'a> {
    values: &'a [f64],
    /// Number of elements of a row.
    pub width: usize,
}

impl<'a> Rows<'a> {
    pub fn len(&self) -> usize {
        self.values.len() / self.width
    }

    pub fn iter(&self) -> impl Iterator<Item = &'a [f64]> {
        self.values.chunks_exact(self.width)
    }
}

impl Index<usize> for Rows<'_> {
    type Output = [f64];

    fn index(&self, row: usize) -> &[f64] {
        &self.values[row * self.width..(row + 1) * self.width]
    }
}

/// Returns the numbers of an array, all finite, in rows of `width` numbers, or of its own width if that is `None`.
pub fn rows<'a>(arrays: &'a BTreeMap<String, Array>, name: &str, width: Option<usize>) -> Result<Rows<'a>, Problem> {
    let array = arrays.get(name).ok_or_else(|| format!("there is no array {name}"))?;
    let Values::Numbers(values) = &array.values else { return Err(format!("array {name} is a text").into()) };
    // An array without rows may state any length of a row.
    let each = array.shape.iter().skip(1).try_fold(1usize, |n, &side| n.checked_mul(side)).unwrap_or(0);
    if array.shape.is_empty() || width.is_some_and(|w| w != each) || each == 0 {
        return Err(format!("array {name} has the shape {:?}", array.shape).into());
    }
    match values.iter().position(|v| !v.is_finite()) {
        Some(at) => Err(format!("array {name}, row {}: {} is not finite", at / each, values[at]).into()),
        None => Ok(Rows { values, width: each }),
    }
}

/// Returns the numbers of a small array.
fn numbers<'a>(arrays: &'a BTreeMap<String, Array>, name: &str) -> Result<Option<&'a [f64]>, Problem> {
    match arrays.get(name).map(|a| &a.values) {
        None => Ok(None),
        Some(Values::Numbers(values)) if values.len() > MOST_NUMBERS => {
            Err(format!("array {name} has {} elements", values.len()).into())
        }
        Some(Values::Numbers(values)) => Ok(Some(values)),
        Some(Values::Text(text)) => Err(format!("array {name} is a text: {}", shown(text)).into()),
    }
}

fn text<'a>(arrays: &'a BTreeMap<String, Array>, name: &str) -> Result<Option<&'a str>, Problem> {
    match arrays.get(name).map(|a| &a.values) {
        None => Ok(None),
        Some(Values::Text(text)) => Ok(Some(text)),
        Some(Values::Numbers(values)) => Err(format!("array {name} has {} numbers, no text", values.len()).into()),
    }
}

/// Returns an array of whole numbers.
fn whole<const N: usize>(arrays: &BTreeMap<String, Array>, name: &str) -> Result<Option<[u32; N]>, Problem> {
    let Some(values) = numbers(arrays, name)? else { return Ok(None) };
    let whole: Option<Vec<u32>> = values
        .iter()
        .map(|&v| (v >= 0.0 && v <= f64::from(u32::MAX) && v.fract() == 0.0).then_some(v as u32))
        .collect();
    let found = whole.and_then(|w| w.try_into().ok());
    found.map(Some).ok_or_else(|| format!("array {name} is {values:?}, not {N} whole numbers").into())
}

/// Parses `WxH`.
pub fn size(text: &str) -> Result<[u32; 2], String> {
    let sides = text.split_once(['x', 'X']).and_then(|(w, h)| Some([w.trim().parse().ok()?, h.trim().parse().ok()?]));
    let most = Limits::default();
    let sound = |s: &[u32; 2]| (1..=most.width).contains(&s[0]) && (1..=most.height).contains(&s[1]);
    let problem = || format!("size is {}, not WxH in pixels, 1 to {} each", shown(text), most.width);
    sides.filter(sound).ok_or_else(problem)
}

pub fn blend_of(name: &str) -> Result<Blend, Problem> {
    names::blend_of(name).ok_or_else(|| format!("blend is {}, not normalized or sum", shown(name)).into())
}

pub fn layout_of(name: &str) -> Result<Layout, Problem> {
    names::layout_of(name).ok_or_else(|| format!("layout is {}, not packed, planes or coded", shown(name)).into())
}

pub fn depth_of(bits: u32) -> Result<Depth, Problem> {
    match bits {
        8 => Ok(Depth::Eight),
        16 => Ok(Depth::Sixteen),
        _ => Err(format!("depth is {bits}, not 8 or 16").into()),
    }
}

/// Returns the steps from numbers in the order of their fields.
pub fn numbers_of(steps: &Steps) -> [i32; 7] {
    let Steps { scale, angle, position, coarsest, range, luma, chroma } = *steps;
    [scale.into(), angle.into(), position.into(), coarsest.into(), range.into(), luma.into(), chroma.into()]
}

pub fn steps_of(values: &[f64]) -> Result<Steps, Problem> {
    let bad = || Problem::from(format!("steps are {values:?}, not seven small whole numbers"));
    let small: Option<Vec<i8>> =
        values.iter().map(|&v| (v.abs() < 100.0 && v.fract() == 0.0).then_some(v as i8)).collect();
    let [scale, angle, position, coarsest, range, luma, chroma]: [i8; 7] =
        small.and_then(|s| s.try_into().ok()).ok_or_else(bad)?;
    let unsigned = |v: i8| u8::try_from(v).map_err(|_| bad());
    Ok(Steps {
        scale: unsigned(scale)?,
        angle: unsigned(angle)?,
        position: unsigned(position)?,
        coarsest,
        range: unsigned(range)?,
        luma: unsigned(luma)?,
        chroma: unsigned(chroma)?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_of_no_length_that_can_be_are_refused() {
        for shape in [vec![0, usize::MAX, 3], vec![0, 1 << (usize::BITS / 2), 1 << (usize::BITS / 2)], vec![0, 0]] {
            let array = Array { shape, values: Values::Numbers(Vec::new()) };
            let arrays = BTreeMap::from([("colors".to_owned(), array)]);
            assert!(rows(&arrays, "colors", None).is_err());
        }
    }

    #[test]
    fn scales_and_rotation_come_back_from_their_covariance() {
        for (scale, rotation) in [([5.0, 1.0], 0.3), ([300.0, 0.3], 2.9), ([2.0, 1.9], 1.5), ([7.0, 7.0], 0.0)] {
            let g = gaussian([0.0, 0.0], scale, rotation, &[]);
            let (found, turned) = of_covariance(covariance(&g).map(f64::from)).unwrap();
            // The covariance is in single precision, in which the smaller scale of a thin Gaussian is a small
            // difference.
            let tolerance = 1e-6 * (scale[0] / scale[1]).powi(2);
            assert!((found[0] / scale[0] - 1.0).abs() < 1e-5, "{found:?} {scale:?}");
            assert!((found[1] / scale[1] - 1.0).abs() < tolerance + 1e-5, "{found:?} {scale:?}");
            assert!((turned - rotation).abs() < 1e-4, "{turned} {rotation}");
        }
    }

    #[test]
    fn the_longer_axis_comes_first_and_keeps_its_direction() {
        let (scale, rotation) = ordered([1.0, 4.0], -0.2);
        assert_eq!(scale, [4.0, 1.0]);
        assert!((rotation - (std::f64::consts::FRAC_PI_2 - 0.2)).abs() < 1e-12);
    }
}
