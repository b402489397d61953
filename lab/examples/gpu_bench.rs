//! Speed of a GPU in fitting and decoding: steps per second, seconds to a quality, frames per second, and memory.
//!
//! ```text
//! cargo run --release -p ssplat-lab --features gpu --example gpu_bench -- [CASE...] [--steps N] [--looks N] [--cpu-adapter]
//! ```
//!
//! Cases: `tiny` (64×48, for software adapters), `kodak` (768×512), `24mp` (6000×4000), `paper` (10848×16320, the
//! largest picture of the SmartSplat paper), at ratio 50 (`tiny`: 20, `paper`: 200). As in the paper, a primitive
//! counts as seven bytes. The default cases are `kodak`, `24mp` and `paper`; on software adapters, which are used only
//! with `--cpu-adapter`, `tiny` and `kodak` with 100 steps. The pictures are synthetic: edges, texture and shading at
//! all scales. If a case fails, its error is printed and the next one runs.
//!
//! `--steps 2 --looks 1` checks on any machine that a large case runs. Nothing converges in fewer than 50 steps, and
//! times relative to convergence are left out. Pictures of two megapixels and more are fitted at half their size in
//! the first 70 % of the steps, so that the steps of a short run are faster.
//!
//! "Converged" is the end of the schedule. The paper's two marks, 30.5 and 31.9 dB, are 1.4 dB apart. Since the
//! picture differs, the times given here are those to converged − 1.4 dB and to converged − 0.1 dB, interpolated
//! between `--looks` (40) measurements of the whole picture. They include everything between steps, such as
//! relocation, but neither the measurements nor the setup: initialization on the CPU and copying the picture to the
//! device. A frame is the whole picture in 8-bit RGBA in a buffer on the device.
//!
//! Memory on the device is what the driver reserves, in blocks of 64 MB and more. Memory on the host is the peak of
//! the program, over all cases so far (`–`: unknown). The host needs about 4.6 GB for `paper`.

use std::io::Write;
use std::num::NonZero;
use std::ops::ControlFlow;
use std::time::Instant;

use ssplat::View;
use ssplat::gpu::wgpu_30::{self, wgpu};
use ssplat::gpu::{Adapters, Device, Renderer, fit};
use ssplat::{Blend, Channels, Limits, Pixels, Rect, Samples};

type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

/// A picture and the parameters of its fit.
struct Case {
    name: &'static str,
    size: [u32; 2],
    ratio: u64,
    steps: u32,
}

const CASES: [Case; 4] = [
    Case { name: "tiny", size: [64, 48], ratio: 20, steps: 100 },
    Case { name: "kodak", size: [768, 512], ratio: 50, steps: 1000 },
    Case { name: "24mp", size: [6000, 4000], ratio: 50, steps: 1000 },
    Case { name: "paper", size: [10848, 16320], ratio: 200, steps: 1000 },
];

/// Minimum number of steps of a schedule whose end is considered converged.
const MIN_CONVERGING_STEPS: u32 = 50;

/// Maximum buffer size of wgpu's default limits, bytes.
const MAX_BUFFER: u64 = 256 << 20;

fn main() -> Result<()> {
    let mut arguments = std::env::args().skip(1);
    let (mut names, mut steps, mut looks, mut adapters) = (Vec::new(), None, 40, Adapters::Hardware);
    while let Some(argument) = arguments.next() {
        let mut number = || -> Result<u32> {
            let text = arguments.next().ok_or(format!("{argument} needs a number"))?;
            Ok(text.parse::<NonZero<u32>>().map_err(|e| format!("{argument} {text}: {e}"))?.get())
        };
        match argument.as_str() {
            "--steps" => steps = Some(number()?),
            "--looks" => looks = number()?,
            "--cpu-adapter" => adapters = Adapters::Any,
            name => names.push(CASES.iter().find(|c| c.name == name).ok_or(format!("no case {name}"))?),
        }
    }
    let device = Device::open(adapters)?;
    // A software renderer would take hours for the large cases.
    let (usual, usual_steps) = if device.is_software() { (&CASES[..2], Some(100)) } else { (&CASES[1..], None) };
    if names.is_empty() {
        names = usual.iter().collect();
    }
    println!("Adapter: {}; {}.\n", device.name(), device.reason());
    println!(
        "| case | size | primitives | setup s | steps | steps/s | converged dB | s to −1.4 dB | s to −0.1 dB | s in all \
         | frames/s | MB device / host | rows of a slab / band |"
    );
    println!("|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|");
    let mut failed = 0;
    for case in names {
        match run(&device, case, steps.or(usual_steps).unwrap_or(case.steps), looks) {
            Ok(row) => println!("{row}"),
            Err(e) => {
                println!("| {} | failed: {e} |", case.name);
                failed += 1;
            }
        }
        std::io::stdout().flush()?;
    }
    if failed > 0 { Err(format!("{failed} cases failed").into()) } else { Ok(()) }
}

/// Measures a case; returns its row of the table.
fn run(device: &Device, case: &Case, steps: u32, looks: u32) -> Result<String> {
    let [width, height] = case.size;
    eprintln!("{}: drawing the picture", case.name);
    let pixels = Pixels::new(width, height, Channels::Rgb, Samples::U8(scene(width, height)))?;
    let count = (3 * u64::from(width) * u64::from(height) / (7 * case.ratio)) as u32;
    let mut points: Vec<(f64, f64)> = Vec::new();
    let mut memory = 0;
    eprintln!("{}: setting up {count} primitives", case.name);
    let fitted = fit(device, &pixels, Blend::Normalized, count, steps, 0, &mut |look| {
        if look.step().is_multiple_of(steps.div_ceil(looks)) {
            let (psnr, seconds) = look.psnr()?;
            points.push((psnr, seconds));
            memory = memory.max(held(device).unwrap_or(0));
            eprintln!("{}: step {}, {psnr:.2} dB after {seconds:.1} s", case.name, look.step());
        }
        Ok(ControlFlow::Continue(()))
    })?;
    points.push((fitted.psnr, fitted.seconds));
    drop(pixels);
    let frames = frames(device, &fitted.picture)?;
    memory = memory.max(held(device).unwrap_or(0));
    let megabytes = |bytes: u64| if bytes == 0 { "–".to_owned() } else { (bytes >> 20).to_string() };
    let relative = |text: String| if steps < MIN_CONVERGING_STEPS { "–".to_owned() } else { text };
    let seconds_to = |below: f64| relative(format!("{:.1}", time_to(&points, fitted.psnr - below)));
    let [slab, band, _] = fitted.bands;
    Ok(format!(
        "| {} | {width} × {height} | {} | {:.1} | {steps} | {} | {} | {} | {} | {:.1} | {} | {} / {} | {slab} / {band} |",
        case.name,
        fitted.picture.list.len(),
        fitted.setup_seconds,
        rate(f64::from(steps) / fitted.seconds),
        relative(format!("{:.2}", fitted.psnr)),
        seconds_to(1.4),
        seconds_to(0.1),
        fitted.seconds,
        rate(frames),
        megabytes(memory),
        megabytes(host_peak()),
    ))
}

/// Formats a number per second: with three decimals below 1, else with one.
fn rate(per_second: f64) -> String {
    if per_second < 1.0 { format!("{per_second:.3}") } else { format!("{per_second:.1}") }
}

/// Returns the time at which the quality was first reached, in seconds, interpolated between two measurements.
fn time_to(points: &[(f64, f64)], psnr: f64) -> f64 {
    let Some(i) = points.iter().position(|p| p.0 >= psnr) else { return f64::NAN };
    let (after, before) = (points[i], points[i.saturating_sub(1)]);
    if i == 0 { after.1 } else { before.1 + (after.1 - before.1) * (psnr - before.0) / (after.0 - before.0) }
}

/// Frames per second.
fn frames(device: &Device, picture: &ssplat::Gaussians) -> Result<f64> {
    let [width, height] = [picture.width, picture.height];
    let mut renderer = Renderer::new(device, picture, &Limits::default())?;
    // Equal parts that fit into a buffer; a frame is all of them. They are equal so that all are rendered with the
    // same buffers.
    let most = MAX_BUFFER / (4 * u64::from(width));
    let parts = (1..=height).find(|n| height.is_multiple_of(*n) && u64::from(height / n) <= most).unwrap_or(height);
    let rows = height / parts;
    let full = View::new(picture.width, picture.height);
    let mut views = Vec::new();
    for y in (0..height).step_by(rows as usize) {
        views.push(full.crop(Rect::new(0, y, width, rows))?);
    }
    let buffer = wgpu_30::device_and_queue(device).0.create_buffer(&wgpu::BufferDescriptor {
        label: Some("frame"),
        size: u64::from(rows) * u64::from(width) * 4,
        usage: wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    });
    let mut frame = || -> Result<()> {
        for view in &views {
            wgpu_30::render_to_buffer(&mut renderer, view, &buffer)?;
        }
        wgpu_30::device_and_queue(device).0.poll(wgpu::PollType::wait_indefinitely())?;
        Ok(())
    };
    // The first frame creates the buffers, and its time determines the number of frames.
    frame()?;
    let (clock, mut done) = (Instant::now(), 0);
    while done == 0 || clock.elapsed().as_secs_f64() < 2.0 {
        frame()?;
        done += 1;
    }
    Ok(f64::from(done) / clock.elapsed().as_secs_f64())
}

/// Returns the bytes that the driver reserves for the device, if it reports them.
fn held(device: &Device) -> Option<u64> {
    wgpu_30::device_and_queue(device).0.generate_allocator_report().map(|r| r.total_reserved_bytes)
}

/// Returns the peak memory of the program so far, bytes; 0 if the system does not report it.
fn host_peak() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let kilobytes = status.lines().find_map(|l| l.strip_prefix("VmHWM:")?.split_whitespace().next()?.parse().ok());
    kilobytes.unwrap_or(0u64) << 10
}

/// Shading, edges and texture at all scales.
fn scene(width: u32, height: u32) -> Vec<u8> {
    let row_size = width as usize * 3;
    let mut out = vec![0; height as usize * row_size];
    let threads = std::thread::available_parallelism().map_or(1, NonZero::get);
    // Distribute single rows, so that all threads get a share of each part of the picture.
    let mut parts: Vec<Vec<(usize, &mut [u8])>> = (0..threads).map(|_| Vec::new()).collect();
    for (y, row) in out.chunks_exact_mut(row_size).enumerate() {
        parts[y % threads].push((y, row));
    }
    std::thread::scope(|scope| {
        for part in parts {
            scope.spawn(move || part.into_iter().for_each(|(y, row)| scene_row(width, height, y as u32, row)));
        }
    });
    out
}

fn scene_row(width: u32, height: u32, y: u32, row: &mut [u8]) {
    let unit = 1.0 / width.max(height) as f32;
    for (x, pixel) in (0..width).zip(row.chunks_exact_mut(3)) {
        let (u, v) = (x as f32 * unit, y as f32 * unit);
        let mut texture = 0.0;
        for octave in 0..7 {
            let f = 7.0 * (1 << octave) as f32;
            let bend = (0.5 * f * (u - v) + octave as f32).sin();
            texture += ((f * u + bend).sin() * (f * v - bend).cos()) / (octave as f32 + 2.0);
        }
        let edge = f32::from((13.0 * u + (9.0 * v).sin() * 3.0).fract() > 0.5);
        // The texture is in patches, because pictures are smooth in most places.
        let patch = (0.5 + 0.5 * (5.0 * u + 3.0).sin() * (4.0 * v).cos()).powi(2);
        for (k, sample) in pixel.iter_mut().enumerate() {
            let shade = 0.5 + 0.25 * (3.0 * u + 2.0 * v + k as f32).sin();
            let value = shade + 0.2 * patch * texture + 0.2 * (edge - 0.5);
            *sample = (value.clamp(0.0, 1.0) * 255.0 + 0.5) as u8;
        }
    }
}
