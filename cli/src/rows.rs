//! Writes pictures: PNG and PNM row by row with little memory, other formats through the `image` crate.

use std::io::{self, Cursor, Write};
use std::path::Path;

use image::codecs::{
    bmp::BmpEncoder, farbfeld::FarbfeldEncoder, jpeg::JpegEncoder, qoi::QoiEncoder, tga::TgaEncoder, tiff::TiffEncoder,
    webp::WebPEncoder,
};
use image::error::{ImageFormatHint, UnsupportedError};
use image::metadata::Orientation;
use image::{DynamicImage, ImageEncoder, ImageError, ImageFormat, ImageResult};
use ssplat::SamplesMut;
use ssplat::unstable::bitstream::splats::Metadata;
use ssplat::unstable::colour;
use ssplat::{Channels, Depth, Pixels, Samples};

use crate::failure::Failure;
use crate::sink::Sink;

/// Length of a PNG chunk in bytes.
const PNG_CHUNK: usize = 1 << 16;

/// Quality of JPEG output, 1 to 100: so high that JPEG adds no visible artefacts.
const JPEG_QUALITY: u8 = 95;

/// Formats without a palette that `image` writes.
const WHOLE: [ImageFormat; 7] = [
    ImageFormat::Bmp,
    ImageFormat::Farbfeld,
    ImageFormat::Jpeg,
    ImageFormat::Qoi,
    ImageFormat::Tga,
    ImageFormat::Tiff,
    ImageFormat::WebP,
];

/// Returns the extensions of the formats that can be written, one each.
fn known() -> String {
    let whole = WHOLE.iter().filter_map(|format| format.extensions_str().first().copied());
    ["png", "ppm", "pgm", "pnm", "pam"].into_iter().chain(whole).collect::<Vec<_>>().join(", ")
}

/// An output format.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    Png,
    /// `P6`; grey becomes equal red, green and blue.
    Ppm,
    /// `P5`, for grey pictures only.
    Pgm,
    /// `P5` or `P6`, or `P7` for pictures with alpha.
    Pnm,
    /// Always `P7`.
    Pam,
    /// A format that `image` writes from the whole picture.
    Whole(ImageFormat),
}

impl Format {
    /// Returns the format of a file name extension.
    pub fn from_extension(extension: &str) -> Result<Format, Failure> {
        match extension.to_ascii_lowercase().as_str() {
            "png" => Ok(Format::Png),
            "ppm" => Ok(Format::Ppm),
            "pgm" => Ok(Format::Pgm),
            "pnm" => Ok(Format::Pnm),
            "pam" => Ok(Format::Pam),
            other => match ImageFormat::from_extension(other) {
                Some(format) if WHOLE.contains(&format) => Ok(Format::Whole(format)),
                _ => Err(Failure::usage(format!(
                    "{extension:?} is not an extension of a format that can be written: {}",
                    known()
                ))),
            },
        }
    }

    /// Returns the format of the extension of `path`.
    pub fn of_path(path: &Path) -> Result<Format, Failure> {
        let extension = path.extension().and_then(|e| e.to_str());
        let extension =
            extension.ok_or_else(|| Failure::usage(format!("{}: has no extension; name --format", path.display())))?;
        Format::from_extension(extension)
    }
}

impl Format {
    /// Whether the format supports alpha.
    pub fn has_alpha(self) -> bool {
        !matches!(self, Format::Whole(ImageFormat::Jpeg) | Format::Ppm | Format::Pgm)
    }

    /// Whether the format can store an ICC profile.
    pub fn has_profile(self) -> bool {
        matches!(self, Format::Png | Format::Whole(ImageFormat::Jpeg | ImageFormat::WebP | ImageFormat::Tiff))
    }

    /// Whether the format stores pictures of `channels` as grey.
    pub fn is_grey(self, channels: Channels) -> bool {
        let has_grey = !matches!(self, Format::Ppm | Format::Whole(ImageFormat::WebP | ImageFormat::Qoi));
        let has_grey_alpha = !matches!(self, Format::Whole(ImageFormat::Bmp | ImageFormat::Tiff));
        has_grey && channels.count() < 3 && (channels == Channels::Grey || has_grey_alpha)
    }

    /// Returns the name of the format and its longest side in pixels, if that is less than a picture may have.
    fn longest_side(self) -> Option<(&'static str, u32)> {
        Some(match self {
            Format::Whole(ImageFormat::WebP) => ("WebP", 16_383),
            Format::Whole(ImageFormat::Jpeg) => ("JPEG", 65_535),
            Format::Whole(ImageFormat::Tga) => ("TGA", 65_535),
            _ => return None,
        })
    }

    /// Checks that the format can hold a picture of `size` and `channels`, which is written to `path`.
    ///
    /// # Errors
    /// A usage error if it cannot.
    pub fn check(self, path: &Path, [width, height]: [u32; 2], channels: Channels) -> Result<(), Failure> {
        let path = path.display();
        if let Some((name, most)) = self.longest_side().filter(|&(_, most)| width.max(height) > most) {
            return Err(Failure::usage(format!(
                "{path}: {name} holds at most {most} pixels a side, and the picture has {width} × {height}: \
                 write another format, or a smaller picture with --width or --scale"
            )));
        }
        if self == Format::Pgm && channels.count() >= 3 {
            return Err(Failure::usage(format!("{path}: PGM holds grey pictures only: write PPM instead")));
        }
        Ok(())
    }

    /// Returns notes about depth and metadata that the format does not support.
    pub fn losses(self, depth: Depth, metadata: &Metadata) -> Vec<String> {
        let (icc, exif) = match self {
            Format::Png | Format::Whole(ImageFormat::Jpeg | ImageFormat::WebP) => (true, true),
            Format::Whole(ImageFormat::Tiff) => (true, false),
            _ => (false, false),
        };
        let mut notes = Vec::new();
        let is_deep = !matches!(
            self,
            Format::Whole(
                ImageFormat::Bmp | ImageFormat::Jpeg | ImageFormat::Qoi | ImageFormat::Tga | ImageFormat::WebP
            )
        );
        if depth == Depth::Sixteen && !is_deep {
            notes.push("samples of 16 bits are rounded to 8, because the output format has no more".into());
        }
        if !icc && metadata.icc.is_some() {
            notes.push("the ICC profile is left out, because the output format cannot store one".into());
        }
        // PNG stores code points, and the others a profile if one has the same meaning.
        if let Some(cicp) = metadata.cicp.filter(|_| self != Format::Png)
            && (!icc || colour::profile_of_cicp(cicp, false).is_none())
        {
            notes.push(format!(
                "the code points of its colours ({cicp}) are left out, because the output format cannot store them: \
                 the picture will look wrong; PNG keeps them"
            ));
        }
        if let Some(exif) = metadata.exif.as_deref().filter(|_| !exif) {
            let turned = Orientation::from_exif_chunk(exif).is_some_and(|o| o != Orientation::NoTransforms);
            let orientation =
                if turned { ", and with it the orientation; --auto-orient turns the picture" } else { "" };
            notes.push(format!("the EXIF block is left out, because the output format cannot store one{orientation}"));
        }
        notes
    }
}

/// The size and sample type of a picture.
#[derive(Debug, Clone, Copy)]
pub struct Shape {
    pub width: u32,
    pub height: u32,
    pub channels: Channels,
    pub depth: Depth,
}

/// Writes a picture from top to bottom.
pub struct RowWriter<'a> {
    shape: Shape,
    out: Out<'a>,
}

enum Out<'a> {
    Png(Box<png::StreamWriter<'static, Box<dyn Write>>>),
    Pnm(Box<dyn Write>),
    /// Grey samples of so many bytes, which are written three times.
    Tripled(Box<dyn Write>, usize),
    Whole {
        format: ImageFormat,
        samples: Samples,
        metadata: &'a Metadata,
        writer: Box<dyn Write>,
    },
}

impl<'a> RowWriter<'a> {
    /// Writes everything before the first row.
    pub fn new(sink: &Sink, format: Format, shape: Shape, metadata: &'a Metadata) -> io::Result<Self> {
        let mut writer = sink.writer()?;
        let out = match format {
            Format::Png => Out::Png(Box::new(start_png(writer, shape, metadata)?)),
            Format::Ppm | Format::Pgm | Format::Pnm | Format::Pam => {
                writer.write_all(pnm_header(shape, format).as_bytes())?;
                if format == Format::Ppm && shape.channels == Channels::Grey {
                    Out::Tripled(writer, shape.depth.bytes())
                } else {
                    Out::Pnm(writer)
                }
            }
            Format::Whole(format) => {
                let count = u64::from(shape.width) * u64::from(shape.height) * shape.channels.count() as u64;
                let mut samples = empty(shape.depth);
                let count = usize::try_from(count).map_err(|_| io::ErrorKind::OutOfMemory)?;
                match &mut samples {
                    Samples::U8(v) => v.try_reserve_exact(count)?,
                    Samples::U16(v) => v.try_reserve_exact(count)?,
                }
                Out::Whole { format, samples, metadata, writer }
            }
        };
        Ok(RowWriter { shape, out })
    }

    /// Writes whole rows. The samples may be modified.
    pub fn write(&mut self, rows: SamplesMut<'_>) -> io::Result<()> {
        let bytes: &[u8] = match (rows, &mut self.out) {
            (SamplesMut::U8(rows), Out::Whole { samples: Samples::U8(all), .. }) => {
                all.extend_from_slice(rows);
                return Ok(());
            }
            (SamplesMut::U16(rows), Out::Whole { samples: Samples::U16(all), .. }) => {
                all.extend_from_slice(rows);
                return Ok(());
            }
            (SamplesMut::U8(rows), _) => rows,
            (SamplesMut::U16(rows), _) => {
                // PNG and PNM are big-endian.
                rows.iter_mut().for_each(|v| *v = v.to_be());
                bytemuck::cast_slice(rows)
            }
        };
        match &mut self.out {
            Out::Png(out) => out.write_all(bytes),
            Out::Pnm(out) => out.write_all(bytes),
            Out::Tripled(out, length) => {
                let tripled: Vec<u8> =
                    bytes.chunks_exact(*length).flat_map(|sample| [sample; 3]).flatten().copied().collect();
                out.write_all(&tripled)
            }
            Out::Whole { .. } => unreachable!("rows have the depth that the writer was made for"),
        }
    }

    /// Writes everything after the last row.
    pub fn finish(self, path: &Path) -> Result<(), Failure> {
        let io = |e: io::Error| Failure::io(path, &e);
        match self.out {
            Out::Png(out) => out.finish().map_err(|e| io(e.into())),
            Out::Pnm(mut out) | Out::Tripled(mut out, _) => out.flush().map_err(io),
            Out::Whole { format, samples, metadata, mut writer } => {
                let Shape { width, height, channels, .. } = self.shape;
                let pixels = Pixels::new(width, height, channels, samples).map_err(|e| Failure::library(path, &e))?;
                let bytes = encode_whole(pixels.into(), format, metadata).map_err(|e| Failure::image(path, &e))?;
                writer.write_all(&bytes).and_then(|()| writer.flush()).map_err(io)
            }
        }
    }
}

/// Returns an empty buffer of samples.
fn empty(depth: Depth) -> Samples {
    match depth {
        Depth::Eight => Samples::U8(Vec::new()),
        Depth::Sixteen => Samples::U16(Vec::new()),
    }
}

/// Returns the colour type of a PNG without a palette.
pub fn color_type(channels: Channels) -> png::ColorType {
    match channels {
        Channels::Grey => png::ColorType::Grayscale,
        Channels::GreyAlpha => png::ColorType::GrayscaleAlpha,
        Channels::Rgb => png::ColorType::Rgb,
        Channels::Rgba => png::ColorType::Rgba,
    }
}

/// Writes a PNG up to its first row, with the code points, the ICC profile and the EXIF block.
fn start_png(
    writer: Box<dyn Write>,
    shape: Shape,
    metadata: &Metadata,
) -> io::Result<png::StreamWriter<'static, Box<dyn Write>>> {
    let mut info = png::Info::with_size(shape.width, shape.height);
    info.icc_profile = metadata.icc.as_deref().map(Into::into);
    info.exif_metadata = metadata.exif.as_deref().map(Into::into);
    let mut encoder = png::Encoder::with_info(writer, info)?;
    encoder.set_color(color_type(shape.channels));
    encoder.set_depth(match shape.depth {
        Depth::Eight => png::BitDepth::Eight,
        Depth::Sixteen => png::BitDepth::Sixteen,
    });
    encoder.set_compression(png::Compression::Fast);
    let mut writer = encoder.write_header()?;
    if let Some(cicp) = metadata.cicp {
        writer.write_chunk(png::chunk::ChunkType(*b"cICP"), &cicp.to_bytes())?;
    }
    Ok(writer.into_stream_writer_with_size(PNG_CHUNK)?)
}

/// Returns the header of a PNM file; `P5` and `P6` have no alpha.
fn pnm_header(shape: Shape, format: Format) -> String {
    let Shape { width, height, channels, depth } = shape;
    let max = depth.max();
    let tuple = match (channels, format) {
        (Channels::Grey, Format::Pnm | Format::Pgm) => return format!("P5\n{width} {height}\n{max}\n"),
        (Channels::Rgb, Format::Pnm) | (Channels::Grey | Channels::Rgb, Format::Ppm) => {
            return format!("P6\n{width} {height}\n{max}\n");
        }
        (Channels::Grey, _) => "GRAYSCALE",
        (Channels::GreyAlpha, _) => "GRAYSCALE_ALPHA",
        (Channels::Rgb, _) => "RGB",
        (Channels::Rgba, _) => "RGB_ALPHA",
    };
    let count = channels.count();
    format!("P7\nWIDTH {width}\nHEIGHT {height}\nDEPTH {count}\nMAXVAL {max}\nTUPLTYPE {tuple}\nENDHDR\n")
}

/// Encodes a whole picture, with the metadata that `image` writes for the format. `DynamicImage::write_to` would compile every
/// encoder once more.
fn encode_whole(picture: DynamicImage, format: ImageFormat, metadata: &Metadata) -> ImageResult<Vec<u8>> {
    let mut out = Cursor::new(Vec::new());
    // Their encoders know grey without alpha only.
    let picture = match (format, picture) {
        (ImageFormat::Bmp | ImageFormat::Tiff, picture @ DynamicImage::ImageLumaA8(_)) => picture.into_rgba8().into(),
        (ImageFormat::Bmp | ImageFormat::Tiff, picture @ DynamicImage::ImageLumaA16(_)) => picture.into_rgba16().into(),
        (_, picture) => picture,
    };
    match format {
        ImageFormat::Jpeg => {
            with_metadata(&picture, JpegEncoder::new_with_quality(&mut out, JPEG_QUALITY), metadata)?;
        }
        ImageFormat::WebP => with_metadata(&picture, WebPEncoder::new_lossless(&mut out), metadata)?,
        ImageFormat::Tiff => with_metadata(&picture, TiffEncoder::new(&mut out), metadata)?,
        ImageFormat::Farbfeld => {
            DynamicImage::from(picture.into_rgba16()).write_with_encoder(FarbfeldEncoder::new(&mut out))?;
        }
        ImageFormat::Qoi if picture.color().has_alpha() => {
            DynamicImage::from(picture.into_rgba8()).write_with_encoder(QoiEncoder::new(&mut out))?;
        }
        ImageFormat::Qoi => DynamicImage::from(picture.into_rgb8()).write_with_encoder(QoiEncoder::new(&mut out))?,
        ImageFormat::Bmp => picture.write_with_encoder(BmpEncoder::new(&mut out))?,
        ImageFormat::Tga => picture.write_with_encoder(TgaEncoder::new(&mut out))?,
        _ => return Err(ImageError::Unsupported(UnsupportedError::from(ImageFormatHint::Exact(format)))),
    }
    Ok(out.into_inner())
}

fn with_metadata(picture: &DynamicImage, mut encoder: impl ImageEncoder, metadata: &Metadata) -> ImageResult<()> {
    // Metadata that the format does not support is dropped; `Format::losses` reports it.
    if let Some(icc) = colour::profile_or_equivalent(metadata, !picture.color().has_color()) {
        let _ = encoder.set_icc_profile(icc);
    }
    if let Some(exif) = &metadata.exif {
        let _ = encoder.set_exif_metadata(exif.clone());
    }
    picture.write_with_encoder(encoder)
}
