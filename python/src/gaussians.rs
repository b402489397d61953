//! The primitives of a file as arrays, and arrays of anyone's primitives as a file.

use numpy::{IntoPyArray, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use pyo3::pybacked::PyBackedBytes;
use pyo3::types::{PyBytes, PyDict};
use ssplat::bitstream::lattice::Lattice;
use ssplat::bitstream::splats::{Layout, Metadata, PackedSplats, Steps};
use ssplat::{Channels, Depth, Error, Gaussian, Limits, Result, bitstream};

use crate::failure::{exception, integer, parameter};
use crate::{info, names, work};

/// Steps from fine to coarse: scale, angle, position, luma and chroma of [`Steps`].
const LADDER: [[u8; 5]; 9] = [
    [0, 0, 12, 0, 0],
    [1, 0, 10, 2, 0],
    [2, 1, 8, 4, 1],
    [3, 1, 7, 5, 1],
    [4, 1, 7, 6, 1],
    [4, 1, 6, 6, 1],
    [5, 1, 5, 6, 1],
    [7, 1, 4, 7, 2],
    [9, 2, 3, 8, 2],
];

/// The rung for whoever asks for no size: what the encoder gives its best pictures.
const USUAL: usize = 2;

/// Most primitives of a file.
const MOST: usize = 16 << 20;

/// The primitives of `data`, level by level, and all that [`from_gaussians`] takes.
#[pyfunction]
pub fn gaussians<'py>(py: Python<'py>, data: PyBackedBytes) -> PyResult<Bound<'py, PyDict>> {
    let (splats, floats) = work::run(py, 1, None, move |_| {
        let splats = bitstream::read(&data[..], &Limits::default())?;
        let floats = Floats::of(&splats);
        Ok((splats, floats))
    })?;
    let (n, c) = (splats.gaussians.len(), splats.channels.count());
    let background = splats.quantizer().dequantize_color(splats.background)[..c].to_vec();
    let d = PyDict::new(py);
    d.set_item("mean", floats.mean.into_pyarray(py).reshape([n, 2])?)?;
    d.set_item("scale", floats.scale.into_pyarray(py).reshape([n, 2])?)?;
    d.set_item("rotation", floats.rotation.into_pyarray(py))?;
    d.set_item("color", floats.color.into_pyarray(py).reshape([n, c])?)?;
    d.set_item("background", background.into_pyarray(py))?;
    d.set_item("width", splats.width)?;
    d.set_item("height", splats.height)?;
    d.set_item("bits", 8 * splats.depth.bytes())?;
    d.set_item("blend", names::word(&names::BLENDS, splats.blend))?;
    d.set_item("layout", names::word(&names::LAYOUTS, splats.layout))?;
    d.set_item("steps", info::steps(py, &splats.steps)?)?;
    Ok(d)
}

/// The fields of all primitives, one after the other.
#[derive(Default)]
struct Floats {
    mean: Vec<f32>,
    scale: Vec<f32>,
    rotation: Vec<f32>,
    color: Vec<f32>,
}

impl Floats {
    fn of(splats: &PackedSplats) -> Self {
        let (quantizer, channels) = (splats.quantizer(), splats.channels.count());
        let mut floats = Floats::default();
        for packed in &splats.gaussians {
            let g = quantizer.dequantize(packed);
            floats.mean.extend(g.mean);
            floats.scale.extend(g.scale);
            floats.rotation.push(g.rotation);
            floats.color.extend(&g.color[..channels]);
        }
        floats
    }
}

/// The options of `ssplat.from_gaussians`, all of them.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Options {
    width: i128,
    height: i128,
    bits: i128,
    blend: String,
    layout: String,
    background: Vec<f32>,
    bytes: Option<i128>,
    steps: Option<StepIndices>,
    icc_profile: Option<PyBackedBytes>,
    exif: Option<PyBackedBytes>,
}

/// [`Steps`] as a caller names them.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
struct StepIndices {
    scale: i128,
    angle: i128,
    position: i128,
    coarsest: i128,
    range: i128,
    luma: i128,
    chroma: i128,
}

impl StepIndices {
    fn parse(&self) -> PyResult<Steps> {
        Ok(Steps {
            scale: integer("steps", self.scale)?,
            angle: integer("steps", self.angle)?,
            position: integer("steps", self.position)?,
            coarsest: integer("steps", self.coarsest)?,
            range: integer("steps", self.range)?,
            luma: integer("steps", self.luma)?,
            chroma: integer("steps", self.chroma)?,
        })
    }
}

/// The file of primitives with means (n × 2, pixels), scales (n × 2, pixels), rotations (n, radians) and colours
/// (n × channels), all float32.
#[pyfunction]
pub fn from_gaussians<'py>(
    py: Python<'py>,
    mean: PyReadonlyArray2<'py, f32>,
    scale: PyReadonlyArray2<'py, f32>,
    rotation: PyReadonlyArray1<'py, f32>,
    color: PyReadonlyArray2<'py, f32>,
    options: Options,
) -> PyResult<Bound<'py, PyBytes>> {
    let (mean, scale, color) = (mean.as_array(), scale.as_array(), color.as_array());
    let (rotation, (n, c)) = (rotation.as_array(), color.dim());
    let channels = Channels::from_count(c).ok_or_else(|| parameter("color", format!("{c} channels are not 1 to 4")))?;
    for (name, shape) in [("mean", mean.dim()), ("scale", scale.dim()), ("rotation", (rotation.len(), 2))] {
        if shape != (n, 2) {
            return Err(parameter(name, format!("{} rows of {} where {n} colours are given", shape.0, shape.1)));
        }
    }
    if n > MOST {
        return Err(parameter("color", format!("{n} primitives are more than {MOST}")));
    }
    let gaussians = (0..n).map(|i| Gaussian {
        mean: [mean[[i, 0]], mean[[i, 1]]],
        scale: [scale[[i, 0]], scale[[i, 1]]],
        rotation: rotation[i],
        color: std::array::from_fn(|k| if k < c { color[[i, k]] } else { 0.0 }),
    });
    let job = Job::new(gaussians.collect(), channels, &options)?;
    let bytes = work::run(py, 1, None, move |_| job.run())?;
    Ok(PyBytes::new(py, &bytes))
}

/// What is rounded, and to what.
struct Job {
    gaussians: Vec<Gaussian>,
    background: [f32; 4],
    /// The file without primitives and steps.
    empty: PackedSplats,
    steps: Option<Steps>,
    bytes: Option<u64>,
}

impl Job {
    fn new(gaussians: Vec<Gaussian>, channels: Channels, o: &Options) -> PyResult<Self> {
        if o.background.len() != channels.count() || o.background.iter().any(|v| !v.is_finite()) {
            return Err(parameter("background", format!("{:?} is not a colour of {channels:?}", o.background)));
        }
        let depth = match o.bits {
            8 => Depth::Eight,
            16 => Depth::Sixteen,
            bits => return Err(parameter("bits", format!("{bits} is neither 8 nor 16"))),
        };
        let mut metadata = Metadata::default();
        metadata.icc = o.icc_profile.as_ref().map(|b| b.to_vec());
        metadata.exif = o.exif.as_ref().map(|b| b.to_vec());
        let steps = o.steps.as_ref().map(StepIndices::parse).transpose()?;
        let empty = PackedSplats {
            width: integer("width", o.width)?,
            height: integer("height", o.height)?,
            channels,
            depth,
            blend: names::value("blend", &names::BLENDS, &o.blend)?,
            layout: names::value("layout", &names::LAYOUTS, &o.layout)?,
            steps: steps.unwrap_or(Steps {
                scale: 0,
                angle: 0,
                position: 0,
                coarsest: 0,
                range: 0,
                luma: 0,
                chroma: 0,
            }),
            background: [0; 4],
            codebook: None,
            gaussians: Vec::new(),
            levels: Vec::new(),
            metadata,
        };
        // The sides and the steps are checked before anything is computed with them.
        bitstream::to_bytes(&empty).map_err(exception)?;
        let background = std::array::from_fn(|k| o.background.get(k).copied().unwrap_or(0.0));
        let bytes = o.bytes.map(|b| integer("bytes", b)).transpose()?;
        let job = Job { gaussians, background, empty, steps, bytes };
        job.check().map_err(exception)?;
        Ok(job)
    }

    /// Whether the format has a place for every primitive.
    fn check(&self) -> Result<()> {
        let size = [self.empty.width, self.empty.height];
        let quantizer = self.empty.quantizer();
        // A coarse step's last cell may have its centre outside the picture: with given steps, that is a place too.
        let ends = |g: &Gaussian| match self.steps {
            None => size.map(|side| side as f32),
            Some(_) => {
                let (major, minor, angle) = quantizer.quantize_shape(g.scale, g.rotation);
                let exponents = quantizer.lattice().exponents(major, minor, angle);
                std::array::from_fn(|k| Lattice::positions(size[k], exponents[k]) as f32 * (exponents[k] as f32).exp2())
            }
        };
        for (i, g) in self.gaussians.iter().enumerate() {
            let bad = |name, value: &[f32], what| {
                Err(Error::Parameter { name, problem: format!("{value:?} of primitive {i} {what}") })
            };
            if !g.scale.iter().all(|s| *s > 0.0 && s.is_finite()) {
                return bad("scale", &g.scale, "is not positive");
            }
            if !g.rotation.is_finite() {
                return bad("rotation", &[g.rotation], "is not finite");
            }
            if !g.color.iter().all(|v| v.is_finite()) {
                return bad("color", &g.color, "is not finite");
            }
            let ends = ends(g);
            if !(0..2).all(|k| (0.0..=ends[k]).contains(&g.mean[k])) {
                return bad("mean", &g.mean, "lies outside the picture");
            }
        }
        Ok(())
    }

    /// The file with the steps asked for, or with the finest that fit the size asked for.
    fn run(&self) -> Result<Vec<u8>> {
        let Some(most) = self.bytes else {
            return self.file(self.steps.unwrap_or_else(|| self.rung(USUAL)));
        };
        let rungs = match self.steps {
            Some(steps) => vec![steps],
            None => (0..LADDER.len()).map(|k| self.rung(k)).collect(),
        };
        let mut least = u64::MAX;
        for steps in rungs {
            let bytes = self.file(steps)?;
            if bytes.len() as u64 <= most {
                return Ok(bytes);
            }
            least = least.min(bytes.len() as u64);
        }
        let count = self.gaussians.len();
        let problem = format!("{most} cannot hold {count} primitives: {least} are needed with the coarsest steps");
        Err(Error::Parameter { name: "bytes", problem })
    }

    /// The steps of rung `k` for primitives of these sizes.
    fn rung(&self, k: usize) -> Steps {
        let [scale, angle, position, luma, chroma] = LADDER[k];
        let mut sizes: Vec<f32> = self.gaussians.iter().map(|g| g.scale[0].max(g.scale[1])).collect();
        sizes.sort_by(f32::total_cmp);
        // Logarithm to base 2 of the size that a share of the primitives stay below.
        let at = |share: f32| sizes.get((sizes.len() as f32 * share) as usize).copied().unwrap_or(1.0).log2();
        let (position, coarsest, range) = match self.empty.layout {
            // The steps follow each primitive's size, down from that of the largest.
            Layout::Coded => {
                let coarsest = (at(0.97) - f32::from(position) / 4.0).ceil().clamp(-2.0, 9.0) as i8;
                let finest = -4 - i8::try_from(USUAL.saturating_sub(k)).unwrap_or(0);
                (position, coarsest, (coarsest - finest).clamp(1, 15) as u8)
            }
            // One step for all: fine enough for the small ones.
            Layout::Planes | Layout::Packed => {
                let coarsest = at(0.25) - 2.5 + 0.5 * (k as f32 - USUAL as f32);
                (5, coarsest.round().clamp(-6.0, 6.0) as i8, 0)
            }
        };
        Steps { scale, angle, position, coarsest, range, luma, chroma }
    }

    /// The file with these steps, with a codebook of colours where that is shorter.
    fn file(&self, steps: Steps) -> Result<Vec<u8>> {
        let mut splats = PackedSplats { steps, ..self.empty.clone() };
        let quantizer = splats.quantizer();
        splats.background = quantizer.quantize_color(self.background);
        splats.gaussians = self.gaussians.iter().map(|g| quantizer.quantize(g)).collect();
        let direct = bitstream::to_bytes(&splats)?;
        let mut colors: Vec<_> = splats.gaussians.iter().map(|g| g.color).collect();
        colors.sort_unstable();
        colors.dedup();
        if colors.is_empty() || 3 * colors.len() > splats.gaussians.len() {
            return Ok(direct);
        }
        splats.codebook = Some(colors);
        let indexed = bitstream::to_bytes(&splats)?;
        Ok(if indexed.len() < direct.len() { indexed } else { direct })
    }
}
