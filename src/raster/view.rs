//! Which part of the plane is drawn, and how finely.

use crate::error::{Error, Result};
use crate::gaussian::Picture;

/// Longest side of a view, output pixels.
pub(super) const MAX_SIDE: u32 = 1 << 20;

/// A rectangle of output pixels on a grid laid over the picture.
///
/// Pixel `(i, j)` of the view is pixel `offset + (i, j)` of the grid and samples the picture at
/// `origin + (offset + (i, j) + ½) · step`. Views that share a grid (those made by [`View::crop`]) give the same
/// bits wherever they overlap.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    pub(super) origin: [f64; 2],
    pub(super) step: [f64; 2],
    pub(super) offset: [u32; 2],
    pub(super) width: u32,
    pub(super) height: u32,
}

impl View {
    /// The whole picture, one output pixel for each of its own.
    #[must_use]
    pub fn full(picture: &Picture) -> Self {
        View::of_size(picture.width, picture.height)
    }

    /// The whole of a picture of `width × height` pixels, one output pixel for each of its own.
    #[must_use]
    pub fn of_size(width: u32, height: u32) -> Self {
        View { origin: [0.0; 2], step: [1.0; 2], offset: [0; 2], width, height }
    }

    /// The rectangle of `width × height` output pixels whose first one is `(x, y)` of this view.
    ///
    /// # Errors
    /// [`Error::Parameter`] when the rectangle is empty or reaches beyond this view.
    pub fn crop(&self, x: u32, y: u32, width: u32, height: u32) -> Result<Self> {
        for (name, start, length, side) in [("width", x, width, self.width), ("height", y, height, self.height)] {
            if length == 0 || u64::from(start) + u64::from(length) > u64::from(side) {
                return Err(Error::Parameter { name, problem: format!("{start}+{length} is empty or beyond {side}") });
            }
        }
        Ok(View { offset: [self.offset[0] + x, self.offset[1] + y], width, height, ..*self })
    }

    /// The same area of the plane drawn at `width × height` output pixels.
    ///
    /// Enlarging samples the continuous picture; reducing filters it, so that fine detail does not alias.
    ///
    /// # Errors
    /// [`Error::Parameter`] when a side is 0 or over 2²⁰.
    pub fn resized(&self, width: u32, height: u32) -> Result<Self> {
        for (name, side) in [("width", width), ("height", height)] {
            if side == 0 || side > MAX_SIDE {
                return Err(Error::Parameter { name, problem: format!("{side} is outside 1..={MAX_SIDE}") });
            }
        }
        let origin = std::array::from_fn(|k| self.origin[k] + f64::from(self.offset[k]) * self.step[k]);
        let step = [
            self.step[0] * f64::from(self.width) / f64::from(width),
            self.step[1] * f64::from(self.height) / f64::from(height),
        ];
        Ok(View { origin, step, offset: [0; 2], width, height })
    }

    /// Width, output pixels.
    #[must_use]
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Height, output pixels.
    #[must_use]
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Picture pixels for each output pixel, along x and y; above 1 the view is reduced.
    #[must_use]
    pub fn step(&self) -> [f64; 2] {
        self.step
    }

    /// Where in the picture, in pixels, the centre of output pixel `(i, j)` lies.
    #[must_use]
    pub fn position(&self, i: u32, j: u32) -> [f64; 2] {
        let index = [i, j];
        std::array::from_fn(|k| self.origin[k] + (f64::from(self.offset[k]) + f64::from(index[k]) + 0.5) * self.step[k])
    }
}
