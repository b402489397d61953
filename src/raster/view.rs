//! Views: the area to render, and the size of the output.

use crate::error::{Error, Result};
use crate::gaussian::CUTOFF;
use crate::options::Layers;
use crate::parameter::Parameter;
use crate::rect::Rect;

/// Maximum side of a view, output pixels.
pub(super) const MAX_SIDE: u32 = 1 << 20;

/// Spacing of samples, in picture pixels, that a reduced view stays below if possible. At a spacing of 2, samples
/// would see only one phase of detail with the finest period, 2 pixels.
const MAX_SPACING: f64 = 1.5;

/// Maximum number of samples per output pixel along an axis. The kernel averages within its strips of eight columns.
const MAX_PARTS: u32 = 8;

/// Low-pass filter of a view.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Filter {
    /// Samples that are averaged to an output pixel, along x and y: 1, 2, 4 or 8.
    pub parts: [u32; 2],
    /// Increase of the Gaussians' variances along x and y, in squared picture pixels.
    pub variance: [f64; 2],
}

/// What to render: an area of the picture, the size of the output, and the layers of the file.
///
/// A view is a rectangle of output pixels on a grid over the picture. Pixel `(i, j)` of the view is pixel `offset + (i,
/// j)` of the grid and samples the picture at `origin + (offset + (i, j) + ½) · step`. Views that share a grid (those
/// made by [`View::crop`]) give the same bits wherever they overlap.
#[derive(Debug, Clone, Copy, PartialEq)]
#[doc(alias("region", "viewport"))]
pub struct View {
    pub(super) origin: [f64; 2],
    pub(super) step: [f64; 2],
    pub(super) offset: [u32; 2],
    pub(super) width: u32,
    pub(super) height: u32,
    pub(super) layers: Layers,
}

impl View {
    /// Returns the view of a whole picture of `width × height` pixels at its own size.
    #[must_use]
    pub fn new(width: u32, height: u32) -> Self {
        View { origin: [0.0; 2], step: [1.0; 2], offset: [0; 2], width, height, layers: Layers::Both }
    }

    /// Returns a part of this view, in output pixels of this view. Its pixels have the same bits as in this view.
    ///
    /// # Errors
    /// [`Error::Parameter`] naming `region` if it is empty or not within this view.
    #[doc(alias("region", "part"))]
    pub fn crop(&self, region: Rect) -> Result<Self> {
        region.check(Parameter::Region, [self.width, self.height])?;
        let Rect { x, y, width, height } = region;
        Ok(View { offset: [self.offset[0] + x, self.offset[1] + y], width, height, ..*self })
    }

    /// Returns a view of the same area with `width × height` output pixels.
    ///
    /// Enlarging samples the continuous picture. Reducing applies a low-pass filter, so that fine detail does not
    /// alias. An output pixel that is `step` picture pixels wide is the mean of `k` adjacent samples, each clamped to
    /// `0..=1`. `k` is the smallest of 1, 2, 4 and 8 with `step / k ≤ 1.5`, else 8, for each axis separately. If the
    /// samples are then still more than one picture pixel apart, the Gaussians' variance along the axis grows by
    /// `((step / k)² − 1) / 12`, the variance of the pixels that each sample represents, and their integral is
    /// preserved. Halves, quarters and eighths are the means of the full view's pixels, except where a detail layer
    /// would exceed black or white. In a picture with alpha, colours are weighted by their alpha in the mean, so that
    /// colours under alpha 0 do not become visible (spec §5.5). The work per output pixel is at most that of `8 × 8`
    /// pixels.
    ///
    /// # Errors
    /// [`Error::Parameter`] if a side is 0 or over 2²⁰.
    #[doc(alias("resize", "scale", "zoom", "downscale"))]
    pub fn resized(&self, width: u32, height: u32) -> Result<Self> {
        for (parameter, side) in [(Parameter::Width, width), (Parameter::Height, height)] {
            if side == 0 || side > MAX_SIDE {
                return Err(Error::Parameter { parameter, problem: format!("{side} is outside 1..={MAX_SIDE}") });
            }
        }
        let origin = std::array::from_fn(|k| self.origin[k] + f64::from(self.offset[k]) * self.step[k]);
        let step = [
            self.step[0] * f64::from(self.width) / f64::from(width),
            self.step[1] * f64::from(self.height) / f64::from(height),
        ];
        Ok(View { origin, step, offset: [0; 2], width, height, ..*self })
    }

    /// Returns a view of the same area at the largest size that fits into `within` (width and height in output
    /// pixels), keeping the aspect ratio. It is never larger than this view. Each side is at least one pixel.
    ///
    /// # Errors
    /// [`Error::Parameter`] if a side of `within` is 0.
    #[doc(alias("thumbnail", "preview"))]
    pub fn fitted(&self, within: [u32; 2]) -> Result<Self> {
        for (parameter, side) in [(Parameter::Width, within[0]), (Parameter::Height, within[1])] {
            if side == 0 {
                return Err(Error::Parameter { parameter, problem: "0 pixels are too few".into() });
            }
        }
        let sides = [self.width, self.height];
        let scale = (0..2).map(|k| f64::from(within[k]) / f64::from(sides[k])).fold(1.0, f64::min);
        let [width, height] = sides.map(|side| ((f64::from(side) * scale).round() as u32).max(1));
        self.resized(width, height)
    }

    /// Sets the layers to render. The default is [`Layers::Both`]. [`Reader::read_for`](crate::Reader::read_for) reads
    /// only these layers.
    #[must_use]
    pub fn layers(self, layers: Layers) -> Self {
        View { layers, ..self }
    }

    /// Returns the layers to render.
    pub(crate) fn shown(&self) -> Layers {
        self.layers
    }

    /// Returns the width, output pixels.
    #[must_use]
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Returns the height, output pixels.
    #[must_use]
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Returns the number of picture pixels per output pixel along x and y. The view is reduced where it is above 1.
    #[must_use]
    #[doc(alias = "scale")]
    pub fn step(&self) -> [f64; 2] {
        self.step
    }

    /// Returns the area, in picture pixels, that a Gaussian's support must reach to be visible in this view. It is
    /// larger than the view where the low-pass filter widens Gaussians.
    #[must_use]
    pub fn area(&self) -> Rect {
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
        Rect::new(x[0], y[0], x[1], y[1])
    }

    /// Returns the low-pass filter for the step. Crops have the filter of their view.
    pub(crate) fn filter(&self) -> Filter {
        let parts = self.step.map(|step| {
            let mut parts = 1;
            while parts < MAX_PARTS && step > MAX_SPACING * f64::from(parts) {
                parts *= 2;
            }
            parts
        });
        let variance = std::array::from_fn(|k| ((self.step[k] / f64::from(parts[k])).powi(2) - 1.0).max(0.0) / 12.0);
        Filter { parts, variance }
    }

    /// Returns the same area on a finer grid, with `parts` pixels per pixel along x and y.
    pub(crate) fn refined(&self, parts: [u32; 2]) -> View {
        View {
            origin: self.origin,
            step: std::array::from_fn(|k| self.step[k] / f64::from(parts[k])),
            // Steps other than 1 come from `resized`, whose grids end at `MAX_SIDE`.
            offset: std::array::from_fn(|k| self.offset[k] * parts[k]),
            width: self.width * parts[0],
            height: self.height * parts[1],
            layers: self.layers,
        }
    }

    /// Returns the position of the centre of output pixel `(i, j)`, in picture pixels.
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
            let found = View::new(sides[0], sides[1]).fitted(within).unwrap();
            assert_eq!([found.width(), found.height()], size, "{sides:?} in {within:?}");
        }
        assert!(View::new(3, 3).fitted([3, 0]).is_err());
    }
}
