//! Conversion between files and arrays of Gaussians.

use std::collections::BTreeMap;

use numpy::{IntoPyArray, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use pyo3::pybacked::PyBackedBytes;
use pyo3::types::{PyBytes, PyDict};
use ssplat::unstable::bitstream::splats::Steps;
use ssplat::unstable::{EncodeOptions, Precision};
use ssplat::{Channels, Depth, Encoder, Gaussian, Gaussians, Layers, Reader, Target};

use crate::failure::{integer, parameter};
use crate::{carry, decode, info, names, work};

/// Returns the Gaussians of `data`, level by level, and the other arguments of [`from_gaussians`].
#[pyfunction]
#[pyo3(signature = (data, limits = None))]
pub fn gaussians<'py>(
    py: Python<'py>,
    data: PyBackedBytes,
    limits: Option<BTreeMap<String, i128>>,
) -> PyResult<Bound<'py, PyDict>> {
    let limits = decode::limits(limits.as_ref())?;
    let (opened, floats, background) = work::run(py, 1, &work::Calls::default(), move |_| {
        // The detail layer is not part of the result. Pixels are not needed, so the view has only one.
        let reader = Reader::new(&data, &limits)?;
        let view = reader.view().resized(1, 1)?.layers(Layers::Gaussians);
        let opened = reader.read_for(&view)?;
        let stored = opened.gaussians()?;
        Ok((opened, Floats::of(&stored), stored.background))
    })?;
    let splats = opened.splats();
    let (n, c) = (splats.gaussians.len(), splats.channels.count());
    let background = background[..c].to_vec();
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

/// The fields of all Gaussians, one after the other.
#[derive(Default)]
struct Floats {
    mean: Vec<f32>,
    scale: Vec<f32>,
    rotation: Vec<f32>,
    color: Vec<f32>,
}

impl Floats {
    fn of(stored: &Gaussians) -> Self {
        let channels = stored.channels.count();
        let mut floats = Floats::default();
        for g in &stored.list {
            floats.mean.extend(g.mean);
            floats.scale.extend(g.scale);
            floats.rotation.push(g.rotation);
            floats.color.extend(&g.color[..channels]);
        }
        floats
    }
}

/// All options of `ssplat.from_gaussians`.
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
    cicp: Option<[u8; 4]>,
    icc_profile: Option<PyBackedBytes>,
    exif: Option<PyBackedBytes>,
}

impl Options {
    fn picture(&self, gaussians: Vec<Gaussian>, channels: Channels) -> PyResult<Gaussians> {
        if self.background.len() != channels.count() {
            return Err(parameter("background", format!("{:?} is not a colour of {channels:?}", self.background)));
        }
        Ok(Gaussians {
            width: integer("width", self.width)?,
            height: integer("height", self.height)?,
            channels,
            depth: match self.bits {
                8 => Depth::Eight,
                16 => Depth::Sixteen,
                bits => return Err(parameter("bits", format!("{bits} is neither 8 nor 16"))),
            },
            blend: names::value("blend", &names::BLENDS, &self.blend)?,
            background: std::array::from_fn(|k| self.background.get(k).copied().unwrap_or(0.0)),
            list: gaussians,
        })
    }

    fn parse(&self) -> PyResult<EncodeOptions> {
        let mut o = EncodeOptions::default();
        o.precision = self.steps.as_ref().map(StepIndices::parse).transpose()?.map(Precision::Steps);
        if let Some(bytes) = self.bytes {
            o.target = Target::Bytes(integer("bytes", bytes)?);
        }
        o.layout = names::value("layout", &names::LAYOUTS, &self.layout)?;
        o.cicp = self.cicp.map(carry::code_points).transpose()?;
        o.icc = self.icc_profile.as_ref().map(|b| b.to_vec());
        o.exif = self.exif.as_ref().map(|b| b.to_vec());
        Ok(o)
    }
}

/// [`Steps`] under the names of the Python interface.
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

/// Returns the file of Gaussians with means (n × 2, pixels), scales (n × 2, pixels), rotations (n, radians) and
/// colours (n × channels), all float32: the order and the units of [`Gaussian`].
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
            return Err(parameter(name, format!("{} rows of {}, but there are {n} colours", shape.0, shape.1)));
        }
    }
    let gaussians = (0..n).map(|i| Gaussian {
        mean: [mean[[i, 0]], mean[[i, 1]]],
        scale: [scale[[i, 0]], scale[[i, 1]]],
        rotation: rotation[i],
        color: std::array::from_fn(|k| if k < c { color[[i, k]] } else { 0.0 }),
    });
    let picture = options.picture(gaussians.collect(), channels)?;
    let how = options.parse()?;
    let encoder = Encoder::from(how);
    let encoded = work::run(py, 1, &work::Calls::default(), move |_| encoder.encode_gaussians(&picture))?;
    Ok(PyBytes::new(py, &encoded.bytes))
}
