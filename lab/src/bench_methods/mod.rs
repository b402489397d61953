//! `ssplat-lab bench-methods`: compares published methods with ssplat, at the same number of Gaussians and at the same
//! file size.

mod ablation;
pub mod args;
mod contender;
mod page;
mod plot;

use std::fs::File;
use std::io::Write;
use std::path::Path;

use image::DynamicImage;
use image::imageops::FilterType;
use ssplat::{Channels, Pixels, Samples};

use contender::{Contender, Measured, Setup};
use ssplat_cli::failure::Failure;
use ssplat_cli::progress::Bar;
use ssplat_cli::sink::Sink;
use ssplat_cli::source::{self, Turn};

/// Bytes per Gaussian in SmartSplat's paper, which relate a ratio to a number of Gaussians.
const BYTES_PER_GAUSSIAN: f64 = 7.0;

/// One fit with its file.
struct Cell {
    picture: String,
    contender: Contender,
    setup: Setup,
    measured: Measured,
}

pub fn run(args: &args::BenchMethods) -> Result<(), Failure> {
    std::fs::create_dir_all(&args.out).map_err(|e| Failure::io(&args.out, &e))?;
    if args.ablation {
        return ablation::run(args);
    }
    let contenders = args.contenders();
    let sizes = if args.counts.is_empty() { args.ratios.len() } else { args.counts.len() };
    let all = args.images.len() * sizes * args.seeds.len() * contenders.len();
    // Rows are written as they are measured, so that an interrupted run keeps them.
    let rows = args.out.join("methods.csv");
    let mut file = File::create(&rows).map_err(|e| Failure::io(&rows, &e))?;
    writeln!(file, "{}", page::HEAD).map_err(|e| Failure::io(&rows, &e))?;
    let bar = Bar::new();
    let (mut cells, mut sides) = (Vec::new(), Vec::new());
    for path in &args.images {
        let picture = path.file_stem().unwrap_or(path.as_os_str()).to_string_lossy().into_owned();
        let pixels = opened(path, args.side)?;
        sides.push(format!("{picture} {} × {}", pixels.width(), pixels.height()));
        let raw = f64::from(pixels.width()) * f64::from(pixels.height()) * pixels.channels().count() as f64;
        let sizes: Vec<(u32, u64)> = if args.counts.is_empty() {
            args.ratios.iter().map(|r| ((raw / r / BYTES_PER_GAUSSIAN).max(1.0) as u32, (raw / r) as u64)).collect()
        } else {
            args.counts.iter().map(|&n| (n, (BYTES_PER_GAUSSIAN * f64::from(n)) as u64)).collect()
        };
        for (count, bytes) in sizes {
            for &contender in &contenders {
                for &seed in &args.seeds {
                    bar.show(cells.len() as f32 / all as f32, format!("{picture} {count} {}", contender.name()));
                    let iterations = contender.published_as().map_or(0, |method| args.iterations_of(method));
                    let setup = Setup { count, bytes, seed, iterations, effort: args.effort };
                    let measured = contender.measure(&pixels, &setup);
                    let cell = Cell { picture: picture.clone(), contender, setup, measured };
                    writeln!(file, "{}", page::row(&cell)).map_err(|e| Failure::io(&rows, &e))?;
                    cells.push(cell);
                }
            }
        }
    }
    for (name, text) in [("methods.md", page::markdown(&cells, args, &sides)), ("convergence.svg", plot::svg(&cells))] {
        Sink::create(&args.out.join(name), &[])?.finish_with(text.as_bytes())?;
    }
    Ok(())
}

/// Opens a picture in 8 bits without alpha, reduced to `side` if its longer side is larger.
fn opened(path: &Path, side: Option<u32>) -> Result<Pixels, Failure> {
    let pixels = source::open(path, Turn::Keep)?.pixels;
    let (width, height, channels) = (pixels.width(), pixels.height(), pixels.channels());
    let codes: Vec<u8> = match pixels.into_samples() {
        Samples::U8(samples) => samples,
        Samples::U16(samples) => samples.iter().map(|v| (v / 257) as u8).collect(),
    };
    let wrong = || Failure::usage(format!("{}: samples do not fill the picture", path.display()));
    let image = match channels {
        Channels::Grey => image::GrayImage::from_raw(width, height, codes).map(DynamicImage::from),
        Channels::GreyAlpha => image::GrayAlphaImage::from_raw(width, height, codes).map(DynamicImage::from),
        Channels::Rgb => image::RgbImage::from_raw(width, height, codes).map(DynamicImage::from),
        Channels::Rgba => image::RgbaImage::from_raw(width, height, codes).map(DynamicImage::from),
    }
    .ok_or_else(wrong)?;
    let image = match side {
        Some(side) if width.max(height) > side => image.resize(side, side, FilterType::Triangle),
        _ => image,
    };
    let image = image.to_rgb8();
    Pixels::new(image.width(), image.height(), Channels::Rgb, Samples::U8(image.into_raw()))
        .map_err(|e| Failure::library(path, &e))
}
