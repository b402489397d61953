//! Compares placeholders and previews at the same total size: ssplat, WebP and AVIF of a downscaled picture, ThumbHash
//! and BlurHash.
//!
//! ```sh
//! cargo run --release -p ssplat-lab --example tiny_files -- PICTURE... --bytes 40,300,1000
//! ```
//!
//! The picture is reduced to a fraction of its size, encoded by `cwebp` and `avifenc` (if installed) at the highest
//! quality that fits, decoded and enlarged with a Lanczos filter. The best fraction is reported. ThumbHash has a size
//! of its own (21 to 28 bytes) and is included where it fits. A BlurHash is text, whose letters count as bytes; the
//! best of those that fit is reported, with 1 × 1 to 9 × 9 components. The measure is PSNR against the original in
//! decibels.
//!
//! `--sheet FILE` also writes a contact sheet: for each picture the original, ThumbHash, the BlurHash with 4 × 3
//! components, and ssplat at each size.

use std::error::Error;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use clap::Parser;
use image::imageops::{self, FilterType};
use image::{ImageReader, RgbImage, RgbaImage};
use ssplat::unstable::metrics;
use ssplat::unstable::{DecodeOptions, EncodeOptions};
use ssplat::{Pixels, Target, Tune};

type Result<T> = std::result::Result<T, Box<dyn Error>>;

/// Reduction factors that are tried for the other codecs.
const FRACTIONS: [u32; 10] = [2, 3, 4, 6, 8, 12, 16, 24, 32, 48];

/// Compare tiny files with those of other codecs
#[derive(Debug, Parser)]
struct Args {
    /// The pictures
    #[arg(required = true)]
    pictures: Vec<PathBuf>,
    /// Total file sizes
    #[arg(long, value_delimiter = ',', default_value = "40,300,1000")]
    bytes: Vec<u64>,
    /// Effort of the ssplat encodes, 1 to 9
    #[arg(long, default_value_t = 5)]
    effort: u8,
    /// Also write a contact sheet, a PNG or JPEG
    #[arg(long, value_name = "FILE")]
    sheet: Option<PathBuf>,
}

/// Longer side of a picture in the contact sheet, pixels.
const TILE: u32 = 160;
/// Gap between two pictures in the contact sheet, pixels.
const GAP: u32 = 4;

fn main() -> Result<()> {
    let args = Args::parse();
    println!("| picture | bytes | ssplat | down+webp | down+avif | thumbhash | blurhash |");
    println!("|---|--:|--:|--:|--:|--:|--:|");
    let mut sheet: Vec<Vec<RgbImage>> = Vec::new();
    for path in args.pictures.iter().filter(|_| args.sheet.is_some()) {
        let picture = ImageReader::open(path)?.with_guessed_format()?.decode()?.into_rgb8();
        let hashes = [thumbhash(&picture, u64::MAX), blurhash(&picture, [4, 3])];
        sheet.push([Some(picture)].into_iter().chain(hashes).flatten().map(|p| tile(&p)).collect());
    }
    for &most in &args.bytes {
        let mut rows: Vec<[Option<f64>; 5]> = Vec::new();
        for (place, path) in args.pictures.iter().enumerate() {
            let picture = ImageReader::open(path)?.with_guessed_format()?.decode()?.into_rgb8();
            let psnr = |test: RgbImage| -> Result<f64> { Ok(metrics::psnr(&pixels(&picture)?, &pixels(&test)?)?) };
            let drawn = ours(&picture, most, args.effort)?;
            if let Some(tiles) = sheet.get_mut(place) {
                tiles.push(tile(&drawn));
            }
            let row = [
                Some(psnr(drawn)?),
                best(&picture, most, webp, &psnr)?,
                best(&picture, most, avif, &psnr)?,
                thumbhash(&picture, most).map(&psnr).transpose()?,
                best_blurhash(&picture, most, &psnr)?,
            ];
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            println!("| {name} | {most} | {} |", row.map(shown).join(" | "));
            rows.push(row);
        }
        let means: [Option<f64>; 5] = std::array::from_fn(|k| {
            let sum: Option<f64> = rows.iter().map(|r| r[k]).sum();
            sum.map(|s| s / rows.len() as f64)
        });
        let wins = |k: usize| rows.iter().filter(|r| r[k].is_none_or(|v| r[0] > Some(v))).count();
        println!("| **mean** | {most} | {} |", means.map(shown).join(" | "));
        let (n, w, a, t, b) = (rows.len(), wins(1), wins(2), wins(3), wins(4));
        println!("| ssplat ahead on | {most} | of {n} | {w} | {a} | {t} | {b} |");
    }
    if let Some(path) = &args.sheet {
        contact(&sheet).save(path)?;
    }
    Ok(())
}

/// Scales a picture to its size in the contact sheet.
fn tile(picture: &RgbImage) -> RgbImage {
    image::DynamicImage::ImageRgb8(picture.clone()).resize(TILE, TILE, FilterType::CatmullRom).into_rgb8()
}

/// Stacks the rows of the contact sheet.
fn contact(rows: &[Vec<RgbImage>]) -> RgbImage {
    let height = |row: &[RgbImage]| row.iter().map(RgbImage::height).max().unwrap_or(0) + GAP;
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0) as u32;
    let sides = [columns * (TILE + GAP) + GAP, rows.iter().map(|r| height(r)).sum::<u32>() + GAP];
    let mut sheet = RgbImage::from_pixel(sides[0], sides[1], image::Rgb([255; 3]));
    let mut top = GAP;
    for row in rows {
        for (picture, left) in row.iter().zip((GAP..).step_by((TILE + GAP) as usize)) {
            let inset = (TILE - picture.width()) / 2;
            imageops::replace(&mut sheet, picture, i64::from(left + inset), i64::from(top));
        }
        top += height(row);
    }
    sheet
}

fn shown(v: Option<f64>) -> String {
    v.map_or_else(|| "-".into(), |v| format!("{v:.2}"))
}

fn pixels(picture: &RgbImage) -> Result<Pixels> {
    Ok(Pixels::try_from(image::DynamicImage::ImageRgb8(picture.clone()))?)
}

fn ours(picture: &RgbImage, most: u64, effort: u8) -> Result<RgbImage> {
    let mut options = EncodeOptions::default();
    options.target = Target::Bytes(most);
    options.effort = effort;
    // The table has the PSNR of the other formats, too.
    options.tune = Some(Tune::Psnr);
    let bytes = ssplat::unstable::encode(&pixels(picture)?, &options)?.bytes;
    let decoded = ssplat::unstable::decode(&bytes, &DecodeOptions::default())?.pixels;
    let ssplat::Samples::U8(samples) = decoded.into_samples() else { return Err("not 8 bits".into()) };
    RgbImage::from_raw(picture.width(), picture.height(), samples).ok_or_else(|| "wrong size".into())
}

/// Writes a picture at a quality of 0 to 63, and returns the size of the file and the decoded picture; `None` if the
/// program is not installed.
type Codec = fn(&RgbImage, u32, &Path) -> Result<Option<(u64, RgbImage)>>;

/// Returns the PSNR of the best fraction and quality within `most` bytes.
fn best(picture: &RgbImage, most: u64, codec: Codec, psnr: &dyn Fn(RgbImage) -> Result<f64>) -> Result<Option<f64>> {
    let folder = tempfile::tempdir()?;
    let mut best: Option<f64> = None;
    for fraction in FRACTIONS {
        let [w, h] = [picture.width(), picture.height()].map(|v| (v / fraction).max(1));
        let small = imageops::resize(picture, w, h, FilterType::Lanczos3);
        let (mut good, mut bad) = (None, 64);
        let mut low = 0;
        while low < bad {
            let quality = (low + bad) / 2;
            let Some((bytes, decoded)) = codec(&small, quality, folder.path())? else { return Ok(None) };
            if bytes <= most {
                (good, low) = (Some(decoded), quality + 1);
            } else {
                bad = quality;
            }
        }
        if let Some(decoded) = good {
            let large = imageops::resize(&decoded, picture.width(), picture.height(), FilterType::Lanczos3);
            best = Some(best.unwrap_or(0.0).max(psnr(large)?));
        }
    }
    Ok(best)
}

fn webp(picture: &RgbImage, quality: u32, folder: &Path) -> Result<Option<(u64, RgbImage)>> {
    let (png, file) = (folder.join("small.png"), folder.join("small.webp"));
    picture.save(&png)?;
    let quality = (f64::from(quality) * 100.0 / 63.0).to_string();
    let arguments: [&str; 7] = ["-quiet", "-m", "6", "-q", &quality, "-o", &file.to_string_lossy()];
    if !run(Command::new("cwebp").args(arguments).arg(&png))? {
        return Ok(None);
    }
    Ok(Some((fs::metadata(&file)?.len(), image::open(&file)?.into_rgb8())))
}

fn avif(picture: &RgbImage, quality: u32, folder: &Path) -> Result<Option<(u64, RgbImage)>> {
    let (png, file, decoded) = (folder.join("small.png"), folder.join("small.avif"), folder.join("decoded.png"));
    picture.save(&png)?;
    let q = (63 - quality).to_string();
    if !run(Command::new("avifenc").args(["-s", "6", "--min", &q, "--max", &q]).args([&png, &file]))?
        || !run(Command::new("avifdec").args([&file, &decoded]))?
    {
        return Ok(None);
    }
    Ok(Some((fs::metadata(&file)?.len(), image::open(&decoded)?.into_rgb8())))
}

/// Runs `command`; returns false if there is no such program.
fn run(command: &mut Command) -> Result<bool> {
    match command.output() {
        Ok(output) if output.status.success() => Ok(true),
        Ok(output) => Err(format!("{command:?}: {}", String::from_utf8_lossy(&output.stderr)).into()),
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(false),
        Err(e) => Err(e.into()),
    }
}

fn thumbhash(picture: &RgbImage, most: u64) -> Option<RgbImage> {
    let longest = picture.width().max(picture.height());
    let [w, h] = [picture.width(), picture.height()].map(|v| (v * 100 / longest).max(1));
    let small = imageops::resize(picture, w, h, FilterType::Lanczos3);
    let small = image::DynamicImage::ImageRgb8(small).into_rgba8();
    let hash = thumbhash::rgba_to_thumb_hash(w as usize, h as usize, &small);
    if hash.len() as u64 > most {
        return None;
    }
    let (w, h, samples) = thumbhash::thumb_hash_to_rgba(&hash).ok()?;
    let decoded = RgbaImage::from_raw(w as u32, h as u32, samples)?;
    let decoded = image::DynamicImage::ImageRgba8(decoded).into_rgb8();
    Some(imageops::resize(&decoded, picture.width(), picture.height(), FilterType::Lanczos3))
}

/// Returns the PSNR of the best BlurHash of at most `most` letters.
fn best_blurhash(picture: &RgbImage, most: u64, psnr: &dyn Fn(RgbImage) -> Result<f64>) -> Result<Option<f64>> {
    let mut best: Option<f64> = None;
    let fits = |[x, y]: [u32; 2]| u64::from(4 + 2 * x * y) <= most;
    // Try only sizes that leave no room for another row or column.
    for x in 1..=9 {
        let Some(y) = (1..=9).rev().find(|&y| fits([x, y])) else { break };
        if let Some(decoded) = blurhash(picture, [x, y]) {
            best = Some(best.unwrap_or(0.0).max(psnr(decoded)?));
        }
    }
    Ok(best)
}

/// Returns the picture of the BlurHash with this many components.
fn blurhash(picture: &RgbImage, [x, y]: [u32; 2]) -> Option<RgbImage> {
    let [w, h] = [picture.width(), picture.height()].map(|v| v.div_ceil(4));
    let small = image::DynamicImage::ImageRgb8(imageops::resize(picture, w, h, FilterType::Lanczos3)).into_rgba8();
    let hash = blurhash::encode(x, y, w, h, &small).ok()?;
    let decoded = RgbaImage::from_raw(w, h, blurhash::decode(&hash, w, h, 1.0).ok()?)?;
    let decoded = image::DynamicImage::ImageRgba8(decoded).into_rgb8();
    Some(imageops::resize(&decoded, picture.width(), picture.height(), FilterType::Lanczos3))
}
