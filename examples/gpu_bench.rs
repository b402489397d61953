//! What a GPU makes of the fit and of decoding: steps per second, seconds to a quality, frames per second, memory.
//!
//! ```text
//! cargo run --release --features gpu --example gpu_bench -- [CASE...] [--steps N] [--cpu-adapter]
//! ```
//!
//! Cases: `tiny` (64×48, for software adapters), `kodak` (768×512), `24mp` (6000×4000), `paper` (10848×16320, the
//! largest picture of the SmartSplat paper), at ratio 50 (`paper`: 200) with seven bytes counted for a primitive, as
//! the paper counts. Without a case: `kodak`, `24mp` and `paper`; on software adapters, which are used only with
//! `--cpu-adapter`, `tiny` and `kodak` with 100 steps. The pictures are drawn by the program: edges, texture and
//! shading over all scales.
//!
//! "Converged" is the end of the schedule; the paper's two marks, 30.5 and 31.9 dB, lie 1.4 dB apart, so that the
//! times are those to converged − 1.4 dB and to converged − 0.1 dB (the picture differs, hence relative). They do not
//! count the setup: where the fit starts is found on the CPU, and the picture is brought to the device once.

use std::ops::ControlFlow;
use std::time::Instant;

use ssplat::gpu::{Adapters, Device, Renderer, fit};
use ssplat::raster::View;
use ssplat::{Blend, Channels, Limits, Pixels, Samples};

/// A picture and what it is fitted with.
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

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let (mut names, mut steps, mut adapters) = (Vec::new(), None, Adapters::Hardware);
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--steps" => steps = Some(arguments.next().ok_or("--steps needs a number")?.parse()?),
            "--cpu-adapter" => adapters = Adapters::Any,
            name => names.push(CASES.iter().find(|c| c.name == name).ok_or(format!("no case {name}"))?),
        }
    }
    let device = Device::open(adapters)?;
    // A program that acts as a GPU would take hours over the large cases.
    let (usual, usual_steps) = if device.is_software() { (&CASES[..2], Some(100)) } else { (&CASES[1..], None) };
    if names.is_empty() {
        names = usual.iter().collect();
    }
    let steps = steps.or(usual_steps);
    println!("adapter: {}; {}", device.name(), device.reason());
    println!(
        "| case | size | primitives | setup s | steps/s | converged dB | s to −1.4 dB | s to −0.1 dB | s for {} steps | frames/s | MB |",
        steps.map_or("all".to_owned(), |s| s.to_string())
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|");
    for case in names {
        run(&device, case, steps.unwrap_or(case.steps))?;
    }
    Ok(())
}

fn run(device: &Device, case: &Case, steps: u32) -> Result<(), Box<dyn std::error::Error>> {
    let [width, height] = case.size;
    let pixels = Pixels::new(width, height, Channels::Rgb, Samples::U8(scene(width, height)))?;
    let count = (3 * u64::from(width) * u64::from(height) / (7 * case.ratio)) as u32;
    let mut points: Vec<(f64, f64)> = Vec::new();
    let mut memory = 0;
    let fitted = fit(device, &pixels, Blend::Normalized, count, steps, 0, &mut |look| {
        if look.step().is_multiple_of((steps / 40).max(1)) {
            points.push(look.psnr()?);
            memory = memory.max(held(device));
        }
        Ok(ControlFlow::Continue(()))
    })?;
    let to = |below: f64| points.iter().find(|p| p.0 >= fitted.psnr - below).map_or(fitted.seconds, |p| p.1);
    let picture = &fitted.picture;
    let mut renderer = Renderer::new(device, picture, &Limits::default())?;
    // Parts that a buffer of wgpu's default limits holds; a frame is all of them.
    let parts = (u64::from(width) * u64::from(height)).div_ceil(64 << 20) as u32;
    let rows = height.div_ceil(parts);
    let full = View::full(picture);
    let mut views = Vec::new();
    for y in (0..height).step_by(rows as usize) {
        views.push(full.crop(0, y, width, rows.min(height - y))?);
    }
    let buffer = device.wgpu().0.create_buffer(&wgpu::BufferDescriptor {
        label: Some("frame"),
        size: u64::from(rows) * u64::from(width) * 4,
        usage: wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    });
    let frame = |renderer: &mut Renderer| views.iter().try_for_each(|v| renderer.render_to_buffer(v, &buffer));
    // The first frame makes the buffers.
    frame(&mut renderer)?;
    memory = memory.max(held(device));
    let (clock, mut frames) = (Instant::now(), 0);
    while frames < 3 || clock.elapsed().as_secs_f64() < 2.0 {
        frame(&mut renderer)?;
        frames += 1;
    }
    device.wgpu().0.poll(wgpu::PollType::wait_indefinitely())?;
    let fps = f64::from(frames) / clock.elapsed().as_secs_f64();
    println!(
        "| {} | {width}×{height} | {} | {:.1} | {:.1} | {:.2} | {:.1} | {:.1} | {:.1} | {fps:.1} | {} |",
        case.name,
        picture.gaussians.len(),
        fitted.setup_seconds,
        f64::from(steps) / fitted.seconds,
        fitted.psnr,
        to(1.4),
        to(0.1),
        fitted.seconds,
        memory >> 20,
    );
    let [slab, band, pairs] = fitted.bands;
    println!("  target in slabs of {slab} rows, bands of {band} sampled rows, lists of {pairs} pairs");
    Ok(())
}

/// Bytes that the driver holds for the device, where it says so.
fn held(device: &Device) -> u64 {
    device.wgpu().0.generate_allocator_report().map_or(0, |r| r.total_reserved_bytes)
}

/// Shading, edges and texture of all scales.
fn scene(width: u32, height: u32) -> Vec<u8> {
    let mut out = Vec::with_capacity(width as usize * height as usize * 3);
    let unit = 1.0 / width.max(height) as f32;
    for y in 0..height {
        for x in 0..width {
            let (u, v) = (x as f32 * unit, y as f32 * unit);
            let mut texture = 0.0;
            for octave in 0..7 {
                let f = 7.0 * (1 << octave) as f32;
                let bend = (0.5 * f * (u - v) + octave as f32).sin();
                texture += ((f * u + bend).sin() * (f * v - bend).cos()) / (octave as f32 + 2.0);
            }
            let edge = f32::from((13.0 * u + (9.0 * v).sin() * 3.0).fract() > 0.5);
            // Texture lies in patches: pictures are smooth in most places.
            let patch = (0.5 + 0.5 * (5.0 * u + 3.0).sin() * (4.0 * v).cos()).powi(2);
            for k in 0..3 {
                let shade = 0.5 + 0.25 * (3.0 * u + 2.0 * v + k as f32).sin();
                let value = shade + 0.2 * patch * texture + 0.2 * (edge - 0.5);
                out.push((value.clamp(0.0, 1.0) * 255.0 + 0.5) as u8);
            }
        }
    }
    out
}
