//! Where the screen lies over the picture, and which part of the picture is rendered at which size. Pixels only; no egui.

use ssplat::Rect;

/// Most screen pixels for a pixel of the picture.
const MAX_ZOOM: f64 = 64.0;

/// The point of the picture at the middle of the screen, and the number of screen pixels for a pixel of the picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Pixels of the picture.
    pub center: [f64; 2],
    /// Screen pixels for one pixel of the picture.
    pub zoom: f64,
}

impl Camera {
    /// Shows the whole picture; small pictures are not enlarged.
    pub fn whole(picture: [u32; 2], screen: [f64; 2]) -> Self {
        let [width, height] = picture.map(f64::from);
        Camera { center: [width / 2.0, height / 2.0], zoom: (screen[0] / width).min(screen[1] / height).min(1.0) }
    }

    /// Moves the picture by `by` screen pixels. The middle of the screen stays over the picture.
    pub fn pan(&mut self, picture: [u32; 2], by: [f64; 2]) {
        for axis in 0..2 {
            let side = f64::from(picture[axis]);
            self.center[axis] = (self.center[axis] - by[axis] / self.zoom).clamp(0.0, side);
        }
    }

    /// Zooms by `factor`; the point of the picture at `at`, in screen pixels from the middle of the screen, stays there.
    pub fn zoom(&mut self, picture: [u32; 2], factor: f64, at: [f64; 2]) {
        let least = 1.0 / f64::from(picture[0].max(picture[1]));
        let zoom = (self.zoom * factor).clamp(least, MAX_ZOOM);
        for axis in 0..2 {
            let moved = self.center[axis] + at[axis] / self.zoom - at[axis] / zoom;
            self.center[axis] = moved.clamp(0.0, f64::from(picture[axis]));
        }
        self.zoom = zoom;
    }
}

/// A part of the picture, rendered with 2^`level` texels for a pixel of the picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Part {
    /// Pixels of the picture.
    pub region: Rect,
    /// Binary logarithm of the scale.
    pub level: i32,
}

impl Part {
    /// Returns the part that a screen of `screen` pixels shows, extended by `margin` of its size on each side, or `None`
    /// if it shows nothing of the picture.
    ///
    /// The scale is the next power of two that is not below the zoom. A part can therefore be shown until the zoom has
    /// doubled or halved, and it has at most four times as many texels as the screen has pixels, apart from the margin.
    pub fn visible(picture: [u32; 2], camera: &Camera, screen: [f64; 2], margin: f64) -> Option<Self> {
        let [left, width] = visible_side(picture[0], camera, screen[0], margin, 0)?;
        let [top, height] = visible_side(picture[1], camera, screen[1], margin, 1)?;
        Some(Part { region: Rect::new(left, top, width, height), level: camera.zoom.log2().ceil() as i32 })
    }

    /// Returns the size at which the part is rendered, texels.
    pub fn size(&self) -> [u32; 2] {
        [self.region.width, self.region.height].map(|side| match self.level {
            0.. => side << self.level,
            _ => side.div_ceil(1 << -self.level),
        })
    }

    /// Returns whether a texture of this part shows all of `needed`, neither too coarsely nor much too finely.
    pub fn shows(&self, needed: &Part) -> bool {
        let (have, need) = (self.region, needed.region);
        self.level == needed.level
            && (have.x..=have.x + have.width).contains(&need.x)
            && (have.y..=have.y + have.height).contains(&need.y)
            && need.x + need.width <= have.x + have.width
            && need.y + need.height <= have.y + have.height
    }

    /// Returns the left, top, right and bottom edge of the part, in screen pixels from the middle of the screen.
    pub fn on_screen(&self, camera: &Camera) -> [f64; 4] {
        let Rect { x, y, width, height } = self.region;
        let at = |axis: usize, position: u32| (f64::from(position) - camera.center[axis]) * camera.zoom;
        [at(0, x), at(1, y), at(0, x + width), at(1, y + height)]
    }
}

/// Start and length of the visible part of one side of the picture, whole pixels.
fn visible_side(side: u32, camera: &Camera, screen: f64, margin: f64, axis: usize) -> Option<[u32; 2]> {
    let half = screen / camera.zoom * (0.5 + margin);
    let start = (camera.center[axis] - half).floor().clamp(0.0, f64::from(side));
    let end = (camera.center[axis] + half).ceil().clamp(0.0, f64::from(side));
    (start < end).then_some([start as u32, (end - start) as u32])
}
