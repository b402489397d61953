//! Compares the GPU with the CPU on complete files: time and quality of encodes, and time of decodes.
//!
//! ```text
//! cargo run --release -p ssplat-lab --features gpu --example gpu_encode -- PICTURE...
//! cargo run --release -p ssplat-lab --features gpu --example gpu_encode -- PICTURE... --crop 128 --seeds 2
//! ```
//!
//! The first form prints a row for each picture and effort. The time of an encode is that of one run, including
//! opening the GPU and compiling its shaders, as in the program. That of a decode to 8-bit samples in memory is the
//! fastest of `--repeat`; on the GPU it excludes opening the device, and the first decode is given as well.
//!
//! The second form encodes the middle of each picture with and without a detail layer and with several seeds, and
//! prints by how much the GPU's files are better. Single fits scatter by 0.2 dB, so only the means tell something.
//!
//! The built binary needs nothing but its arguments and a driver, so it can be copied to a machine with a GPU.
//! `--any-adapter` also accepts software renderers, to check that it runs.

use std::error::Error;
use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::Parser;
use ssplat::gpu::{Adapters, Device, Renderer};
use ssplat::unstable::EncodeOptions;
use ssplat::{Backend, Depth, Detail, Encoded, Limits, PixelSource, Pixels, Reader, Rect, SsplatImage, Target, Tune};
use ssplat_cli::perceived;

type Result<T> = std::result::Result<T, Box<dyn Error>>;

/// Compare encodes and decodes on the GPU with those on the CPU
#[derive(Debug, Parser)]
struct Args {
    /// The pictures
    #[arg(required = true)]
    pictures: Vec<PathBuf>,
    /// Encoding efforts
    #[arg(long, value_delimiter = ',', default_value = "2,5")]
    efforts: Vec<u8>,
    /// Ratio of 8-bit sample bytes to file bytes
    #[arg(long, default_value_t = 50.0)]
    ratio: f64,
    /// What to optimize for [default: iq; psnr with --crop]
    #[arg(long, value_parser = ssplat_cli::names::tune())]
    tune: Option<Tune>,
    /// Fit in tiles with this side, pixels
    #[arg(long)]
    tiles: Option<u32>,
    /// Compare fits of the middle of each picture with this side, pixels
    #[arg(long)]
    crop: Option<u32>,
    /// Encode crops without a detail layer (off), with half of the bytes for the Gaussians (half), or both
    #[arg(long, value_delimiter = ',', default_value = "off,half", value_parser = ["off", "half"])]
    layers: Vec<String>,
    /// Fits of each crop
    #[arg(long, default_value_t = 1)]
    seeds: u64,
    /// Repetitions of each decode; the fastest counts
    #[arg(long, default_value_t = 5)]
    repeat: u32,
    /// Accept a software renderer
    #[arg(long)]
    any_adapter: bool,
}

fn main() -> Result<()> {
    let args = Args::parse();
    let device = Device::open(if args.any_adapter { Adapters::Any } else { Adapters::Hardware })?;
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    println!("{}, {threads} threads, ratio {}.\n", device.name(), args.ratio);
    match args.crop {
        Some(side) => compare_crops(&args, side),
        None => compare_files(&args, &device),
    }
}

fn options(args: &Args, effort: u8, backend: Backend) -> EncodeOptions {
    let mut options = EncodeOptions::default();
    (options.target, options.effort, options.backend) = (Target::Ratio(args.ratio), effort, backend);
    (options.tune, options.tiles) = (args.tune, args.tiles);
    options
}

fn opened(path: &Path) -> Result<Pixels> {
    Ok(Pixels::try_from(image::open(path)?)?)
}

fn name(path: &Path) -> String {
    path.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

/// Prints a table of encodes and one of decodes.
fn compare_files(args: &Args, device: &Device) -> Result<()> {
    println!("| picture | effort | device | encode s | bytes | dB | points | Gaussians |");
    println!("|---|--:|---|--:|--:|--:|--:|--:|");
    let mut decodes = Vec::new();
    for path in &args.pictures {
        let pixels = opened(path)?;
        for &effort in &args.efforts {
            for backend in [Backend::Cpu, Backend::Gpu] {
                let clock = Instant::now();
                let encoded = ssplat::unstable::encode(&pixels, &options(args, effort, backend))?;
                let seconds = clock.elapsed().as_secs_f64();
                let Encoded { bytes, report, .. } = encoded;
                let found = read(&bytes)?;
                let points = perceived::measure(&pixels, &found.render(&found.view())?).ssimulacra2;
                println!(
                    "| {} | {effort} | {} | {seconds:.2} | {} | {:.2} | {} | {} |",
                    name(path),
                    report.chosen.device,
                    bytes.len(),
                    report.psnr,
                    points.map_or("–".to_owned(), |points| format!("{points:.1}")),
                    report.gaussians,
                );
                if backend == Backend::Cpu && Some(&effort) == args.efforts.last() {
                    decodes.push(decoded(args, device, &name(path), &bytes)?);
                }
            }
        }
    }
    println!("\n| picture | size | decode ms: CPU | GPU | GPU, first |");
    println!("|---|--:|--:|--:|--:|");
    decodes.iter().for_each(|row| println!("{row}"));
    Ok(())
}

fn read(bytes: &[u8]) -> Result<SsplatImage> {
    Ok(Reader::new(bytes, &Limits::default())?.read()?)
}

/// Decodes a file on both devices. Returns a row of the table.
fn decoded(args: &Args, device: &Device, name: &str, bytes: &[u8]) -> Result<String> {
    let on_cpu = || -> Result<Pixels> {
        let opened = read(bytes)?;
        Ok(opened.render(&opened.view())?)
    };
    let on_gpu = || -> Result<Pixels> {
        let opened = read(bytes)?;
        Ok(Renderer::of(device, &opened)?.render(&opened.view(), Depth::Eight)?)
    };
    let timed = |decode: &dyn Fn() -> Result<Pixels>| -> Result<[f64; 2]> {
        let mut times = Vec::new();
        for _ in 0..args.repeat.max(1) {
            let clock = Instant::now();
            decode()?;
            times.push(1e3 * clock.elapsed().as_secs_f64());
        }
        Ok([times[0], times.iter().copied().fold(f64::INFINITY, f64::min)])
    };
    let ([_, cpu], [first, gpu]) = (timed(&on_cpu)?, timed(&on_gpu)?);
    let size = read(bytes)?.view();
    Ok(format!("| {name} | {} × {} | {cpu:.1} | {gpu:.1} | {first:.1} |", size.width(), size.height()))
}

/// Encodes the middle of each picture on both devices. Prints by how much the GPU is better, and the means of each
/// effort.
fn compare_crops(args: &Args, side: u32) -> Result<()> {
    println!("| crop | effort | layer | CPU dB | GPU − CPU, dB, by seed | mean |");
    println!("|---|--:|---|--:|---|--:|");
    let mut means = Vec::new();
    for &effort in &args.efforts {
        for layer in &args.layers {
            let detail = if layer == "half" { Detail::GaussianShare(0.5) } else { Detail::Off };
            let mut of_crops = Vec::new();
            for path in &args.pictures {
                let pixels = opened(path)?;
                let [x, y] = [pixels.width(), pixels.height()].map(|length| length.saturating_sub(side) / 2);
                let crop = pixels.part(Rect::new(x, y, side.min(pixels.width()), side.min(pixels.height())))?;
                let (mut of_cpu, mut differences) = (Vec::new(), Vec::new());
                for seed in 0..args.seeds {
                    let psnr = |backend| -> Result<f64> {
                        let mut options = options(args, effort, backend);
                        (options.detail, options.seed) = (detail, seed);
                        options.tune = Some(args.tune.unwrap_or(Tune::Psnr));
                        Ok(ssplat::unstable::encode(&crop, &options)?.report.psnr)
                    };
                    let cpu = psnr(Backend::Cpu)?;
                    of_cpu.push(cpu);
                    differences.push(psnr(Backend::Gpu)? - cpu);
                }
                let list = differences.iter().map(|d| format!("{d:+.2}")).collect::<Vec<_>>().join(" ");
                let cpu = mean(&of_cpu);
                println!("| {} | {effort} | {layer} | {cpu:.2} | {list} | {:+.3} |", name(path), mean(&differences));
                of_crops.push(mean(&differences));
            }
            means.push((effort, layer, mean(&of_crops), of_crops.iter().copied().fold(f64::INFINITY, f64::min)));
        }
    }
    println!("\n| effort | layer | mean of the crops | lowest |");
    println!("|--:|---|--:|--:|");
    for (effort, layer, mean, least) in means {
        println!("| {effort} | {layer} | {mean:+.3} | {least:+.3} |");
    }
    Ok(())
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}
