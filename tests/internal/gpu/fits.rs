//! Tests that a fit may move between the CPU and a GPU at any time, and is as good on both.

use super::device::Device;
use super::fit::{Fitter, packed};
use super::tests::stages::{RATES, crop, decibels, device, mean, planes, primitives, scattered};
use crate::effort::EffortSettings;
use crate::fit;
use crate::fit::engine::{Engine, Unwatched};
use crate::fit::job::Job;
use crate::fit::model::adam::Bounds;
use crate::fit::model::drawing::field::float_error;
use crate::fit::model::drawing::project::Primitive;
use crate::fit::model::objective::planes::Planes;
use crate::fit::model::objective::rows::RowSet;
use crate::fit::model::problem::{Problem, Scene};
use crate::fit::plan::Plan;
use crate::fit::state::State;
use crate::gaussian::Blend;
use crate::options::Tune;
use crate::pixels::{Depth, Pixels};

fn scene(pixels: &Pixels, target: &Planes) -> Scene {
    let (width, height) = (pixels.width(), pixels.height());
    Scene { width, height, blend: Blend::Normalized, background: target.mean }
}

/// Asserts that nearly all parameters agree. Where a gradient is about zero, rounding determines its sign, on which
/// Adam's steps depend.
#[track_caller]
fn assert_near(got: &[Primitive], want: &[Primitive]) {
    assert_eq!(got.len(), want.len());
    let flat =
        |all: &[Primitive]| -> Vec<f32> { all.iter().flat_map(|p| bytemuck::cast::<_, [f32; 9]>(packed(p))).collect() };
    let (got, want) = (flat(got), flat(want));
    let far = got.iter().zip(&want).filter(|(a, b)| (*a - *b).abs() > 1e-3 * (1.0 + b.abs())).count();
    assert!(far * 50 <= got.len(), "{far} of {} far", got.len());
}

#[test]
fn a_fit_continues_on_the_gpu_and_back_with_its_moments_and_its_price() {
    let Some(device) = device() else { return };
    let pixels = crop("kodim05", [300, 200], [96, 64]);
    let target = Planes::new(&pixels);
    let problem = Problem { scene: scene(&pixels, &target), target: &target };
    let rows = |phase| RowSet { step: 2, phase: phase % 2 };
    let mut cpu = scattered(&target, 200, 1);
    (0..7u32).for_each(|i| _ = cpu.descend(&problem, rows(i), RATES));
    cpu.survey(&problem, RowSet::ALL);
    assert!(cpu.price > 0.0);
    let mut gpu = Fitter::resuming(&device, &problem, Depth::Eight, &cpu).unwrap();
    for i in 0..2 {
        cpu.descend(&problem, rows(i), RATES);
        Engine::descend(&mut gpu, &problem, rows(i), RATES).unwrap();
    }
    assert_near(&gpu.primitives().unwrap(), &cpu.primitives);
    let mut back = gpu.finish().unwrap();
    let [returned, kept] = [&back, &cpu].map(State::progress);
    assert_eq!((returned.iteration, returned.price), (kept.iteration, kept.price));
    cpu.descend(&problem, rows(0), RATES);
    back.descend(&problem, rows(0), RATES);
    let [got, want] = [&back, &cpu].map(|state| float_error(&problem, &state.primitives));
    // Without its moments, the next step alone would change the error by several percent.
    assert!((got / want - 1.0).abs() < 1e-3, "{got} {want}");
}

#[test]
fn frozen_primitives_are_seen_and_stay_as_on_the_cpu() {
    let Some(device) = device() else { return };
    let pixels = crop("kodim05", [300, 200], [75, 61]);
    let target = planes(&pixels, true);
    let problem = Problem { scene: scene(&pixels, &target), target: &target };
    let mut all = primitives(75, 61, 100);
    let mut frozen = all.split_off(60);
    // As around a tile, some are centred outside.
    frozen.iter_mut().step_by(3).for_each(|p| p.mean[0] -= 40.0);
    let mut cpu = State::new(all, Bounds::new(75, 61));
    cpu.frozen.clone_from(&frozen);
    let mut gpu = Fitter::resuming(&device, &problem, Depth::Eight, &cpu).unwrap();
    let near = |a: f64, b: f64| assert!((a / b - 1.0).abs() < 1e-3, "{a} {b}");
    near(gpu.error(&problem).unwrap(), cpu.error(&problem).unwrap());
    let half = target.halved();
    let half_scene = Scene { width: 38, height: 31, ..problem.scene };
    let half = Problem { scene: half_scene, target: &half };
    for (to, by) in [(&half, 0.5), (&problem, 2.0)] {
        gpu.zoom(to, by).unwrap();
        cpu.zoom(to, by).unwrap();
        for phase in 0..2 {
            let rows = RowSet { step: 2, phase };
            State::descend(&mut cpu, to, rows, RATES);
            Engine::descend(&mut gpu, to, rows, RATES).unwrap();
        }
        near(gpu.error(&problem).unwrap(), cpu.error(&problem).unwrap());
    }
    // Only movable primitives are moved or removed, by costs in the presence of the others.
    let [moved, moved_on_cpu] = [
        gpu.relocate(&problem, RowSet::ALL, 6).unwrap(),
        Engine::relocate(&mut cpu, &problem, RowSet::ALL, 6).unwrap(),
    ];
    assert_eq!(moved, moved_on_cpu);
    for wanted in [50, 57] {
        gpu.resize(&problem, RowSet::ALL, wanted).unwrap();
        cpu.resize(&problem, RowSet::ALL, wanted).unwrap();
        assert_eq!([gpu.count(), cpu.count()], [wanted; 2]);
        near(gpu.error(&problem).unwrap(), cpu.error(&problem).unwrap());
    }
    let end = gpu.finish().unwrap();
    near(end.price.into(), cpu.price.into());
    assert_eq!(end.primitives.len(), 57);
    // Halving and doubling are exact up to the logarithms of scales.
    let stays = |a: &Primitive, b: &Primitive| {
        a.mean == b.mean && a.color == b.color && (a.log_scale[0] - b.log_scale[0]).abs() < 1e-5
    };
    assert!(end.frozen.len() == 40 && end.frozen.iter().zip(&frozen).all(|(a, b)| stays(a, b)));
}

/// Fits 60 primitives with the schedule of effort 1. Returns the PSNR on the GPU minus that on the CPU, dB, and by how
/// much the latter scatters.
///
/// A change of the start by 10⁻⁵ pixels changes the result by as much as another device does: 0.16 dB (standard
/// deviation). The CPU's result is therefore the mean over such starts.
fn compared(device: &Device, pixels: &Pixels, seed: u64) -> [f64; 2] {
    const COUNT: usize = 60;
    let target = Planes::new(pixels);
    let problem = Problem { scene: scene(pixels, &target), target: &target };
    let settings = EffortSettings::from_preset(1).fit;
    let plan = Plan::new(&settings, COUNT, problem.scene.pixels(), None, seed).alone(&settings, Tune::Psnr);
    let job = Job { problem, count: COUNT, plan: &plan };
    let of = |state: &State| decibels(float_error(&problem, &state.primitives), pixels);
    let on_cpu = |shift: f32| {
        let open = |mut start: State| {
            start.primitives.iter_mut().enumerate().for_each(|(i, p)| p.mean[i % 2] += shift);
            Ok(start)
        };
        of(&fit::fit(&job, open, &mut Unwatched).unwrap().by)
    };
    let cpu = [0.0, 1e-5, -1e-5, 3e-5, 1e-4].map(on_cpu);
    let open = |start| Fitter::resuming(device, &problem, pixels.depth(), &start);
    let gpu = of(&fit::fit(&job, open, &mut Unwatched).unwrap().finished().unwrap().by);
    let (mean, error) = mean(&cpu);
    [gpu - mean, error * (cpu.len() as f64).sqrt()]
}

#[test]
fn fits_of_a_whole_schedule_are_as_good_as_on_the_cpu() {
    let Some(device) = device() else { return };
    let (mut differences, mut scatters) = (Vec::new(), Vec::new());
    for (name, corner) in [("kodim15", [256, 192]), ("kodim15", [100, 100]), ("kodim05", [0, 0])] {
        let pixels = crop(name, corner, [64, 64]);
        for seed in 0..4 {
            let [difference, scatter] = compared(&device, &pixels, seed);
            eprintln!("{name} {corner:?}, seed {seed}: GPU {difference:+.3} dB, CPU ± {scatter:.3}");
            differences.push(difference);
            scatters.push(scatter);
        }
    }
    let ((of_gpu, error), (scatter, _)) = (mean(&differences), mean(&scatters));
    eprintln!("GPU {of_gpu:+.3} ± {error:.3} dB; a fit on the CPU ± {scatter:.3}");
    // The standard error of the mean is 0.04.
    assert!(of_gpu.abs() < 0.1, "{of_gpu}: {differences:?}");
}
