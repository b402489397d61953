//! Conversion of pictures of the `image` crate to [`Pixels`] and back.

use image::metadata::{
    CicpColorPrimaries, CicpMatrixCoefficients, CicpTransferCharacteristics, CicpVideoFullRangeFlag,
};
use image::{DynamicImage, ExtendedColorType, ImageBuffer};

use crate::bitstream::cicp::Cicp;
use crate::error::{Error, Result};
use crate::gaussian::Channels;
use crate::parameter::Parameter;
use crate::pixels::{Pixels, Samples};

impl TryFrom<&DynamicImage> for Pixels {
    type Error = Error;

    /// Copies the samples. `f32` samples are clamped to `0..=1` and stored with 16 bits.
    ///
    /// # Errors
    /// [`Error::Parameter`] for a picture without pixels, with a side over 2²⁰, or with a sample that is not finite.
    fn try_from(picture: &DynamicImage) -> Result<Pixels> {
        let color = ExtendedColorType::from(picture.color());
        gather(picture.as_bytes(), picture.width(), picture.height(), color).map_err(|e| match e {
            Rejected::Pixels(e) => e,
            Rejected::Color(c) => {
                Error::Parameter { parameter: Parameter::ColorType, problem: format!("{c:?} is not supported") }
            }
        })
    }
}

impl TryFrom<DynamicImage> for Pixels {
    type Error = Error;

    /// Takes the samples without copying them, except `f32` samples, which are clamped to `0..=1` and stored with 16
    /// bits.
    ///
    /// # Errors
    /// As for a borrowed picture.
    fn try_from(picture: DynamicImage) -> Result<Pixels> {
        let (width, height) = (picture.width(), picture.height());
        let (channels, samples) = match picture {
            DynamicImage::ImageLuma8(p) => (Channels::Grey, Samples::U8(p.into_raw())),
            DynamicImage::ImageLumaA8(p) => (Channels::GreyAlpha, Samples::U8(p.into_raw())),
            DynamicImage::ImageRgb8(p) => (Channels::Rgb, Samples::U8(p.into_raw())),
            DynamicImage::ImageRgba8(p) => (Channels::Rgba, Samples::U8(p.into_raw())),
            DynamicImage::ImageLuma16(p) => (Channels::Grey, Samples::U16(p.into_raw())),
            DynamicImage::ImageLumaA16(p) => (Channels::GreyAlpha, Samples::U16(p.into_raw())),
            DynamicImage::ImageRgb16(p) => (Channels::Rgb, Samples::U16(p.into_raw())),
            DynamicImage::ImageRgba16(p) => (Channels::Rgba, Samples::U16(p.into_raw())),
            other => return Pixels::try_from(&other),
        };
        Pixels::new(width, height, channels, samples)
    }
}

impl TryFrom<Cicp> for image::metadata::Cicp {
    type Error = Error;

    /// # Errors
    /// [`Error::Parameter`] for primaries and transfer characteristics that `image` has no name for.
    fn try_from(cicp: Cicp) -> Result<Self> {
        use {CicpColorPrimaries as P, CicpTransferCharacteristics as T};
        let primaries = [
            P::SRgb,
            P::Unspecified,
            P::RgbM,
            P::RgbB,
            P::Bt601,
            P::Rgb240m,
            P::GenericFilm,
            P::Rgb2020,
            P::Xyz,
            P::SmpteRp431,
            P::SmpteRp432,
            P::Industry22,
        ];
        let transfers = [
            T::Bt709,
            T::Unspecified,
            T::Bt470M,
            T::Bt470BG,
            T::Bt601,
            T::Smpte240m,
            T::Linear,
            T::Log100,
            T::LogSqrt,
            T::Iec61966_2_4,
            T::Bt1361,
            T::SRgb,
            T::Bt2020_10bit,
            T::Bt2020_12bit,
            T::Smpte2084,
            T::Smpte428,
            T::Bt2100Hlg,
        ];
        let primaries = primaries.into_iter().find(|known| *known as u8 == cicp.primaries());
        let transfer = transfers.into_iter().find(|known| *known as u8 == cicp.transfer());
        let (Some(primaries), Some(transfer)) = (primaries, transfer) else {
            return Err(Error::Parameter {
                parameter: Parameter::Cicp,
                problem: format!("{cicp}: unknown to `image`"),
            });
        };
        let full_range = match cicp.is_full_range() {
            true => CicpVideoFullRangeFlag::FullRange,
            false => CicpVideoFullRangeFlag::NarrowRange,
        };
        Ok(image::metadata::Cicp { primaries, transfer, matrix: CicpMatrixCoefficients::Identity, full_range })
    }
}

impl TryFrom<image::metadata::Cicp> for Cicp {
    type Error = Error;

    /// # Errors
    /// [`Error::Parameter`] if the matrix coefficients are not [`CicpMatrixCoefficients::Identity`].
    fn try_from(cicp: image::metadata::Cicp) -> Result<Cicp> {
        let bytes = [cicp.primaries as u8, cicp.transfer as u8, cicp.matrix as u8, cicp.full_range as u8];
        Cicp::from_bytes(&bytes).map_err(|_| Error::Parameter {
            parameter: Parameter::Cicp,
            problem: format!("matrix coefficients {} are not 0", cicp.matrix as u8),
        })
    }
}

/// Reason for rejecting samples of the `image` crate.
pub(crate) enum Rejected {
    Pixels(Error),
    Color(ExtendedColorType),
}

/// Conversion of the bytes of one colour type to samples.
type Conversion = fn(&[u8]) -> Result<Samples>;

/// Returns the samples of `buf` as [`Pixels`].
///
/// # Panics
/// If the length of `buf` does not match `width × height` pixels, as [`ImageEncoder::write_image`] specifies.
pub(crate) fn gather(buf: &[u8], width: u32, height: u32, color: ExtendedColorType) -> Result<Pixels, Rejected> {
    use ExtendedColorType as C;
    let (channels, samples): (Channels, Conversion) = match color {
        C::L8 => (Channels::Grey, bytes),
        C::La8 => (Channels::GreyAlpha, bytes),
        C::Rgb8 => (Channels::Rgb, bytes),
        C::Rgba8 => (Channels::Rgba, bytes),
        C::Bgr8 => (Channels::Rgb, swapped::<3>),
        C::Bgra8 => (Channels::Rgba, swapped::<4>),
        C::L16 => (Channels::Grey, words),
        C::La16 => (Channels::GreyAlpha, words),
        C::Rgb16 => (Channels::Rgb, words),
        C::Rgba16 => (Channels::Rgba, words),
        C::Rgb32F => (Channels::Rgb, floats),
        C::Rgba32F => (Channels::Rgba, floats),
        other => return Err(Rejected::Color(other)),
    };
    let bytes_per_pixel = u64::from(color.bits_per_pixel() / 8);
    let expected = u64::from(width) * u64::from(height) * bytes_per_pixel;
    assert_eq!(buf.len() as u64, expected, "buffer length of a {width}x{height} picture of {color:?}");
    samples(buf).and_then(|s| Pixels::new(width, height, channels, s)).map_err(Rejected::Pixels)
}

fn bytes(buf: &[u8]) -> Result<Samples> {
    Ok(Samples::U8(buf.to_vec()))
}

/// Returns the bytes with the first and the third of every `N` exchanged.
fn swapped<const N: usize>(buf: &[u8]) -> Result<Samples> {
    let mut v = buf.to_vec();
    v.chunks_exact_mut(N).for_each(|pixel| pixel.swap(0, 2));
    Ok(Samples::U8(v))
}

fn words(buf: &[u8]) -> Result<Samples> {
    Ok(Samples::U16(bytemuck::pod_collect_to_vec(buf)))
}

fn floats(buf: &[u8]) -> Result<Samples> {
    let (values, _) = buf.as_chunks::<4>();
    let word = |bytes: &[u8; 4]| {
        let v = f32::from_ne_bytes(*bytes);
        if !v.is_finite() {
            return Err(Error::Parameter { parameter: Parameter::Samples, problem: format!("{v} is not finite") });
        }
        Ok((v.clamp(0.0, 1.0) * 65535.0 + 0.5) as u16)
    };
    values.iter().map(word).collect::<Result<_>>().map(Samples::U16)
}

impl From<Pixels> for DynamicImage {
    /// Takes the samples without copying them.
    fn from(pixels: Pixels) -> Self {
        let (width, height, channels) = (pixels.width(), pixels.height(), pixels.channels());
        let picture = match (pixels.into_samples(), channels) {
            (Samples::U8(v), Channels::Grey) => ImageBuffer::from_raw(width, height, v).map(DynamicImage::ImageLuma8),
            (Samples::U8(v), Channels::GreyAlpha) => {
                ImageBuffer::from_raw(width, height, v).map(DynamicImage::ImageLumaA8)
            }
            (Samples::U8(v), Channels::Rgb) => ImageBuffer::from_raw(width, height, v).map(DynamicImage::ImageRgb8),
            (Samples::U8(v), Channels::Rgba) => ImageBuffer::from_raw(width, height, v).map(DynamicImage::ImageRgba8),
            (Samples::U16(v), Channels::Grey) => ImageBuffer::from_raw(width, height, v).map(DynamicImage::ImageLuma16),
            (Samples::U16(v), Channels::GreyAlpha) => {
                ImageBuffer::from_raw(width, height, v).map(DynamicImage::ImageLumaA16)
            }
            (Samples::U16(v), Channels::Rgb) => ImageBuffer::from_raw(width, height, v).map(DynamicImage::ImageRgb16),
            (Samples::U16(v), Channels::Rgba) => ImageBuffer::from_raw(width, height, v).map(DynamicImage::ImageRgba16),
        };
        picture.expect("Pixels hold as many samples as their size says")
    }
}
