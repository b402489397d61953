//! Tests with pictures of 177 megapixels within wgpu's default limits. They take minutes and gigabytes on software
//! Vulkan and therefore run only on request:
//!
//! ```text
//! cargo test --release -p ssplat --features gpu --lib -- --ignored --nocapture --test-threads 1 largest_picture
//! ```

use std::time::Instant;

use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

use super::device::{Adapters, Device};
use super::fit::Fitter;
use super::renderer::Renderer;
use crate::fit::engine::Engine;
use crate::fit::model::adam::{Bounds, Rates};
use crate::fit::model::drawing::field::Output;
use crate::fit::model::drawing::project::{self, Primitive};
use crate::fit::model::objective::planes::Planes;
use crate::fit::model::objective::rows::RowSet;
use crate::fit::model::placing::{removal, sample};
use crate::fit::model::problem::{Problem, Scene};
use crate::fit::state::State;
use crate::gaussian::{Blend, Channels, Gaussians};
use crate::pixels::{Depth, Pixels, Samples};
use crate::raster::{self, View};
use crate::rect::Rect;
use crate::{Limits, parallel};

/// The largest picture of the SmartSplat paper.
const WIDTH: u32 = 10_848;
const HEIGHT: u32 = 16_320;

/// Waves of many lengths and an edge, as sums of a function of the column and one of the row, which are cheap to
/// compute.
fn pixels() -> Pixels {
    let waves = |length: u32, by: f32| -> Vec<f32> {
        let wave = |i: u32, period: f32| 0.08 * (i as f32 * by / period).sin();
        (0..length).map(|i| wave(i, 11.0) + wave(i, 60.0) + wave(i, 300.0) + wave(i, 2000.0)).collect()
    };
    let (across, down) = (waves(WIDTH, 1.0), waves(HEIGHT, 0.7));
    let row = WIDTH as usize * 3;
    let mut samples = vec![0u8; row * HEIGHT as usize];
    parallel::map_chunks(&mut samples, row, |y, out| {
        for (x, pixel) in out.chunks_exact_mut(3).enumerate() {
            let edge = f32::from((x * 3 + y * 2) % 1700 > 900) * 0.2;
            for (k, sample) in pixel.iter_mut().enumerate() {
                let value = 0.4 + across[(x + 5 * k) % across.len()] + down[y] + edge;
                *sample = (value * 255.0).clamp(0.0, 255.0) as u8;
            }
        }
    });
    Pixels::new(WIDTH, HEIGHT, Channels::Rgb, Samples::U8(samples)).unwrap()
}

/// Fits `count` primitives for two steps and a relocation, and renders the first `rows` rows. Every part is compared
/// with the CPU.
fn fit_and_draw(count: usize, rows: u32) {
    let device = Device::open(Adapters::Any).unwrap();
    let clock = Instant::now();
    let mut last = clock;
    let mut note = |what: &str| {
        eprintln!("{what}: {:.1} s", last.elapsed().as_secs_f64());
        last = Instant::now();
    };
    eprintln!("adapter: {}", device.name());
    let pixels = pixels();
    let target = Planes::new(&pixels);
    let scene = Scene { width: WIDTH, height: HEIGHT, blend: Blend::Normalized, background: target.mean };
    let problem = Problem { scene, target: &target };
    let primitives = sample::by_detail(&target, count, &mut Pcg64Mcg::seed_from_u64(0));
    let mut cpu = State::new(primitives, Bounds::new(WIDTH, HEIGHT));
    note("picture and start, CPU");
    let mut fitter = Fitter::new(&device, &problem, Depth::Eight, &cpu.primitives, &cpu.bounds).unwrap();
    drop(pixels);
    note("bringing them to the device");

    // A truncated list would change the error, and the removal costs of the primitives that it lacks.
    let few = RowSet { step: 16, phase: 3 };
    let (error, costs) = fitter.inspect_survey(few, |_, _, survey, _| (survey.error, survey.costs.clone())).unwrap();
    note("survey of one row in 16");
    let projected = project::all(&cpu.primitives, HEIGHT);
    let want = cpu.field.draw(&problem, &projected, few, Output::Picture);
    let wanted = removal::costs(&problem, &cpu.field, few, &projected);
    note("the same, CPU");
    assert!((error / want - 1.0).abs() < 1e-5, "{error} against {want}");
    let far = costs.iter().zip(&wanted).filter(|(a, b)| (*a - *b).abs() > 1e-3 * (b.abs() + 1e-3)).count();
    eprintln!("squared error {error:.3}, CPU {want:.3}; {far} of {count} costs differ by more than 1e-3");
    assert!(far * 1000 <= costs.len(), "{far} costs");

    let rates = Rates { mean: 0.3, log_scale: 0.3, rotation: 0.15, color: 0.01, decay: [0.9, 0.95] };
    let step = scene.row_step(count);
    for phase in 0..2 {
        let rows = RowSet { step, phase };
        fitter.descend(&problem, rows, rates).unwrap();
        fitter.settle().unwrap();
        note(&format!("step over one row in {step}"));
        cpu.descend(&problem, rows, rates);
        note("the same, CPU");
    }
    let got = fitter.primitives().unwrap();
    // Adam's first steps depend on the gradients' signs. Where a gradient is about zero, rounding determines its sign.
    let off = |a: &Primitive, b: &Primitive| (0..2).any(|k| (a.mean[k] - b.mean[k]).abs() > 0.01);
    let far = got.iter().zip(&cpu.primitives).filter(|(a, b)| off(a, b)).count();
    eprintln!("{far} of {count} means are more than .01 pixels from those of the CPU");
    assert!(got.len() == count && far * 50 <= count, "{far} of {count}");
    drop(cpu);

    let sampled = RowSet { step: step.div_ceil(2), phase: 0 };
    let moved = fitter.relocate(&problem, sampled, count / 10).unwrap();
    note(&format!("relocation of {moved}"));
    assert!(moved > 0);
    let bands = fitter.sizes();
    eprintln!("target in slabs of {} rows, bands of {} sampled rows, lists of {} pairs", bands[0], bands[1], bands[2]);
    assert_eq!(bands[..2], [3093, 768], "lists overflowed, or sizes have changed");
    let held =
        |device: &Device| device.wgpu().0.generate_allocator_report().map_or(0, |r| r.total_reserved_bytes >> 20);
    eprintln!("device memory for the fit: {} MB", held(&device));
    drop(target);
    assert_first_rows_are_the_cpus(&device, gaussians(&mut fitter, &scene), rows);
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let peak = status.lines().find(|l| l.starts_with("VmHWM")).unwrap_or_default();
    eprintln!("{count} primitives: {:.0} s in all; host: {peak}", clock.elapsed().as_secs_f64());
}

/// Returns the picture that `fitter` has fitted.
fn gaussians(fitter: &mut Fitter, scene: &Scene) -> Gaussians {
    Gaussians {
        width: WIDTH,
        height: HEIGHT,
        channels: Channels::Rgb,
        depth: Depth::Eight,
        blend: scene.blend,
        background: scene.background,
        list: fitter.primitives().unwrap().into_iter().map(Primitive::to_gaussian).collect(),
    }
}

/// Renders the first `rows` rows of `picture` and compares some of them with the CPU.
fn assert_first_rows_are_the_cpus(device: &Device, picture: Gaussians, rows: u32) {
    let mut renderer = Renderer::new(device, &picture, &Limits::default()).unwrap();
    let view = View::new(picture.width, picture.height).crop(Rect::new(0, 0, WIDTH, rows)).unwrap();
    let clock = Instant::now();
    let Samples::U8(drawn) = renderer.render(&view, Depth::Eight).unwrap().into_samples() else { panic!("8 bits") };
    eprintln!("drawing {rows} rows, bands of {} rows: {:.1} s", renderer.bands().0, clock.elapsed().as_secs_f64());
    // At the seam of two bands.
    let first = (renderer.bands().0 - 32).min(rows - 64);
    let part = view.crop(Rect::new(0, first, WIDTH, 64)).unwrap();
    let want = raster::Renderer::new(&picture, &part, &Limits::default()).unwrap().render(Depth::Eight).unwrap();
    let Samples::U8(want) = want.into_samples() else { panic!("8 bits") };
    let off: Vec<u8> =
        drawn[first as usize * WIDTH as usize * 3..].iter().zip(&want).map(|(a, b)| a.abs_diff(*b)).collect();
    let (worst, differ) = (off.iter().max().unwrap(), off.iter().filter(|&&d| d > 0).count());
    eprintln!("rows {first}..{}: {differ} of {} samples differ, by at most {worst}", first + 64, off.len());
    assert!(*worst <= 1);
}

#[test]
#[ignore = "minutes and gigabytes on software Vulkan"]
fn the_largest_picture_of_the_paper_is_fitted_and_rendered() {
    fit_and_draw(379_367, HEIGHT);
}

#[test]
#[ignore = "minutes and gigabytes on software Vulkan"]
fn the_largest_picture_of_the_paper_takes_1300000_primitives() {
    fit_and_draw(1_300_000, 3_200);
}
