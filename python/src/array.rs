//! NumPy arrays to pixels and back: rows × columns, or rows × columns × channels.

use numpy::{IntoPyArray, PyArrayMethods, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::prelude::*;
use ssplat::{Channels, Pixels, Samples};

use crate::failure::{exception, parameter};

/// The picture of a contiguous array of 8 or 16 bits; its samples are copied.
pub fn pixels(name: &'static str, array: &Bound<'_, PyAny>) -> PyResult<Pixels> {
    let (shape, samples) = if let Ok(a) = array.extract::<PyReadonlyArrayDyn<'_, u8>>() {
        (a.shape().to_vec(), a.as_slice().map(|s| Samples::U8(s.to_vec())))
    } else if let Ok(a) = array.extract::<PyReadonlyArrayDyn<'_, u16>>() {
        (a.shape().to_vec(), a.as_slice().map(|s| Samples::U16(s.to_vec())))
    } else {
        return Err(parameter(name, "an array of uint8 or uint16 in native byte order is needed"));
    };
    let samples = samples.map_err(|e| parameter(name, e.to_string()))?;
    let channels = match shape[..] {
        [_, _] => Some(Channels::Grey),
        [_, _, n] => Channels::from_count(n),
        _ => None,
    };
    let channels = channels.ok_or_else(|| {
        parameter(name, format!("shape {shape:?} is neither (height, width) nor (height, width, 1 to 4)"))
    })?;
    let side = |v: usize| u32::try_from(v).unwrap_or(u32::MAX);
    Pixels::new(side(shape[1]), side(shape[0]), channels, samples).map_err(exception)
}

/// The array that takes the samples over: rows × columns for grey, else rows × columns × channels.
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
