//! Pictures of the `image` crate as sources of the encoder: `Encoder::encode(&picture)`.

use image::{DynamicImage, GenericImageView};

use crate::error::Result;
use crate::gaussian::Channels;
use crate::pixel_source::{PixelSource, check_area};
use crate::pixels::{Depth, Pixels};
use crate::rect::Rect;

/// Samples in `f32` are read with 16 bits, as by [`Pixels::try_from`].
impl PixelSource for DynamicImage {
    fn width(&self) -> u32 {
        self.dimensions().0
    }

    fn height(&self) -> u32 {
        self.dimensions().1
    }

    fn channels(&self) -> Channels {
        Channels::from_count(self.color().channel_count().into()).expect("one to four channels")
    }

    fn depth(&self) -> Depth {
        if self.color().bytes_per_pixel() > self.color().channel_count() { Depth::Sixteen } else { Depth::Eight }
    }

    fn part(&self, area: Rect) -> Result<Pixels> {
        let [width, height] = self.size();
        if area == Rect::new(0, 0, width, height) {
            return Pixels::try_from(self);
        }
        check_area(area, [width, height])?;
        let Rect { x, y, width, height } = area;
        Pixels::try_from(self.crop_imm(x, y, width, height))
    }
}
