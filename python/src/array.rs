//! Conversion between pixels and NumPy arrays: rows × columns, or rows × columns × channels.

use numpy::{IntoPyArray, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PySlice;
use ssplat::{Channels, Depth, PixelSource, Pixels, Rect, Samples};

use crate::failure::{exception, parameter};

/// Longest side of a picture, pixels.
const MAX_SIDE: usize = 1 << 20;

/// Returns the picture of a contiguous array of 8 or 16 bits. Copies the samples.
pub fn pixels(name: &'static str, array: &Bound<'_, PyAny>) -> PyResult<Pixels> {
    // The shape is checked before the samples are copied.
    let (([width, height], channels), samples) = if let Ok(a) = array.extract::<PyReadonlyArrayDyn<'_, u8>>() {
        (form(name, a.shape())?, a.as_slice().map(|s| Samples::U8(s.to_vec())))
    } else if let Ok(a) = array.extract::<PyReadonlyArrayDyn<'_, u16>>() {
        (form(name, a.shape())?, a.as_slice().map(|s| Samples::U16(s.to_vec())))
    } else {
        return Err(parameter(name, "an array of uint8 or uint16 in native byte order is needed"));
    };
    let samples = samples.map_err(|e| parameter(name, e.to_string()))?;
    Pixels::new(width, height, channels, samples).map_err(exception)
}

/// Returns width, height and channels of an array of this shape, if a picture can have them.
fn form(name: &'static str, shape: &[usize]) -> PyResult<([u32; 2], Channels)> {
    let channels = match shape[..] {
        [_, _] => Some(Channels::Grey),
        [_, _, n] => Channels::from_count(n),
        _ => None,
    };
    let channels = channels.ok_or_else(|| {
        parameter(name, format!("shape {shape:?} is neither (height, width) nor (height, width, 1 to 4)"))
    })?;
    if let Some(side) = shape[..2].iter().find(|side| !(1..=MAX_SIDE).contains(*side)) {
        return Err(parameter(name, format!("shape {shape:?}: a side of {side} is outside 1..={MAX_SIDE}")));
    }
    Ok(([shape[1] as u32, shape[0] as u32], channels))
}

/// A memory map, which is read in parts.
pub struct Mapped {
    name: &'static str,
    array: Py<PyAny>,
    size: [u32; 2],
    channels: Channels,
    depth: Depth,
}

impl Mapped {
    /// Takes an array of 8 or 16 bits in native byte order.
    pub fn new(name: &'static str, array: &Bound<'_, PyAny>) -> PyResult<Self> {
        let (shape, depth) = if let Ok(a) = array.cast::<PyArrayDyn<u8>>() {
            (a.shape().to_vec(), Depth::Eight)
        } else if let Ok(a) = array.cast::<PyArrayDyn<u16>>() {
            (a.shape().to_vec(), Depth::Sixteen)
        } else {
            return Err(parameter(name, "an array of uint8 or uint16 in native byte order is needed"));
        };
        let (size, channels) = form(name, &shape)?;
        Ok(Mapped { name, array: array.clone().unbind(), size, channels, depth })
    }
}

impl PixelSource for Mapped {
    fn width(&self) -> u32 {
        self.size[0]
    }

    fn height(&self) -> u32 {
        self.size[1]
    }

    fn channels(&self) -> Channels {
        self.channels
    }

    fn depth(&self) -> Depth {
        self.depth
    }

    fn part(&self, area: Rect) -> ssplat::Result<Pixels> {
        ssplat::unstable::check_area(area, self.size)?;
        let [x, y, width, height] = <[u32; 4]>::from(area).map(|v| v as isize);
        let read = |py: Python<'_>| {
            let [rows, columns] = [(y, height), (x, width)].map(|(from, n)| PySlice::new(py, from, from + n, 1));
            let part = self.array.bind(py).get_item((rows, columns))?;
            pixels(self.name, &py.import("numpy")?.call_method1("ascontiguousarray", (part,))?)
        };
        Python::attach(|py| read(py).map_err(|e| ssplat::Error::Io(std::io::Error::other(e.to_string()))))
    }
}

/// Returns an array that takes ownership of the samples: rows × columns for grey, otherwise rows × columns × channels.
pub fn array<'py>(py: Python<'py>, pixels: Pixels) -> PyResult<Bound<'py, PyAny>> {
    let mut shape = vec![pixels.height() as usize, pixels.width() as usize];
    if pixels.channels() != Channels::Grey {
        shape.push(pixels.channels().count());
    }
    Ok(match pixels.into_samples() {
        Samples::U8(v) => v.into_pyarray(py).reshape(shape)?.into_any(),
        Samples::U16(v) => v.into_pyarray(py).reshape(shape)?.into_any(),
    })
}
