//! A rectangular part of a picture.

/// A rectangle of the picture, in its pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Area {
    /// Left and top, pixels.
    pub corner: [u32; 2],
    /// Width and height, pixels.
    pub size: [u32; 2],
}

impl Area {
    /// Returns whether `other` lies completely within this area.
    pub(crate) fn holds(&self, other: &Area) -> bool {
        let end = |area: &Area, k: usize| u64::from(area.corner[k]) + u64::from(area.size[k]);
        (0..2).all(|k| self.corner[k] <= other.corner[k] && end(other, k) <= end(self, k))
    }
}

impl From<[u32; 4]> for Area {
    /// Left, top, width and height.
    fn from([x, y, width, height]: [u32; 4]) -> Self {
        Area { corner: [x, y], size: [width, height] }
    }
}
