//! Finds pictures that other formats hold better: drawings, pages and screenshots with large areas of one colour.

use std::collections::HashMap;
use std::io::{self, Write};

use png::{BitDepth, ColorType, Filter};
use ssplat::{Pixels, Samples};

use crate::rows::color_type;

/// Largest number of colours of a PNG's palette.
const MAX_PALETTE: usize = 256;
/// Number of pixels above which no PNG is tried: it would take seconds.
const MAX_PIXELS: u64 = 1 << 25;
/// Minimum number of pixels. What a smaller picture takes does not matter.
const MIN_PIXELS: u64 = 1 << 12;
/// Minimum share of the pixels that equal their left neighbour in a drawing. Photographs have up to 0.44.
const MIN_EQUAL: f64 = 0.5;
/// PSNR in dB below which lines and letters of a drawing are blurred. A screenshot and a page of text have 25 to 32 dB
/// at a ratio of 50, diagrams that look sharp have 44 dB and more.
const SHARP: f64 = 34.0;
/// Bytes of the PNG, relative to those of the file, above which the PNG is no alternative to a blurred file.
const MAX_LONGER: usize = 8;

/// Largest distance of the noise of paper from its level, smallest distance of ink, and smallest step of an edge, in
/// 8-bit code values.
const NOISE: u32 = 8;
const CONTRAST: u32 = 80;
const EDGE: u32 = 48;
/// Smallest shares of the pixels of a page that are paper, ink, and edges.
const MIN_PAPER: f64 = 0.5;
const MIN_INK: f64 = 0.005;
const MIN_EDGES: f64 = 0.005;

/// Returns a note on the file of a drawing, which has `bytes` bytes and this PSNR, if a lossless PNG is no larger or if
/// the file is blurred. Pictures of 16 bits per sample and files without loss have none.
pub fn note(pixels: &Pixels, bytes: usize, psnr: f64) -> Option<String> {
    let Samples::U8(samples) = pixels.samples() else { return None };
    if psnr.is_infinite() {
        return None;
    }
    let count = u64::from(pixels.width()) * u64::from(pixels.height());
    let size = pixels.channels().count();
    if !(MIN_PIXELS..=MAX_PIXELS).contains(&count) {
        return None;
    }
    if equal_share(samples, size, pixels.width()) < MIN_EQUAL {
        return (psnr < SHARP && is_noisy_page(pixels, samples)).then(|| {
            format!(
                "this picture is a page or a drawing with noise, and its lines are blurred (PSNR {psnr:.1} dB): more bytes, as \
                 with --quality 80, keep them sharp"
            )
        });
    }
    let palette = Palette::of(samples, size);
    let length = match &palette {
        Some(palette) => palette.png_length(pixels),
        None => png_length(pixels, samples),
    };
    let length = length.ok().filter(|&length| length <= bytes || psnr < SHARP && length / MAX_LONGER <= bytes)?;
    let colors = palette.map_or(String::new(), |palette| match palette.colors.len() {
        1 => " of one colour".into(),
        count => format!(" of {count} colours"),
    });
    let png = format!("a lossless PNG of it takes {length} bytes");
    Some(if length <= bytes {
        format!("this picture is a drawing{colors}: {png}")
    } else {
        format!(
            "this picture is a drawing{colors}, and its lines are blurred (PSNR {psnr:.1} dB): --lossless keeps them, and {png}"
        )
    })
}

/// Whether most pixels are a paper of one level with some noise, on which other levels have sharp edges. At most 0.3 of
/// the pixels of photographs are within [`NOISE`] of their most frequent level.
fn is_noisy_page(pixels: &Pixels, samples: &[u8]) -> bool {
    let size = pixels.channels().count();
    let colors = size - usize::from(pixels.channels().alpha().is_some());
    let level = |pixel: &[u8]| pixel[..colors].iter().map(|&v| u32::from(v)).sum::<u32>() / colors as u32;
    let mut counts = [0u64; 256];
    for pixel in samples.chunks_exact(size) {
        counts[level(pixel) as usize] += 1;
    }
    let all: u64 = counts.iter().sum();
    let share = |of: u64| of as f64 / all as f64;
    let paper = counts.iter().zip(0..).max_by_key(|&(count, _)| count).map_or(0, |(_, level)| level);
    let sum = |is_counted: &dyn Fn(u32) -> bool| {
        share(counts.iter().zip(0u32..).filter(|&(_, level)| is_counted(level.abs_diff(paper))).map(|(n, _)| n).sum())
    };
    if sum(&|distance| distance <= NOISE) < MIN_PAPER || sum(&|distance| distance >= CONTRAST) < MIN_INK {
        return false;
    }
    let edges = |row: &[u8]| {
        let levels: Vec<u32> = row.chunks_exact(size).map(level).collect();
        levels.windows(2).filter(|pair| pair[0].abs_diff(pair[1]) >= EDGE).count() as u64
    };
    share(samples.chunks_exact(pixels.width() as usize * size).map(edges).sum()) >= MIN_EDGES
}

/// Returns the share of the pixels that equal their left neighbour.
fn equal_share(samples: &[u8], size: usize, width: u32) -> f64 {
    let row = width as usize * size;
    let equal = |row: &[u8]| row.chunks_exact(size).zip(row[size..].chunks_exact(size)).filter(|(a, b)| a == b).count();
    let all: usize = samples.chunks_exact(row).map(equal).sum();
    all as f64 / (samples.len() / size) as f64
}

/// The colours of a picture, in the order of their first pixels, and the number of the colour of each pixel.
struct Palette<'a> {
    colors: Vec<&'a [u8]>,
    indices: Vec<u8>,
}

impl<'a> Palette<'a> {
    /// Returns `None` if the picture has more than [`MAX_PALETTE`] colours.
    fn of(samples: &'a [u8], size: usize) -> Option<Self> {
        let (mut colors, mut indices) = (Vec::new(), Vec::with_capacity(samples.len() / size));
        let mut known: HashMap<&[u8], u8> = HashMap::new();
        for color in samples.chunks_exact(size) {
            let index = match known.get(color) {
                Some(&index) => index,
                None if colors.len() == MAX_PALETTE => return None,
                None => {
                    let index = colors.len() as u8;
                    colors.push(color);
                    known.insert(color, index);
                    index
                }
            };
            indices.push(index);
        }
        Some(Palette { colors, indices })
    }

    /// Returns the bytes of a PNG with this palette.
    fn png_length(&self, pixels: &Pixels) -> io::Result<usize> {
        let (bits, depth) = match self.colors.len() {
            ..=2 => (1, BitDepth::One),
            3..=4 => (2, BitDepth::Two),
            5..=16 => (4, BitDepth::Four),
            _ => (8, BitDepth::Eight),
        };
        let rows = self.indices.chunks_exact(pixels.width() as usize);
        // The first pixel of a byte is in its high bits.
        let packed = |pixels: &[u8]| pixels.iter().enumerate().fold(0, |b, (i, v)| b | v << (8 - bits * (i + 1)));
        let data: Vec<u8> = rows.flat_map(|row| row.chunks(8 / bits).map(packed)).collect();
        let gray = pixels.channels().count() < 3;
        let rgb = |color: &&[u8]| if gray { [color[0]; 3] } else { [color[0], color[1], color[2]] };
        let mut length = Length(0);
        let mut encoder = png::Encoder::new(&mut length, pixels.width(), pixels.height());
        encoder.set_color(ColorType::Indexed);
        encoder.set_depth(depth);
        encoder.set_palette(self.colors.iter().flat_map(rgb).collect::<Vec<u8>>());
        if let Some(alpha) = pixels.channels().alpha() {
            encoder.set_trns(self.colors.iter().map(|color| color[alpha]).collect::<Vec<u8>>());
        }
        // Differences of palette indices mean nothing.
        encoder.set_filter(Filter::NoFilter);
        write(encoder, &data)?;
        Ok(length.0)
    }
}

/// Returns the bytes of a PNG without a palette.
fn png_length(pixels: &Pixels, samples: &[u8]) -> io::Result<usize> {
    let mut length = Length(0);
    let mut encoder = png::Encoder::new(&mut length, pixels.width(), pixels.height());
    encoder.set_color(color_type(pixels.channels()));
    write(encoder, samples)?;
    Ok(length.0)
}

fn write(encoder: png::Encoder<'_, &mut Length>, data: &[u8]) -> io::Result<()> {
    let mut writer = encoder.write_header()?;
    writer.write_image_data(data)?;
    Ok(writer.finish()?)
}

/// Counts bytes instead of writing them.
struct Length(usize);

impl Write for Length {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0 += bytes.len();
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{DynamicImage, ImageFormat};
    use ssplat::Channels;

    /// Squares of as many colours as `colors` says, in channels and pixels of `channels`.
    fn squares(channels: Channels, colors: u32) -> Pixels {
        let sample = |x: u32, y: u32, k: usize| {
            let color = (x / 8 + 16 * (y / 8)) % colors;
            [color, color / 256 * 40, 7, 255 - color % 3][k] as u8
        };
        let samples = (0..128 * 96).flat_map(|i| {
            let last = channels.alpha();
            (0..channels.count()).map(move |k| sample(i % 128, i / 128, if last == Some(k) { 3 } else { k.min(2) }))
        });
        Pixels::new(128, 96, channels, Samples::U8(samples.collect())).unwrap()
    }

    /// The length of the PNG that `png` writes with the same settings, read back and compared by `image`.
    #[test]
    fn a_png_of_the_length_that_is_told_holds_the_picture() {
        for channels in [Channels::Grey, Channels::GreyAlpha, Channels::Rgb, Channels::Rgba] {
            for colors in [1, 2, 3, 5, 17, 190] {
                let pixels = squares(channels, colors);
                let Samples::U8(samples) = pixels.samples() else { unreachable!() };
                let palette = Palette::of(samples, channels.count()).unwrap();
                assert!(palette.colors.len() >= colors as usize, "{channels:?} {colors}");
                let shown: Vec<u8> =
                    palette.indices.iter().flat_map(|&i| palette.colors[usize::from(i)].to_vec()).collect();
                assert_eq!(&shown, samples, "{channels:?} {colors}");
                let told = note(&pixels, 1 << 20, 50.0).unwrap();
                assert!(told.contains(&format!("{} bytes", palette.png_length(&pixels).unwrap())), "{told}");
                // No worse than what `image` makes of it.
                let image = DynamicImage::from(image::RgbImage::from_fn(128, 96, |x, y| {
                    let at = (y * 128 + x) as usize * channels.count();
                    image::Rgb(std::array::from_fn(|k| samples[at + if channels.count() < 3 { 0 } else { k }]))
                }));
                let mut other = std::io::Cursor::new(Vec::new());
                image.write_to(&mut other, ImageFormat::Png).unwrap();
                let length = palette.png_length(&pixels).unwrap();
                assert!(length < other.get_ref().len() + 800, "{channels:?} {colors}: {length}");
            }
        }
    }

    /// A page of lines on paper with noise of `noise` levels to either side.
    fn page(channels: Channels, noise: u32) -> Pixels {
        let samples = (0..200 * 128u32).flat_map(|i| {
            let (x, y) = (i % 200, i / 200);
            let random = (i.wrapping_mul(2_654_435_761) >> 16) % (2 * noise + 1);
            let ink = y % 16 < 8 && (x * x + y) % 11 < 3;
            let level = if ink { 30 } else { 228 } + random;
            (0..channels.count()).map(move |k| if channels.alpha() == Some(k) { 255 } else { level as u8 })
        });
        Pixels::new(200, 128, channels, Samples::U8(samples.collect())).unwrap()
    }

    #[test]
    fn a_page_with_noise_is_blurred_as_one_without() {
        for channels in [Channels::Grey, Channels::Rgb, Channels::Rgba] {
            for noise in [1, 2, 5] {
                let told = note(&page(channels, noise), 600, 21.0).unwrap();
                assert!(told.contains("its lines are blurred (PSNR 21.0 dB)"), "{told}");
                assert_eq!(note(&page(channels, noise), 6000, 40.0), None);
            }
        }
    }

    #[test]
    fn only_drawings_whose_png_is_no_larger_have_a_note() {
        let drawing = squares(Channels::Rgb, 5);
        let length = note(&drawing, usize::MAX, 50.0).unwrap();
        assert!(length.starts_with("this picture is a drawing of 5 colours: a lossless PNG of it takes "), "{length}");
        assert_eq!(note(&drawing, 60, 50.0), None);
        let blurred = note(&drawing, 60, 25.04).unwrap();
        assert!(
            blurred.contains("blurred (PSNR 25.0 dB): --lossless keeps them, and a lossless PNG of it takes "),
            "{blurred}"
        );
        let noise = (0..128 * 96 * 3u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
        let noise = Pixels::new(128, 96, Channels::Rgb, Samples::U8(noise)).unwrap();
        assert_eq!(note(&noise, usize::MAX, 20.0), None);
        let deep = Pixels::new(128, 96, Channels::Grey, Samples::U16(vec![7; 128 * 96])).unwrap();
        assert_eq!(note(&deep, usize::MAX, 20.0), None);
        let many = squares(Channels::Rgb, 1000);
        let told = note(&many, usize::MAX, 50.0);
        // 192 squares have no more colours than that.
        assert!(told.as_ref().is_some_and(|told| told.contains("of 192 colours")), "{told:?}");
    }
}
