//! Crops of pictures as data URIs: the original, the decoded picture, and the difference.

use image::codecs::jpeg::JpegEncoder;
use image::{DynamicImage, ImageEncoder, RgbImage};
use ssplat::Pixels;

/// Side of a crop, pixels.
pub const SIDE: u32 = 156;
/// Factor by which the error is multiplied to make it visible.
pub const GAIN: f32 = 4.0;

/// A rectangle of a picture: left, top, width, height.
pub type Place = [u32; 4];

/// Returns the crop with the most detail: where neighbouring pixels differ most.
pub fn busiest(picture: &RgbImage) -> Place {
    let (width, height) = picture.dimensions();
    let (w, h) = (width.min(SIDE), height.min(SIDE));
    let step = (SIDE / 2) as usize;
    let mut best = (-1i64, [0, 0, w, h]);
    for y in (0..=height - h).step_by(step) {
        for x in (0..=width - w).step_by(step) {
            let mut sum = 0i64;
            for j in (y + 1)..y + h {
                for i in (x + 1)..x + w {
                    let g = |i, j| i64::from(picture.get_pixel(i, j).0[1]);
                    sum += (g(i, j) - g(i - 1, j)).abs() + (g(i, j) - g(i, j - 1)).abs();
                }
            }
            if sum > best.0 {
                best = (sum, [x, y, w, h]);
            }
        }
    }
    best.1
}

/// Converts pixels to 8-bit red, green and blue.
pub fn rgb(pixels: &Pixels) -> RgbImage {
    DynamicImage::from(pixels.clone()).to_rgb8()
}

pub fn cut(picture: &RgbImage, [x, y, w, h]: Place) -> RgbImage {
    image::imageops::crop_imm(picture, x, y, w, h).to_image()
}

/// Returns the difference of two crops around middle grey, times [`GAIN`].
pub fn error(a: &RgbImage, b: &RgbImage) -> RgbImage {
    RgbImage::from_fn(a.width(), a.height(), |x, y| {
        let (p, q) = (a.get_pixel(x, y).0, b.get_pixel(x, y).0);
        image::Rgb(std::array::from_fn(|k| {
            (128.0 + GAIN * (f32::from(q[k]) - f32::from(p[k]))).clamp(0.0, 255.0) as u8
        }))
    })
}

/// Returns the crop as a JPEG data URI of good quality.
pub fn data_uri(picture: &RgbImage) -> String {
    let mut bytes = Vec::new();
    JpegEncoder::new_with_quality(&mut bytes, 88)
        .write_image(picture.as_raw(), picture.width(), picture.height(), image::ExtendedColorType::Rgb8)
        .expect("writing to memory");
    format!("data:image/jpeg;base64,{}", base64(&bytes))
}

fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for chunk in bytes.chunks(3) {
        let b = [chunk[0], *chunk.get(1).unwrap_or(&0), *chunk.get(2).unwrap_or(&0)];
        let n = u32::from(b[0]) << 16 | u32::from(b[1]) << 8 | u32::from(b[2]);
        for k in 0..4 {
            let digit = DIGITS[(n >> (18 - 6 * k) & 63) as usize] as char;
            text.push(if k <= chunk.len() { digit } else { '=' });
        }
    }
    text
}

#[cfg(test)]
mod tests {
    #[test]
    fn base64_is_that_of_rfc_4648() {
        for (plain, coded) in [("", ""), ("f", "Zg=="), ("fo", "Zm8="), ("foo", "Zm9v"), ("foobar", "Zm9vYmFy")] {
            assert_eq!(super::base64(plain.as_bytes()), coded);
        }
    }
}
