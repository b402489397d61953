//! Formats of pixels, and their conversion to and from the channels of a picture; safe code only.

use ssplat::{Channels, Depth, Pixels, Samples};

use crate::failure::{Failure, Outcome, ssplat_status};

/// Formats of pixels. Samples of 16 bits are uint16_t in the byte order of the machine and need not be aligned. Alpha is
/// not premultiplied, except in SSPLAT_FORMAT_BGRA8_PREMULTIPLIED.
///
/// When decoding, the formats with alpha take any picture: those without alpha are opaque. The formats with red, green
/// and blue take grey pictures too, with three equal colours. A format without alpha is refused for pictures with
/// alpha, and a grey format for those with colours.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ssplat_format {
    /// Red, green, blue, alpha; four bytes a pixel.
    Rgba8 = 0,
    /// Red, green, blue, alpha; four samples of 16 bits a pixel.
    Rgba16 = 1,
    /// Red, green, blue; three bytes a pixel.
    Rgb8 = 2,
    /// Red, green, blue; three samples of 16 bits a pixel.
    Rgb16 = 3,
    /// One byte a pixel.
    Grey8 = 4,
    /// One sample of 16 bits a pixel.
    Grey16 = 5,
    /// Grey, alpha; two bytes a pixel.
    GreyAlpha8 = 6,
    /// Grey, alpha; two samples of 16 bits a pixel.
    GreyAlpha16 = 7,
    /// Blue, green, red, alpha; four bytes a pixel, with the colours multiplied by alpha. The format of Cairo, Qt, Skia
    /// and Direct2D on machines with little-endian numbers.
    Bgra8Premultiplied = 8,
}

use ssplat_format::{Bgra8Premultiplied, Grey8, Grey16, GreyAlpha8, GreyAlpha16, Rgb8, Rgb16, Rgba8, Rgba16};

impl ssplat_format {
    /// The format that a caller names by its number.
    pub fn of(number: i32) -> Outcome<Self> {
        let all = [Rgba8, Rgba16, Rgb8, Rgb16, Grey8, Grey16, GreyAlpha8, GreyAlpha16, Bgra8Premultiplied];
        let found = usize::try_from(number).ok().and_then(|k| all.get(k));
        found.copied().ok_or_else(|| Failure::parameter(format_args!("there is no format {number}")))
    }

    /// Channels of a pixel. Their order in memory is that of [`Channels`], or blue first.
    fn channels(self) -> Channels {
        match self {
            Rgba8 | Rgba16 | Bgra8Premultiplied => Channels::Rgba,
            Rgb8 | Rgb16 => Channels::Rgb,
            Grey8 | Grey16 => Channels::Grey,
            GreyAlpha8 | GreyAlpha16 => Channels::GreyAlpha,
        }
    }

    pub fn depth(self) -> Depth {
        match self {
            Rgba8 | Rgb8 | Grey8 | GreyAlpha8 | Bgra8Premultiplied => Depth::Eight,
            Rgba16 | Rgb16 | Grey16 | GreyAlpha16 => Depth::Sixteen,
        }
    }

    /// Bytes of a pixel.
    fn pixel(self) -> usize {
        self.channels().count() * self.depth().bytes()
    }

    /// Refuses to leave out the alpha or the colours of a picture.
    pub fn check(self, picture: Channels) -> Outcome<()> {
        let own = self.channels();
        if picture.alpha().is_some() && own.alpha().is_none() {
            return Err(Failure::parameter("the picture has alpha, which the format of the buffer has not"));
        }
        if picture.count() > 2 && own.count() <= 2 {
            return Err(Failure::parameter("the picture has colours, and the format of the buffer is grey"));
        }
        Ok(())
    }

    /// Hands out rows of `len` samples of a picture with `channels`, in this format.
    pub fn send<T: Sample>(self, samples: &[T], len: usize, channels: Channels, sink: &mut dyn FnMut(&[u8])) {
        let mut out = Vec::with_capacity(len / channels.count() * self.channels().count());
        for row in samples.chunks_exact(len) {
            if self.channels() == channels && self != Bgra8Premultiplied {
                sink(bytemuck::cast_slice(row));
                continue;
            }
            out.clear();
            for pixel in row.chunks_exact(channels.count()) {
                let (color, alpha) = match *pixel {
                    [grey] => ([grey; 3], T::OPAQUE),
                    [grey, alpha] => ([grey; 3], alpha),
                    [red, green, blue] => ([red, green, blue], T::OPAQUE),
                    [red, green, blue, alpha, ..] => ([red, green, blue], alpha),
                    [] => ([T::OPAQUE; 3], T::OPAQUE),
                };
                let [red, green, blue] = color;
                match self {
                    Rgba8 | Rgba16 => out.extend_from_slice(&[red, green, blue, alpha]),
                    Rgb8 | Rgb16 => out.extend_from_slice(&color),
                    Grey8 | Grey16 => out.push(red),
                    GreyAlpha8 | GreyAlpha16 => out.extend_from_slice(&[red, alpha]),
                    Bgra8Premultiplied => {
                        let [red, green, blue] = color.map(|v| v.premultiplied(alpha));
                        out.extend_from_slice(&[blue, green, red, alpha]);
                    }
                }
            }
            sink(bytemuck::cast_slice(&out));
        }
    }
}

/// How rows lie in memory: found to fit into it.
#[derive(Debug, Clone, Copy)]
pub struct Rows {
    pub format: ssplat_format,
    pub count: u32,
    /// Bytes of a row.
    pub len: usize,
    /// Bytes from the start of a row to that of the next.
    pub stride: usize,
}

impl Rows {
    /// Checks that `size` bytes hold a picture of `width × height` pixels. A `stride` of 0 is that of rows without gaps.
    pub fn new(format: i32, [width, height]: [u32; 2], size: usize, stride: usize) -> Outcome<Self> {
        let format = ssplat_format::of(format)?;
        let beyond = || Failure::new(ssplat_status::Limit, format_args!("{width} × {height} pixels exceed memory"));
        let len = (width as usize).checked_mul(format.pixel()).ok_or_else(beyond)?;
        let stride = if stride == 0 { len } else { stride };
        if stride < len {
            return Err(Failure::parameter(format_args!("stride is {stride} where a row has {len} bytes")));
        }
        let before_last = stride.checked_mul((height as usize).saturating_sub(1));
        let needed = before_last.and_then(|bytes| bytes.checked_add(len)).ok_or_else(beyond)?;
        if size < needed {
            return Err(Failure::short(size, needed));
        }
        Ok(Rows { format, count: height, len, stride })
    }
}

/// The pixels whose rows, as bytes of `format`, `row` appends one after the other.
#[cfg_attr(not(feature = "encode"), allow(dead_code, reason = "only the encoder takes pixels"))]
pub fn gather(rows: &Rows, [width, height]: [u32; 2], mut row: impl FnMut(&mut Vec<u8>)) -> Outcome<Pixels> {
    let channels = rows.format.channels();
    let mut bytes = Vec::new();
    let needed = rows.len.checked_mul(height as usize);
    let needed = needed.ok_or_else(|| Failure::new(ssplat_status::Limit, "the pixels exceed memory"))?;
    bytes.try_reserve_exact(needed).map_err(|e| Failure::new(ssplat_status::Memory, e))?;
    (0..height).for_each(|_| row(&mut bytes));
    let samples = match rows.format.depth() {
        Depth::Eight => {
            if rows.format == Bgra8Premultiplied {
                straighten(&mut bytes);
            }
            Samples::U8(bytes)
        }
        Depth::Sixteen => {
            let mut samples = Vec::new();
            samples.try_reserve_exact(needed / 2).map_err(|e| Failure::new(ssplat_status::Memory, e))?;
            samples.extend(bytes.as_chunks().0.iter().map(|&pair| u16::from_ne_bytes(pair)));
            Samples::U16(samples)
        }
    };
    Ok(Pixels::new(width, height, channels, samples)?)
}

/// Blue first and premultiplied to red first and straight.
fn straighten(pixels: &mut [u8]) {
    for pixel in pixels.chunks_exact_mut(4) {
        pixel.swap(0, 2);
        let alpha = u32::from(pixel[3]);
        for v in &mut pixel[..3] {
            *v = (u32::from(*v) * 255 + alpha / 2).checked_div(alpha).unwrap_or(0).min(255) as u8;
        }
    }
}

/// A sample of 8 or 16 bits.
pub trait Sample: Default + bytemuck::Pod {
    const OPAQUE: Self;

    fn samples(out: &mut [Self]) -> ssplat::SamplesMut<'_>;

    /// The sample times alpha, rounded.
    fn premultiplied(self, alpha: Self) -> Self;
}

impl Sample for u8 {
    const OPAQUE: u8 = u8::MAX;

    fn samples(out: &mut [u8]) -> ssplat::SamplesMut<'_> {
        ssplat::SamplesMut::U8(out)
    }

    fn premultiplied(self, alpha: u8) -> u8 {
        ((u32::from(self) * u32::from(alpha) + 127) / 255) as u8
    }
}

impl Sample for u16 {
    const OPAQUE: u16 = u16::MAX;

    fn samples(out: &mut [u16]) -> ssplat::SamplesMut<'_> {
        ssplat::SamplesMut::U16(out)
    }

    fn premultiplied(self, alpha: u16) -> u16 {
        ((u64::from(self) * u64::from(alpha) + 32767) / 65535) as u16
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn premultiplied_pixels_of_any_alpha_come_back_where_eight_bits_tell_them_apart() {
        for alpha in 0..=255u8 {
            for value in 0..=255u8 {
                let stored = value.premultiplied(alpha);
                let mut pixel = [stored, stored, stored, alpha];
                straighten(&mut pixel);
                assert_eq!(pixel[0].premultiplied(alpha), stored, "{value} at alpha {alpha}");
            }
        }
        let mut pixel = [1, 2, 3, 255];
        straighten(&mut pixel);
        assert_eq!(pixel, [3, 2, 1, 255]);
    }
}
