//! A rectangular part of a picture.

use crate::error::{Error, Result};
use crate::parameter::Parameter;

/// A rectangle of whole pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[doc(alias("region", "area", "roi"))]
pub struct Rect {
    /// Left edge, pixels.
    pub x: u32,
    /// Top edge, pixels.
    pub y: u32,
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
}

impl Rect {
    /// Returns the rectangle of `width × height` pixels with its top left corner at `(x, y)`.
    #[must_use]
    pub const fn new(x: u32, y: u32, width: u32, height: u32) -> Self {
        Rect { x, y, width, height }
    }

    /// Returns the left and the top edge.
    pub(crate) fn corner(&self) -> [u32; 2] {
        [self.x, self.y]
    }

    /// Returns the width and the height.
    pub(crate) fn size(&self) -> [u32; 2] {
        [self.width, self.height]
    }

    /// Returns whether `other` lies completely within this rectangle.
    pub(crate) fn holds(&self, other: &Rect) -> bool {
        let end = |rect: &Rect, k: usize| u64::from(rect.corner()[k]) + u64::from(rect.size()[k]);
        (0..2).all(|k| self.corner()[k] <= other.corner()[k] && end(other, k) <= end(self, k))
    }

    /// Checks that the rectangle is not empty and lies within a picture of `size`.
    ///
    /// # Errors
    /// [`Error::Parameter`] naming `parameter` if it does not.
    pub(crate) fn check(&self, parameter: Parameter, size: [u32; 2]) -> Result<()> {
        let Rect { x, y, width, height } = *self;
        if width > 0 && height > 0 && Rect::new(0, 0, size[0], size[1]).holds(self) {
            return Ok(());
        }
        let problem = format!("{width} × {height} at {x}, {y} is not a part of a picture of {} × {}", size[0], size[1]);
        Err(Error::Parameter { parameter, problem })
    }
}

/// Left, top, width and height.
impl From<[u32; 4]> for Rect {
    fn from([x, y, width, height]: [u32; 4]) -> Self {
        Rect { x, y, width, height }
    }
}

/// Left, top, width and height.
impl From<Rect> for [u32; 4] {
    fn from(Rect { x, y, width, height }: Rect) -> Self {
        [x, y, width, height]
    }
}
