//! Planes of AV1 to pixels: the range and the matrix of ITU-T H.273 (8.3), chroma enlarged bilinearly, and alpha.

use image::{DynamicImage, ImageBuffer, Pixel};
use re_rav1d::dav1d::pixel::YUVRange;
use re_rav1d::dav1d::{Picture, PixelLayout, PlanarImageComponent, Plane};

/// Why planes cannot be converted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Error {
    /// The pixels do not fit into memory.
    Memory,
    /// The number of a matrix that is not supported, or that does not go with the layout of the planes.
    Matrix(u8),
}

/// A picture as AV1 codes it.
pub struct Ycbcr {
    pub colors: Picture,
    /// Has the size and the depth of the colours; its luma is the alpha channel.
    pub alpha: Option<Picture>,
    /// By ITU-T H.273.
    pub matrix: u8,
    pub is_full_range: bool,
    /// Whether the colours are multiplied by alpha.
    pub is_premultiplied: bool,
}

/// Whether AV1 states the full range of code values.
pub fn is_full_range(picture: &Picture) -> bool {
    picture.color_range() == YUVRange::Full
}

impl Ycbcr {
    /// Converts the planes to grey or RGB, with or without alpha, of 8 bits if AV1 has 8, and of 16 otherwise.
    ///
    /// # Errors
    ///
    /// [`Error`].
    pub fn to_picture(&self) -> Result<DynamicImage, Error> {
        let is_grey = self.colors.pixel_layout() == PixelLayout::I400;
        let (byte, word) = (|v: f32| (v * 255.0 + 0.5) as u8, |v: f32| (v * 65535.0 + 0.5) as u16);
        Ok(match (is_grey, self.alpha.is_some(), self.colors.bit_depth() > 8) {
            (true, false, false) => DynamicImage::ImageLuma8(self.buffer(byte)?),
            (true, true, false) => DynamicImage::ImageLumaA8(self.buffer(byte)?),
            (false, false, false) => DynamicImage::ImageRgb8(self.buffer(byte)?),
            (false, true, false) => DynamicImage::ImageRgba8(self.buffer(byte)?),
            (true, false, true) => DynamicImage::ImageLuma16(self.buffer(word)?),
            (true, true, true) => DynamicImage::ImageLumaA16(self.buffer(word)?),
            (false, false, true) => DynamicImage::ImageRgb16(self.buffer(word)?),
            (false, true, true) => DynamicImage::ImageRgba16(self.buffer(word)?),
        })
    }

    /// Converts the planes; `sample` makes a sample of a number from 0 to 1.
    fn buffer<P: Pixel>(&self, sample: impl Fn(f32) -> P::Subpixel) -> Result<ImageBuffer<P, Vec<P::Subpixel>>, Error> {
        let (width, height) = (self.colors.width(), self.colors.height());
        let layout = self.colors.pixel_layout();
        let matrix = Matrix::of(self.matrix, layout)?;
        let luma = Samples::new(&self.colors, PlanarImageComponent::Y);
        let chroma = (layout != PixelLayout::I400)
            .then(|| [PlanarImageComponent::U, PlanarImageComponent::V].map(|plane| Samples::new(&self.colors, plane)));
        let alpha = self
            .alpha
            .as_ref()
            .map(|alpha| (Samples::new(alpha, PlanarImageComponent::Y), Range::of(alpha, is_full_range(alpha))));
        let range = Range::of(&self.colors, self.is_full_range);
        let columns = width as usize;
        let mut pixels = Vec::new();
        let count = columns * height as usize * usize::from(P::CHANNEL_COUNT);
        pixels.try_reserve_exact(count).map_err(|_| Error::Memory)?;
        let [mut y, mut u, mut v, mut a] = [(); 4].map(|()| vec![0.0; columns]);
        for row in 0..height as usize {
            luma.row(row, &mut y);
            if let Some([cb, cr]) = &chroma {
                cb.enlarged_row(row, layout, &mut u);
                cr.enlarged_row(row, layout, &mut v);
            }
            if let Some((alpha, range)) = &alpha {
                alpha.row(row, &mut a);
                a.iter_mut().for_each(|a| *a = range.luma(*a).clamp(0.0, 1.0));
            }
            for x in 0..columns {
                let mut colors = match matrix {
                    Matrix::Grey => [range.luma(y[x]); 3],
                    Matrix::Identity => [range.luma(v[x]), range.luma(y[x]), range.luma(u[x])],
                    Matrix::Ycgco => {
                        let (y, cg, co) = (range.luma(y[x]), range.chroma(u[x]), range.chroma(v[x]));
                        [y - cg + co, y + cg, y - cg - co]
                    }
                    Matrix::Weights { red, blue } => {
                        let (y, cb, cr) = (range.luma(y[x]), range.chroma(u[x]), range.chroma(v[x]));
                        let (r, b) = (y + 2.0 * (1.0 - red) * cr, y + 2.0 * (1.0 - blue) * cb);
                        [r, (y - red * r - blue * b) / (1.0 - red - blue), b]
                    }
                };
                if self.is_premultiplied {
                    colors = colors.map(|color| if a[x] > 0.0 { color / a[x] } else { 0.0 });
                }
                let colors = if matches!(matrix, Matrix::Grey) { &colors[..1] } else { &colors[..] };
                pixels.extend(colors.iter().map(|&color| sample(color.clamp(0.0, 1.0))));
                if alpha.is_some() {
                    pixels.push(sample(a[x]));
                }
            }
        }
        ImageBuffer::from_raw(width, height, pixels).ok_or(Error::Memory)
    }
}

/// How three planes become red, green and blue.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Matrix {
    Grey,
    /// The planes are green, blue and red.
    Identity,
    Ycgco,
    /// The weights of red and blue in luma.
    Weights {
        red: f32,
        blue: f32,
    },
}

impl Matrix {
    /// Returns the matrix of a number in ITU-T H.273. The unspecified one is that of BT.601, as in libavif.
    fn of(number: u8, layout: PixelLayout) -> Result<Self, Error> {
        let weights = |red, blue| Ok(Matrix::Weights { red, blue });
        match number {
            _ if layout == PixelLayout::I400 => Ok(Matrix::Grey),
            0 if layout == PixelLayout::I444 => Ok(Matrix::Identity),
            1 => weights(0.2126, 0.0722),
            2 | 5 | 6 => weights(0.299, 0.114),
            4 => weights(0.3, 0.11),
            7 => weights(0.212, 0.087),
            8 => Ok(Matrix::Ycgco),
            9 => weights(0.2627, 0.0593),
            other => Err(Error::Matrix(other)),
        }
    }
}

/// What code values mean.
#[derive(Debug, Clone, Copy)]
struct Range {
    luma_offset: f32,
    luma_scale: f32,
    chroma_offset: f32,
    chroma_scale: f32,
}

impl Range {
    fn of(picture: &Picture, is_full: bool) -> Self {
        let bits = picture.bits_per_component().map_or(8, |bits| bits.0.clamp(8, 16));
        let (max, unit) = (((1u32 << bits) - 1) as f32, (1u32 << (bits - 8)) as f32);
        let (luma_offset, luma, chroma) =
            if is_full { (0.0, max, max) } else { (16.0 * unit, 219.0 * unit, 224.0 * unit) };
        Range { luma_offset, luma_scale: 1.0 / luma, chroma_offset: 128.0 * unit, chroma_scale: 1.0 / chroma }
    }

    /// Returns a number from 0 to 1, or slightly beyond.
    fn luma(self, value: f32) -> f32 {
        (value - self.luma_offset) * self.luma_scale
    }

    /// Returns a number from −.5 to .5, or slightly beyond.
    fn chroma(self, value: f32) -> f32 {
        (value - self.chroma_offset) * self.chroma_scale
    }
}

/// Samples of a plane.
struct Samples {
    plane: Plane,
    /// Bytes from a row to the next.
    stride: usize,
    rows: usize,
    is_deep: bool,
}

impl Samples {
    fn new(picture: &Picture, component: PlanarImageComponent) -> Self {
        let (stride, rows) = picture.plane_data_geometry(component);
        let is_deep = picture.bit_depth() > 8;
        Samples { plane: picture.plane(component), stride: stride as usize, rows: rows as usize, is_deep }
    }

    /// Copies the first samples of a row as numbers.
    fn row(&self, row: usize, to: &mut [f32]) {
        let bytes = &self.plane[row * self.stride..];
        if self.is_deep {
            let (words, _) = bytes.as_chunks::<2>();
            to.iter_mut().zip(words).for_each(|(to, &word)| *to = f32::from(u16::from_ne_bytes(word)));
        } else {
            to.iter_mut().zip(bytes).for_each(|(to, &byte)| *to = f32::from(byte));
        }
    }

    /// Copies a row of chroma at the size of luma. Samples lie in the middle of those of luma that they belong to, and
    /// are weighted by 3/4 and 1/4 along each side, as libavif does.
    fn enlarged_row(&self, row: usize, layout: PixelLayout, to: &mut [f32]) {
        if layout == PixelLayout::I444 {
            return self.row(row, to);
        }
        let mut near = vec![0.0; to.len().div_ceil(2)];
        if layout == PixelLayout::I420 {
            self.row(row / 2, &mut near);
            let other =
                if row.is_multiple_of(2) { (row / 2).saturating_sub(1) } else { (row / 2 + 1).min(self.rows - 1) };
            let mut far = vec![0.0; near.len()];
            self.row(other, &mut far);
            near.iter_mut().zip(far).for_each(|(near, far)| *near = 0.75 * *near + 0.25 * far);
        } else {
            self.row(row, &mut near);
        }
        let last = near.len() - 1;
        for (x, to) in to.iter_mut().enumerate() {
            let other = if x.is_multiple_of(2) { (x / 2).saturating_sub(1) } else { (x / 2 + 1).min(last) };
            *to = 0.75 * near[x / 2] + 0.25 * near[other];
        }
    }
}
