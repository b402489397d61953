//! Which part of the plane is drawn, and how finely.

use crate::error::{Error, Result};
use crate::gaussian::{CUTOFF, Picture};

/// Longest side of a view, output pixels.
pub(super) const MAX_SIDE: u32 = 1 << 20;

/// Distance of samples that a reducing view goes below if it can, picture pixels. A lattice of 2 would see one phase
/// only of detail of the finest period, 2 pixels.
const SAMPLING: f64 = 1.5;

/// Most samples of an output pixel along an axis: the kernel averages within its strips of eight columns.
const MOST_PARTS: u32 = 8;

/// How a view is low-passed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Filter {
    /// Samples of which an output pixel is the mean, along x and y: 1, 2, 4 or 8.
    pub parts: [u32; 2],
    /// What the Gaussians' variances grow by along x and y, picture pixels².
    pub variance: [f64; 2],
}

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
    /// Enlarging samples the continuous picture. Reducing low-passes it, so that fine detail does not alias: an output
    /// pixel that is `step` picture pixels wide is the mean of `k` samples (clamped to 0..=1) side by side, `k` being
    /// the smallest of 1, 2, 4 and 8 with `step / k ≤ 1.5`, else 8. Where that leaves samples more than one picture
    /// pixel apart, the Gaussians' variance along the axis grows by `((step / k)² − 1) / 12`, their integral being kept:
    /// the variance of the pixels that each sample stands for. Either axis has its own `k`. Halves, quarters and eighths
    /// are the averages of the full view's pixels, but for what a detail layer would add beyond black or white. In a picture with alpha colours count by their alpha in the mean, so that
    /// what hides under alpha 0 shows nowhere (spec §5.5). The work is at most that of `8 × 8` times the output pixels.
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

    /// The same area of the plane as large as it fits into `within`, width and height in output pixels, and never larger than it
    /// is. Sides that would vanish keep a pixel.
    ///
    /// # Errors
    /// [`Error::Parameter`] when a side of `within` is 0.
    pub fn fitted(&self, within: [u32; 2]) -> Result<Self> {
        for (name, side) in [("width", within[0]), ("height", within[1])] {
            if side == 0 {
                return Err(Error::Parameter { name, problem: "0 pixels are too few".into() });
            }
        }
        let sides = [self.width, self.height];
        let scale = (0..2).map(|k| f64::from(within[k]) / f64::from(sides[k])).fold(1.0, f64::min);
        let [width, height] = sides.map(|side| ((f64::from(side) * scale).round() as u32).max(1));
        self.resized(width, height)
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

    /// Left, top, width and height of the part of the picture, in its pixels, that a Gaussian's support must reach into to
    /// be seen: more than what the view shows where the low-pass widens Gaussians.
    #[must_use]
    pub fn area(&self) -> [u32; 4] {
        let Filter { variance, .. } = self.filter();
        let side = [self.width, self.height];
        let [x, y] = std::array::from_fn(|k| {
            let margin = f64::from(CUTOFF) * variance[k].sqrt();
            let start = self.origin[k] + f64::from(self.offset[k]) * self.step[k];
            let end = start + f64::from(side[k]) * self.step[k] + margin;
            // Casts saturate.
            let start = (start - margin).floor() as u32;
            [start, end.ceil() as u32 - start]
        });
        [x[0], y[0], x[1], y[1]]
    }

    /// The low-pass that the step asks for; crops have that of their view.
    pub(crate) fn filter(&self) -> Filter {
        let parts = self.step.map(|step| {
            let mut parts = 1;
            while parts < MOST_PARTS && step > SAMPLING * f64::from(parts) {
                parts *= 2;
            }
            parts
        });
        let variance = std::array::from_fn(|k| ((self.step[k] / f64::from(parts[k])).powi(2) - 1.0).max(0.0) / 12.0);
        Filter { parts, variance }
    }

    /// The same area with `parts` pixels for each along x and y, on the grid that is finer in the same way.
    pub(crate) fn refined(&self, parts: [u32; 2]) -> View {
        View {
            origin: self.origin,
            step: std::array::from_fn(|k| self.step[k] / f64::from(parts[k])),
            // Steps other than 1 come from `resized`, whose grids end at `MAX_SIDE`.
            offset: std::array::from_fn(|k| self.offset[k] * parts[k]),
            width: self.width * parts[0],
            height: self.height * parts[1],
        }
    }

    /// Where in the picture, in pixels, the centre of output pixel `(i, j)` lies.
    #[must_use]
    pub fn position(&self, i: u32, j: u32) -> [f64; 2] {
        let index = [i, j];
        std::array::from_fn(|k| self.origin[k] + (f64::from(self.offset[k]) + f64::from(index[k]) + 0.5) * self.step[k])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fitted_views_keep_the_aspect_ratio_and_grow_no_larger() {
        for (sides, within, size) in [
            ([6000, 4000], [256, 256], [256, 171]),
            ([4000, 6000], [256, 256], [171, 256]),
            ([100, 50], [256, 256], [100, 50]),
            ([1 << 20, 1], [256, 256], [256, 1]),
            ([300, 200], [100, 10], [15, 10]),
        ] {
            let found = View::of_size(sides[0], sides[1]).fitted(within).unwrap();
            assert_eq!([found.width(), found.height()], size, "{sides:?} in {within:?}");
        }
        assert!(View::of_size(3, 3).fitted([3, 0]).is_err());
    }
}
