//! Tests that need private access: shader sources and layouts, and each stage compared with its twin.

use super::kernels::{Kernels, fold};
use super::scene::{Primitive, Splat, Uniforms};
use crate::gpu::kernels::Access;
pub(crate) use stages::own_device;
use wgpu::naga;

fn parsed(spec: &super::kernels::Spec) -> naga::Module {
    let source = spec.source();
    naga::front::wgsl::parse_str(&source).unwrap_or_else(|e| panic!("{}: {}", spec.entry, e.emit_to_string(&source)))
}

#[test]
fn every_shader_is_valid_and_within_default_limits() {
    use naga::valid::{Capabilities, ValidationFlags, Validator};
    for spec in Kernels::SPECS {
        let module = parsed(spec);
        // No capability beyond the core language: no subgroups, no float atomics.
        Validator::new(ValidationFlags::all(), Capabilities::empty())
            .validate(&module)
            .unwrap_or_else(|e| panic!("{}: {e:?}", spec.entry));
        let entry = module.entry_points.iter().find(|e| e.name == spec.entry).expect("entry point");
        let threads: u32 = entry.workgroup_size.iter().product();
        assert_eq!(threads, spec.threads, "{}", spec.entry);
        assert!(threads <= 256);
        assert!(spec.bindings.len() <= 8, "{} binds {}", spec.entry, spec.bindings.len());
        let mut layouter = naga::proc::Layouter::default();
        layouter.update(module.to_ctx()).unwrap();
        let mut shared = 0;
        for (_, global) in module.global_variables.iter() {
            match global.space {
                naga::AddressSpace::WorkGroup => shared += layouter[global.ty].size,
                naga::AddressSpace::Storage { access } => {
                    let binding = global.binding.expect("bound").binding as usize;
                    let write = access.contains(naga::StorageAccess::STORE);
                    let want = if write { Access::Write } else { Access::Read };
                    assert_eq!(spec.bindings.get(binding - 1), Some(&want), "{} {:?}", spec.entry, global.name);
                }
                _ => {}
            }
        }
        assert!(shared <= 16 << 10, "{} shares {shared} bytes", spec.entry);
    }
}

/// Returns the offsets and names of the members of the WGSL struct `name`, and its size.
fn members(module: &naga::Module, name: &str) -> (Vec<(String, u32)>, u32) {
    let found = module.types.iter().find(|(_, t)| t.name.as_deref() == Some(name));
    let Some((_, naga::Type { inner: naga::TypeInner::Struct { members, span }, .. })) = found else {
        panic!("no struct {name}");
    };
    (members.iter().map(|m| (m.name.clone().unwrap(), m.offset)).collect(), *span)
}

#[test]
fn structs_have_the_same_layout_on_both_sides() {
    macro_rules! offsets {
        ($type:ty: $($field:ident),+) => { vec![$((stringify!($field).to_owned(), std::mem::offset_of!($type, $field) as u32)),+] };
    }
    let module = parsed(&Kernels::SPECS[0]);
    let (scene, size) = members(&module, "Scene");
    let rust = offsets!(Uniforms: background, rates, channel_amplitude, origin_high, origin_low, step, size, widening, decay, min_log_scale,
        max_log_scale, max_log_aspect, correction_first, correction_second, least_gain, variance, longest, primitives, capacity,
        width, height, across, down, row_step, row_phase, band_first, band_rows, tiles_x, tiles_y, tile_base, blend,
        channels, alpha, source_words, source_first, mode, cells_x, cells_y, cell, stride, level, price, weighted,
        detail, frozen);
    assert_eq!(scene, rust);
    assert_eq!(size as usize, size_of::<Uniforms>());
    assert!(size <= Uniforms::STRIDE);
    let (splat, size) = members(&module, "Splat");
    assert_eq!((splat, size as usize), (offsets!(Splat: place, shape, extent, color), size_of::<Splat>()));
    let (primitive, size) = members(&module, "Primitive");
    assert_eq!((primitive.len() * 4, size as usize), (size_of::<Primitive>(), size_of::<Primitive>()));
}

#[test]
fn shader_constants_equal_those_of_the_crate() {
    use super::twin::common as twin;
    let support = 0.5 * f64::from(crate::gaussian::CUTOFF).powi(2) * std::f64::consts::LOG2_E;
    assert_eq!(twin::CUTOFF, crate::gaussian::CUTOFF);
    assert_eq!(twin::CUTOFF_WEIGHT, crate::gaussian::CUTOFF_WEIGHT);
    assert_eq!(twin::EPSILON, crate::gaussian::EPSILON);
    assert_eq!(twin::HIDDEN, crate::gaussian::HIDDEN);
    assert!((f64::from(twin::SUPPORT) - support).abs() < 1e-6);
    assert!((f64::from(twin::HALF) - (0.5 * std::f64::consts::LOG2_E).sqrt()).abs() < 1e-7);
    let common = include_str!("../../../shaders/common.wgsl");
    for text in ["CUTOFF: f32 = 3.5;", "CUTOFF_WEIGHT: f32 = 0.0021874911;", "SUPPORT: f32 = 8.836507;"] {
        assert!(common.contains(text), "{text}");
    }
    for text in ["HALF: f32 = 0.8493218;", "EPSILON: f32 = 0.0078125;", "HIDDEN: f32 = 0.00024414063;"] {
        assert!(common.contains(text), "{text}");
    }
}

#[test]
fn sine_and_cosine_of_the_twin_are_within_two_ten_millionths() {
    for i in -20_000..=20_000 {
        let x = i as f32 * 0.005;
        let [s, c] = super::twin::common::sin_cos(x);
        let (sin, cos) = f64::from(x).sin_cos();
        assert!((f64::from(s) - sin).abs() < 2e-7 && (f64::from(c) - cos).abs() < 2e-7, "{x}");
    }
}

#[test]
fn sixteen_thousand_rows_fit_into_bindings() {
    use super::lists::{MAX_BINDING, check_primitives};
    use super::source::rows_at_a_time;
    use crate::error::{Error, GpuError};
    // The largest picture of the SmartSplat paper: six slabs, 768 sampled rows at a time.
    assert_eq!(rows_at_a_time(10_848, 16_320, 1, MAX_BINDING).unwrap(), [3093, 768]);
    assert_eq!(rows_at_a_time(10_848, 16_320, 2, MAX_BINDING).unwrap(), [1546, 768]);
    // Flat and small pictures.
    assert_eq!(rows_at_a_time(1 << 19, 36, 2, MAX_BINDING).unwrap(), [32, 16]);
    assert_eq!(rows_at_a_time(1, 1, 1, MAX_BINDING).unwrap(), [1, 16]);
    assert!(rows_at_a_time((1 << 19) + 1, 36, 1, MAX_BINDING).is_err());
    // 64 bytes per splat.
    assert!(check_primitives(1_300_000).is_ok() && check_primitives(2 << 20).is_ok());
    let refused = check_primitives((2 << 20) + 1);
    assert!(matches!(refused, Err(Error::Gpu(GpuError::Overflow { what: "primitives", .. }))), "{refused:?}");
}

#[test]
fn workgroups_fold_into_two_dimensions() {
    for groups in [1, 65_535, 65_536, 131_071, 4_000_000, u64::from(u32::MAX)] {
        let [x, y] = fold(groups).map(u64::from);
        assert!(x <= 65_535 && y <= 65_538 && x * y >= groups && x * y < groups + y, "{groups}: {x} × {y}");
    }
}

#[test]
fn running_out_of_memory_is_reported_before_its_consequences() {
    use super::device::cause;
    use crate::error::GpuError;
    // Constructed by hand: software devices return addresses before they allocate memory, and real ones should not be
    // filled.
    let memory = || Some(wgpu::Error::OutOfMemory { source: "heap 0 is full".into() });
    let invalid =
        || Some(wgpu::Error::Validation { source: "text".into(), description: "buffer is invalid".to_owned() });
    let told = cause([invalid(), None, memory()]);
    assert!(matches!(&told, Some(GpuError::OutOfMemory { problem }) if problem == "heap 0 is full"), "{told:?}");
    let told = cause([invalid(), None, None]);
    assert!(matches!(&told, Some(GpuError::Validation { problem }) if problem == "buffer is invalid"), "{told:?}");
    assert!(cause([None, None, None]).is_none());
}

pub(super) mod stages {
    //! Compares each stage with its twin on any adapter. Without an adapter the tests print a message, or fail with
    //! `SSPLAT_REQUIRE_GPU=1`.

    use super::super::device::{Adapters, Device};
    use super::super::fit::{Fitter, packed};
    use super::super::peaks::{Found, Peaks};
    use super::super::renderer::Renderer;
    use super::super::scene::{Primitive, Splat, Uniforms};
    use super::super::source::pack;
    use super::super::twin;
    use super::super::workspace::Workspace;
    use crate::bitstream::{DetailHead, DetailLayer, Maker};
    use crate::fit::engine::{Engine, Snapshot, Watcher};
    use crate::fit::job::Job;
    use crate::fit::model::adam::{Bounds, Rates};
    use crate::fit::model::drawing::field::{Field, Output, float_error};
    use crate::fit::model::drawing::project::{self, Primitive as Free};
    use crate::fit::model::objective::masking;
    use crate::fit::model::objective::planes::Planes;
    use crate::fit::model::objective::rows::RowSet;
    use crate::fit::model::placing::{peaks, removal, ridge, sample};
    use crate::fit::model::problem::{Problem, Scene};
    use crate::fit::plan::Plan;
    use crate::fit::schedule;
    use crate::fit::state::State;
    use crate::gaussian::{Blend, Channels};
    use crate::pixels::{Depth, Pixels, Samples};
    use crate::raster::Overlay;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;
    use std::io::Write;
    use std::sync::{Arc, OnceLock};

    pub(in crate::gpu) fn device() -> Option<Device> {
        static DEVICE: OnceLock<Result<Device, String>> = OnceLock::new();
        match DEVICE.get_or_init(|| Device::open(Adapters::Any).map_err(|e| e.to_string())) {
            Ok(device) => Some(device.clone()),
            Err(e) => {
                assert!(std::env::var("SSPLAT_REQUIRE_GPU").as_deref() != Ok("1"), "{e}");
                // Written directly, because the test harness would capture it.
                let name = std::thread::current().name().unwrap_or_default().to_owned();
                let _ = writeln!(std::io::stderr(), "test {name} ... ignored, {e}");
                None
            }
        }
    }

    /// Opens a device that a test may lose.
    pub(crate) fn own_device() -> Option<Device> {
        device()?;
        Some(Device::open(Adapters::Any).unwrap())
    }

    pub(in crate::gpu) const RATES: Rates =
        Rates { mean: 0.1, log_scale: 0.1, rotation: 0.1, color: 0.01, decay: [0.9, 0.95] };

    /// Waves and an edge, which give detail at all scales.
    fn pixels(width: u32, height: u32, channels: Channels, sixteen: bool) -> Pixels {
        let mut values = Vec::new();
        for y in 0..height {
            for x in 0..width {
                let (u, v) = (x as f32 / width as f32, y as f32 / height as f32);
                for k in 0..channels.count() {
                    let wave = (9.0 * u + 5.0 * v * v + k as f32).sin() * 0.3;
                    let edge = if 3.0 * u + v > 1.7 + 0.2 * (20.0 * v).sin() { 0.35 } else { 0.0 };
                    values.push((0.4 + wave + edge).clamp(0.0, 1.0));
                }
            }
        }
        let samples = if sixteen {
            Samples::U16(values.iter().map(|v| (v * 65535.0) as u16).collect())
        } else {
            Samples::U8(values.iter().map(|v| (v * 255.0) as u8).collect())
        };
        Pixels::new(width, height, channels, samples).unwrap()
    }

    pub(in crate::gpu) fn primitives(width: u32, height: u32, count: usize) -> Vec<Free> {
        let mut r = Pcg64Mcg::seed_from_u64(count as u64);
        let one = |_| Free {
            mean: [r.random_range(0.0..width as f32), r.random_range(0.0..height as f32)],
            log_scale: std::array::from_fn(|_| r.random_range(-0.5..2.2)),
            rotation: r.random_range(-4.0..4.0),
            color: std::array::from_fn(|_| r.random_range(-0.2..1.2)),
        };
        (0..count).map(one).collect()
    }

    struct Case {
        pixels: Pixels,
        target: Planes,
        scene: Scene,
        free: Vec<Free>,
        fitter: Fitter,
    }

    /// Returns the target's planes, with perceptual weights of its errors if requested, which differ everywhere.
    pub(in crate::gpu) fn planes(pixels: &Pixels, weighted: bool) -> Planes {
        let mut target = Planes::new(pixels);
        if weighted {
            target.amplitude = masking::amplitudes(&target, 90);
            target.channel_amplitude = [0.9, 1.2, 0.7, 1.0];
        }
        target
    }

    fn case(device: &Device, channels: Channels, blend: Blend, [sixteen, weighted]: [bool; 2]) -> Case {
        let (width, height) = (75, 61);
        let pixels = pixels(width, height, channels, sixteen);
        let target = planes(&pixels, weighted);
        let scene = Scene { width, height, blend, background: [0.5, 0.4, 0.3, 0.9] };
        let mut free = primitives(width, height, 90);
        for p in &mut free {
            p.color[channels.count()..].fill(0.0);
        }
        let problem = Problem { scene, target: &target };
        let fitter = Fitter::new(device, &problem, pixels.depth(), &free, &Bounds::new(width, height)).unwrap();
        Case { pixels, target, scene, free, fitter }
    }

    /// Asserts the bound of the design document for two implementations of a sum: nearly all values agree within 1e−4
    /// relative to the largest, and the r.m.s. difference is below 1e−5 of it.
    #[track_caller]
    fn assert_near(what: &str, a: &[f32], b: &[f32]) {
        assert_eq!(a.len(), b.len(), "{what}");
        let scale = a.iter().chain(b).fold(1e-20f32, |m, v| m.max(v.abs()));
        let far = a.iter().zip(b).filter(|(a, b)| (*a - *b).abs() > 1e-4 * scale || a.is_nan() || b.is_nan()).count();
        let square: f64 = a.iter().zip(b).map(|(a, b)| (f64::from(a - b) / f64::from(scale)).powi(2)).sum();
        let rms = (square / a.len().max(1) as f64).sqrt();
        assert!(far * 100_000 <= a.len() && rms < 1e-5, "{what}: {far} of {} far, rms {rms:e}", a.len());
    }

    /// Everything that a step leaves on the device.
    struct Left {
        scene: Uniforms,
        splats: Vec<Splat>,
        starts: Vec<u32>,
        unsorted: Vec<u32>,
        sorted: Vec<u32>,
        status: [u32; 4],
        planes: Vec<[f32; 4]>,
        tails: Vec<f32>,
        errors: Vec<f32>,
        slots: Vec<[f32; 4]>,
        moments: Vec<f32>,
        primitives: Vec<f32>,
        first: Vec<f32>,
        second: Vec<f32>,
    }

    fn left(d: &Device, s: &Workspace, state: &[&wgpu::Buffer; 3], scene: Uniforms) -> Left {
        let n = scene.primitives as usize;
        let tiles = scene.tiles() as usize;
        let starts: Vec<u32> = d.read_as(&s.lists.starts, tiles + 1).unwrap();
        let pairs = starts[tiles] as usize;
        let pixels = (scene.width * scene.band_rows) as usize;
        let read = |b: &wgpu::Buffer| d.read_as::<f32>(b, 9 * n).unwrap();
        Left {
            scene,
            splats: d.read_as(&s.lists.splats, n).unwrap(),
            unsorted: d.read_as(&s.lists.unsorted, pairs).unwrap(),
            sorted: d.read_as(&s.lists.sorted, pairs).unwrap(),
            status: s.lists.status(d).unwrap(),
            planes: d.read_as(&s.planes, pixels).unwrap(),
            tails: d.read_as(&s.tails, pixels).unwrap(),
            errors: d.read_as(&s.errors, tiles).unwrap(),
            slots: d.read_as(&s.slots, 3 * pairs).unwrap(),
            moments: read(&s.moments),
            primitives: read(state[0]),
            first: read(state[1]),
            second: read(state[2]),
            starts,
        }
    }

    #[test]
    fn every_stage_of_a_step_agrees_with_its_twin() {
        let Some(device) = device() else { return };
        for (channels, blend, [sixteen, weighted], rows) in [
            (Channels::Rgb, Blend::Normalized, [false, false], RowSet::ALL),
            (Channels::Rgb, Blend::Sum, [true, false], RowSet { step: 3, phase: 2 }),
            (Channels::Rgba, Blend::Normalized, [false, true], RowSet { step: 2, phase: 1 }),
            (Channels::GreyAlpha, Blend::Normalized, [true, true], RowSet::ALL),
            (Channels::Grey, Blend::Sum, [false, true], RowSet { step: 5, phase: 0 }),
        ] {
            let mut c = case(&device, channels, blend, [sixteen, weighted]);
            let free: Vec<Primitive> = c.free.iter().map(packed).collect();
            c.fitter.set_price(1e-3);
            let got = c.fitter.inspect(rows, RATES, left).unwrap();
            let scene = got.scene;
            let tiles = scene.tiles() as usize;

            let splats = twin::project::project(&scene, &free);
            assert_near("splats", bytemuck::cast_slice(&got.splats), bytemuck::cast_slice(&splats));

            // From here on, each twin gets the inputs that the stage on the device had.
            let splats = &got.splats;
            let (mut cursors, mut starts, mut status) = (vec![0; tiles], vec![0; tiles + 1], [0; 4]);
            let mut lists = vec![0; got.sorted.len()];
            twin::bin::bin(&scene, splats, &mut cursors, &mut lists, &mut status);
            twin::scan::scan(&scene, &mut cursors, &mut starts, &mut status);
            twin::bin::bin(&Uniforms { mode: 1, ..scene }, splats, &mut cursors, &mut lists, &mut [0; 4]);
            assert_eq!(starts, got.starts);
            assert_eq!(status[..2], got.status[..2]);
            assert_eq!(got.status[2], 1, "steps taken");

            let mut sorted = vec![0; got.sorted.len()];
            twin::sort::sort(&starts, &got.unsorted, &mut sorted);
            assert_eq!(sorted, got.sorted);
            assert_eq!(lists, sorted, "one thread after the other makes sorted lists");

            let source = pack(&c.target, c.pixels.depth(), 0, c.scene.height);
            let mut planes = vec![[0.0; 4]; got.planes.len()];
            let (mut tails, mut errors) = (vec![0.0; got.tails.len()], vec![0.0; tiles]);
            let mut out = twin::forward::Output { planes: &mut planes, tails: &mut tails, errors: &mut errors };
            twin::forward::forward(&scene, splats, &starts, &sorted, &source, &mut out);
            assert_near("planes", bytemuck::cast_slice(&got.planes), bytemuck::cast_slice(&planes));
            assert_near("tails", &got.tails, &tails);
            assert_near("errors", &got.errors, &errors);

            let mut slots = vec![[0.0; 4]; got.slots.len()];
            twin::backward::backward(&scene, splats, &starts, &sorted, &got.planes, &got.tails, &mut slots);
            assert_near("slots", bytemuck::cast_slice(&got.slots), bytemuck::cast_slice(&slots));

            let mut moments = vec![0.0; got.moments.len()];
            twin::gather::gather(&scene, splats, &starts, &sorted, &got.slots, &mut moments);
            assert_near("moments", &got.moments, &moments);

            let mut after: Vec<f32> = bytemuck::cast_slice(&free).to_vec();
            let (mut first, mut second) = (vec![0.0; after.len()], vec![0.0; after.len()]);
            twin::adam::adam(&scene, &mut after, &got.moments, &mut first, &mut second);
            assert_near("first moments", &got.first, &first);
            assert_near("second moments", &got.second, &second);
            assert_near("primitives", &got.primitives, &after);
        }
    }

    #[test]
    fn steps_match_the_cpu() {
        let Some(device) = device() else { return };
        for (blend, weighted) in [(Blend::Normalized, false), (Blend::Normalized, true), (Blend::Sum, true)] {
            let pixels = pixels(75, 61, Channels::Rgb, false);
            let target = planes(&pixels, weighted);
            let scene = Scene { width: 75, height: 61, blend, background: target.mean };
            let problem = Problem { scene, target: &target };
            let bounds = Bounds::new(75, 61);
            let mut free = primitives(75, 61, 90);
            for p in &mut free {
                p.color[3] = 0.0;
            }
            let mut cpu = State::new(free, bounds);
            let mut gpu = Fitter::new(&device, &problem, pixels.depth(), &cpu.primitives, &bounds).unwrap();
            // As large as the gradients.
            cpu.price = 1.0;
            gpu.set_price(cpu.price);
            // Long steps, so that all bounds are reached.
            let rates = Rates { mean: 0.5, log_scale: 0.5, rotation: 0.2, color: 1.5, decay: [0.9, 0.95] };
            for phase in [1, 0, 1] {
                let rows = RowSet { step: 2, phase };
                cpu.descend(&problem, rows, rates);
                gpu.descend(&problem, rows, rates).unwrap();
            }
            let flat = |p: &Free| bytemuck::cast::<_, [f32; 9]>(packed(p));
            let want: Vec<f32> = cpu.primitives.iter().flat_map(flat).collect();
            let got: Vec<f32> = gpu.primitives().unwrap().iter().flat_map(flat).collect();
            assert!(want.iter().any(|v| v.abs() == 4.0), "no colour at its bound");
            // Adam's first steps depend on the gradients' signs. Where a gradient is about zero, rounding determines
            // its sign.
            let far = got.iter().zip(&want).filter(|(a, b)| (*a - *b).abs() > 1e-3 * (1.0 + b.abs())).count();
            assert!(far * 50 <= got.len(), "{blend:?}, weighted {weighted}: {far} of {} far", got.len());
        }
    }

    #[test]
    fn half_size_matches_the_cpu() {
        let Some(device) = device() else { return };
        let pixels = pixels(75, 61, Channels::Rgb, true);
        let target = planes(&pixels, true);
        let half = target.halved();
        let scene = Scene { width: 75, height: 61, blend: Blend::Normalized, background: target.mean };
        let half_scene = Scene { width: 38, height: 31, ..scene };
        let (problem, half) = (Problem { scene, target: &target }, Problem { scene: half_scene, target: &half });
        let bounds = Bounds::new(75, 61);
        let mut free = primitives(75, 61, 90);
        for p in &mut free {
            p.color[3] = 0.0;
        }
        let mut cpu = State::new(free, bounds);
        let mut gpu = Fitter::new(&device, &problem, pixels.depth(), &cpu.primitives, &bounds).unwrap();
        let near = |a: f64, b: f64| assert!((a / b - 1.0).abs() < 1e-3, "{a} {b}");
        // The order of both is the same as long as nothing is sorted in between.
        gpu.zoom(&half, 0.5).unwrap();
        cpu.zoom(&half, 0.5).unwrap();
        let halved = cpu.primitives.clone();
        for phase in 0..2 {
            let rows = RowSet { step: 2, phase };
            cpu.descend(&half, rows, RATES);
            gpu.descend(&half, rows, RATES).unwrap();
        }
        // Errors always refer to the whole size.
        let at_whole = float_error(&problem, &project::zoomed(cpu.primitives.clone(), 2.0));
        near(gpu.error(&problem).unwrap(), at_whole);
        near(cpu.error(&problem).unwrap(), at_whole);
        assert_ne!(halved, cpu.primitives);
        gpu.zoom(&problem, 2.0).unwrap();
        cpu.zoom(&problem, 2.0).unwrap();
        near(gpu.error(&problem).unwrap(), float_error(&problem, &cpu.primitives));
        cpu.descend(&problem, RowSet::ALL, RATES);
        gpu.descend(&problem, RowSet::ALL, RATES).unwrap();
        near(gpu.error(&problem).unwrap(), float_error(&problem, &cpu.primitives));
    }

    #[test]
    fn reweighted_pixels_equal_weights_from_the_start() {
        let Some(device) = device() else { return };
        let (width, height, bounds) = (75, 61, Bounds::new(75, 61));
        for sixteen in [false, true] {
            let pixels = pixels(width, height, Channels::Rgb, sixteen);
            let before = planes(&pixels, true);
            let backwards = before.amplitude.chunks_exact(before.stride).rev().flatten().copied().collect();
            let after = before.weighed(backwards);
            let scene = Scene { width, height, blend: Blend::Normalized, background: before.mean };
            let [old, new] = [&before, &after].map(|target| Problem { scene, target });
            let free = primitives(width, height, 90);
            let stepped = |first: &Problem<'_>| {
                let mut gpu = Fitter::new(&device, first, pixels.depth(), &free, &bounds).unwrap();
                gpu.reweigh(&new).unwrap();
                // Adam's first step depends on the signs alone; the second depends on the magnitudes.
                gpu.descend(&new, RowSet::ALL, RATES).unwrap();
                gpu.descend(&new, RowSet { step: 2, phase: 1 }, RATES).unwrap();
                gpu.primitives().unwrap()
            };
            let mut only = Fitter::new(&device, &old, pixels.depth(), &free, &bounds).unwrap();
            only.descend(&old, RowSet::ALL, RATES).unwrap();
            only.descend(&old, RowSet { step: 2, phase: 1 }, RATES).unwrap();
            assert_eq!(stepped(&old), stepped(&new), "{sixteen}");
            assert_ne!(stepped(&old), only.primitives().unwrap(), "{sixteen}");
            // Existing buffers must get the new weights, too.
            let under_way = |then: Option<&Problem<'_>>| {
                let mut gpu = Fitter::new(&device, &old, pixels.depth(), &free, &bounds).unwrap();
                gpu.descend(&old, RowSet::ALL, RATES).unwrap();
                if let Some(new) = then {
                    gpu.reweigh(new).unwrap();
                }
                gpu.descend(then.unwrap_or(&old), RowSet::ALL, RATES).unwrap();
                gpu.primitives().unwrap()
            };
            assert_ne!(under_way(Some(&new)), under_way(None), "{sixteen}");
        }
    }

    #[test]
    fn slabs_and_bands_add_up_to_the_whole() {
        let Some(device) = device() else { return };
        let (width, height) = (75, 61);
        let pixels = pixels(width, height, Channels::Rgb, true);
        let target = planes(&pixels, true);
        let scene = Scene { width, height, blend: Blend::Normalized, background: target.mean };
        let problem = Problem { scene, target: &target };
        let bounds = Bounds::new(width, height);
        let mut state = State::new(primitives(width, height, 90), bounds);
        for p in &mut state.primitives {
            p.color[3] = 0.0;
        }
        for rows in [RowSet::ALL, RowSet { step: 2, phase: 1 }] {
            let run = |binding: u64, heights: [u32; 2]| {
                let mut gpu =
                    Fitter::within(&device, &problem, pixels.depth(), &state.primitives, &bounds, binding).unwrap();
                assert_eq!(gpu.sizes()[..2], heights);
                let error = gpu.error(&problem).unwrap();
                // Adam's first step depends on the signs of the sums alone; the second depends on their magnitudes.
                for _ in 0..2 {
                    gpu.descend(&problem, rows, RATES).unwrap();
                }
                let flat = |p: &Free| bytemuck::cast::<_, [f32; 9]>(packed(p));
                (error, gpu.primitives().unwrap().iter().flat_map(flat).collect::<Vec<f32>>())
            };
            let want = float_error(&problem, &state.primitives);
            let (error, high) = run(1 << 20, [61, 64]);
            // A row of the target takes 900 bytes, and one of the planes 1200.
            let (same, low) = run(16 * 1200, [21, 16]);
            assert!((error / want - 1.0).abs() < 1e-4 && (same / want - 1.0).abs() < 1e-4, "{error} {same} {want}");
            let far = low.iter().zip(&high).filter(|(a, b)| (*a - *b).abs() > 1e-3 * (1.0 + b.abs())).count();
            assert!(far * 100 <= low.len(), "{rows:?}: {far} of {} far", low.len());
        }
    }

    /// Returns the uniforms of a survey of `rows`, every second row of 8-bit RGB, in a single band.
    fn survey_uniforms(problem: &Problem<'_>, rows: RowSet, count: usize) -> Uniforms {
        let Problem { scene, target } = problem;
        let weighted = u32::from(!target.amplitude.is_empty());
        let view = crate::raster::View::new(scene.width, scene.height);
        let cells_y = rows.count(scene.height) as u32;
        let base = Uniforms {
            primitives: count as u32,
            row_step: rows.step,
            cell: rows.step,
            source_words: 1 + weighted,
            weighted,
            cells_x: scene.width.div_ceil(rows.step),
            cells_y,
            channel_amplitude: target.channel_amplitude,
            ..Uniforms::new(&view, scene.blend, Channels::Rgb, scene.background, 0)
        };
        base.band(0, cells_y)
    }

    /// Asserts that the stages of a survey agree with their twins: importance and residual. Returns the cells.
    fn assert_survey_agrees(
        base: &Uniforms,
        (d, s, p): (&Device, &Workspace, &Peaks),
        source: &[u32],
    ) -> Vec<[f32; 4]> {
        let tiles = base.tiles() as usize;
        let starts: Vec<u32> = d.read_as(&s.lists.starts, tiles + 1).unwrap();
        let sorted: Vec<u32> = d.read_as(&s.lists.sorted, starts[tiles] as usize).unwrap();
        let splats: Vec<Splat> = d.read_as(&s.lists.splats, base.primitives as usize).unwrap();
        let pixels = (base.width * base.band_rows) as usize;
        let planes: Vec<[f32; 4]> = d.read_as(&s.planes, pixels).unwrap();
        let tails: Vec<f32> = d.read_as(&s.tails, pixels).unwrap();
        let got: Vec<[f32; 4]> = d.read_as(&s.slots, 3 * sorted.len()).unwrap();
        let mut slots = vec![[0.0; 4]; got.len()];
        twin::importance::importance(base, &splats, &starts, &sorted, (&planes, &tails), source, &mut slots);
        assert_near("importance", bytemuck::cast_slice(&got), bytemuck::cast_slice(&slots));
        let mut cells = vec![[0.0; 4]; (base.cells_x * base.cells_y) as usize];
        twin::residual::residual(base, &planes, source, &mut cells);
        let got: Vec<[f32; 4]> = d.read_as(&p.cells[0], cells.len()).unwrap();
        assert_near("residual", bytemuck::cast_slice(&got), bytemuck::cast_slice(&cells));
        got
    }

    /// Asserts that the peaks of the first level in `all` are those that the twins find in `cells`, stage by stage.
    fn assert_first_level_agrees(base: &Uniforms, spacing: f32, cells: Vec<[f32; 4]>, all: &[(peaks::Peak, u32)]) {
        let mut blurred = cells;
        for _ in 0..2 {
            blurred = twin::blur::blur(base, &blurred);
            blurred = twin::blur::blur(&Uniforms { mode: 1, ..*base }, &blurred);
        }
        let mut found: Vec<Found> = Vec::new();
        let longest = ridge::max_aspect(spacing, 8.0f32.sqrt());
        let level = Uniforms { variance: 8.0, longest, ..*base };
        twin::peaks::find_peaks(&level, &blurred, &ridge::all(), &mut found);
        let mut first: Vec<f32> = all.iter().filter(|(_, l)| *l == 0).map(|(p, _)| p.gain).collect();
        let mut twins: Vec<f32> = found.iter().map(|f| 4.0 * std::f32::consts::PI * 8.0 * f.shape().score).collect();
        first.sort_by(f32::total_cmp);
        twins.sort_by(f32::total_cmp);
        assert_near("peaks", &first, &twins);
        // Level 1 starts in the second buffer; later levels alternate.
        let halved = twin::halve::halve(base, &blurred);
        assert_eq!(halved.len() as u32, base.cells_x.div_ceil(2) * base.cells_y.div_ceil(2));
    }

    #[test]
    fn surveys_agree_with_their_twins_and_with_the_cpu() {
        let Some(device) = device() else { return };
        for (blend, weighted) in [Blend::Normalized, Blend::Sum].into_iter().flat_map(|b| [(b, false), (b, true)]) {
            let mut c = case(&device, Channels::Rgb, blend, [false, weighted]);
            let rows = RowSet { step: 2, phase: 0 };
            let target = planes(&c.pixels, weighted);
            let count = c.free.len();
            // The error over the same rows, the costs and the peaks, as the CPU's relocation computes them.
            let problem = Problem { scene: c.scene, target: &target };
            let projected = project::all(&c.free, c.scene.height);
            let mut field = Field::default();
            let error = field.draw(&problem, &projected, rows, Output::Picture);
            let costs = removal::costs(&problem, &field, rows, &projected);
            let want = peaks::peaks(&problem, &field, rows, 12, count);
            let found = c
                .fitter
                .inspect_survey(rows, |d, s, survey, p| {
                    assert!((survey.error / error - 1.0).abs() < 1e-4, "{} {error}", survey.error);
                    assert_near("costs", &survey.costs, &costs);
                    let base = survey_uniforms(&problem, rows, count);
                    let cells = assert_survey_agrees(&base, (d, s, p), &pack(&target, Depth::Eight, 0, base.height));
                    // Overwrites the cells.
                    let spacing = peaks::spacing(&problem.scene, 12, count);
                    let all = p.find(d, &base, rows, spacing, 0.0).unwrap();
                    assert_first_level_agrees(&base, spacing, cells, &all);
                    peaks::best(all, 12, &problem.scene)
                })
                .unwrap();
            assert_eq!(found.len(), want.len());
            // The CPU skips peaks whose gain is far below the others. The last of those that the GPU finds may be
            // among them.
            for (a, b) in found.iter().zip(&want).take(10) {
                assert_eq!((a.mean, a.rotation), (b.mean, b.rotation));
                assert!(
                    (a.gain / b.gain - 1.0).abs() < 1e-3 && (a.scale[1] / b.scale[1] - 1.0).abs() < 1e-6,
                    "{a:?} {b:?}"
                );
                assert_near("residual of a peak", &a.residual, &b.residual);
            }
        }
    }

    #[test]
    fn halving_and_moving_agree_with_their_twins() {
        let cells: Vec<[f32; 4]> = (0..35).map(|i| [i as f32, 1.0, -(i as f32), 0.5]).collect();
        let view = crate::raster::View::new(7, 5);
        let u = Uniforms {
            cells_x: 7,
            cells_y: 5,
            primitives: 3,
            capacity: 1,
            ..Uniforms::new(&view, Blend::Sum, Channels::Rgba, [0.0; 4], 3)
        };
        let halved = twin::halve::halve(&u, &cells);
        assert_eq!((halved[0], halved[11]), ([4.0, 1.0, -4.0, 0.5], [34.0, 1.0, -34.0, 0.5]));
        let moves: Vec<u32> = std::iter::once(1).chain((0..9).map(|k| (k as f32 + 0.5).to_bits())).collect();
        let before = [vec![1.0f32; 27], vec![2.0; 27], vec![3.0; 27]];
        let mut want = before.clone();
        let [p, first, second] = &mut want;
        twin::relocate::relocate(&u, &moves, p, first, second);
        let Some(device) = device() else { return };
        let (d, queue) = device.wgpu();
        let k = device.kernels();
        let (cell_buffer, out, got) = device
            .scoped(|| {
                let usage = wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST;
                let uniforms = device.buffer("uniforms", 256, usage);
                device.write(&uniforms, &[u]);
                let [cell_buffer, out, list] = [35 * 16, 12 * 16, 40].map(|size| device.storage("test", size));
                device.write(&cell_buffer, &cells);
                device.write(&list, &moves);
                let got = before.clone().map(|v| {
                    let buffer = device.storage("test", 27 * 4);
                    device.write(&buffer, &v);
                    buffer
                });
                let halve = k.halve.bind(d, &uniforms, &[&cell_buffer, &out]);
                let relocate = k.relocate.bind(d, &uniforms, &[&list, &got[0], &got[1], &got[2]]);
                let mut encoder = d.create_command_encoder(&Default::default());
                let mut pass = encoder.begin_compute_pass(&Default::default());
                k.halve.each(&mut pass, &halve, 0, 12);
                k.relocate.each(&mut pass, &relocate, 0, 1);
                drop(pass);
                queue.submit([encoder.finish()]);
                (cell_buffer, out, got)
            })
            .unwrap();
        drop(cell_buffer);
        assert_eq!(device.read_as::<[f32; 4]>(&out, 12).unwrap(), halved);
        for (got, want) in got.iter().zip(&want) {
            assert_eq!(&device.read_as::<f32>(got, 27).unwrap(), want);
        }
    }

    /// A few levels in every block; the field is the number of levels so far.
    struct Ripples(u8);

    impl Maker for Ripples {
        fn class(&mut self, _: usize, _: [usize; 2]) -> u8 {
            0
        }

        fn is_divided(&mut self, _: usize, _: usize, _: [usize; 2], _: usize) -> bool {
            true
        }

        fn levels(&mut self, _: usize, _: usize, _: [usize; 2], _: usize) -> Vec<(u8, u8, i16)> {
            self.0 = (self.0 + 1) % 4;
            vec![(0, 0, 9 - 5 * i16::from(self.0)), (self.0, 1, 7)]
        }
    }

    #[test]
    fn renders_agree_with_their_twin() {
        let Some(device) = device() else { return };
        let (width, height) = (50, 37);
        let free = primitives(width, height, 60);
        let gaussians: Vec<_> = free.iter().map(|p| p.to_gaussian()).collect();
        let picture = crate::Gaussians {
            width,
            height,
            channels: Channels::Rgba,
            depth: crate::Depth::Eight,
            blend: Blend::Normalized,
            background: [0.3; 4],
            list: gaussians,
        };
        let new = || Renderer::new(&device, &picture, &crate::Limits::default()).unwrap();
        let head = DetailHead { step: 900, alpha: true, ..DetailHead::PLAIN };
        let layer = DetailLayer::made(head, picture.channels, [width, height], &mut Ripples(0)).unwrap();
        let overlay = Arc::new(Overlay::new(Arc::new(layer), picture.channels, [width, height]));
        let p: Vec<Primitive> = picture
            .list
            .iter()
            .map(|g| Primitive { mean: g.mean, log_scale: g.scale.map(f32::ln), rotation: g.rotation, color: g.color })
            .collect();
        // The whole picture; 8 × 4 samples per pixel; samples 1.5 and 2.3 pixels apart. Each with and without a layer.
        let sizes = [(width, height), (6, 11), (4, 2)];
        for ((width, height), detail) in sizes.into_iter().flat_map(|size| [(size, 0), (size, 1)]) {
            let view = crate::raster::View::new(picture.width, picture.height).resized(width, height).unwrap();
            let u = Uniforms {
                stride: width,
                capacity: 1 << 16,
                detail,
                ..Uniforms::new(&view, picture.blend, picture.channels, picture.background, 60)
            };
            let u = u.band(0, u.height);
            let splats = twin::project::project(&u, &p);
            let tiles = u.tiles() as usize;
            let (mut cursors, mut starts, mut lists) = (vec![0; tiles], vec![0; tiles + 1], vec![0; 1 << 16]);
            twin::bin::bin(&u, &splats, &mut cursors, &mut lists, &mut [0; 4]);
            twin::scan::scan(&u, &mut cursors, &mut starts, &mut [0; 4]);
            twin::bin::bin(&Uniforms { mode: 1, ..u }, &splats, &mut cursors, &mut lists, &mut [0; 4]);
            let mut codes = vec![0u32; (width * height) as usize];
            let added = overlay.additions(&view, 0, width as usize, 0..height);
            twin::render::render(&u, &splats, &starts, &lists, &mut codes, added.first_rows(height));
            let mut renderer = if detail == 1 { new().adding(Arc::clone(&overlay)) } else { new() };
            let drawn = renderer.render(&view, crate::Depth::Eight).unwrap().into_samples();
            let Samples::U8(drawn) = drawn else { panic!("8 bits") };
            let got = renderer.splats().unwrap();
            assert_near("splats", bytemuck::cast_slice(&got), bytemuck::cast_slice(&splats));
            let codes: Vec<u8> = codes.iter().flat_map(|c| c.to_le_bytes()).collect();
            // A value at the boundary between two codes may be rounded to either.
            assert!(drawn.iter().zip(&codes).all(|(a, b)| a.abs_diff(*b) <= 1));
            assert!(drawn.iter().zip(&codes).filter(|(a, b)| a != b).count() * 1000 <= drawn.len());
        }
    }

    /// Half the squared error in f64, not clamped where the picture is within 0..=1.
    fn loss(c: &Case, free: &[Free]) -> f64 {
        let gaussians: Vec<_> = free.iter().map(|p| p.to_gaussian()).collect();
        let picture = crate::Gaussians {
            width: c.scene.width,
            height: c.scene.height,
            channels: c.pixels.channels(),
            depth: crate::Depth::Eight,
            blend: c.scene.blend,
            background: c.scene.background,
            list: gaussians,
        };
        let view = crate::raster::View::new(picture.width, picture.height);
        let drawn = crate::raster::reference::sample(&picture, &view);
        drawn.iter().enumerate().map(|(i, v)| 0.5 * (v - f64::from(c.pixels.value(i))).powi(2)).sum()
    }

    #[test]
    fn gradients_match_finite_differences() {
        let Some(device) = device() else { return };
        for blend in [Blend::Normalized, Blend::Sum] {
            let (width, height) = (40, 33);
            let pixels = pixels(width, height, Channels::Rgb, false);
            let scene = Scene { width, height, blend, background: [0.5; 4] };
            let mut free = primitives(width, height, 12);
            for p in &mut free {
                // Within 0..=1 everywhere, where the straight-through clamp has no effect.
                p.color =
                    if blend == Blend::Sum { p.color.map(|c| 0.1 * c - 0.06) } else { p.color.map(|c| 0.4 + 0.2 * c) };
                p.color[3] = 0.0;
                // Large supports: at the edge of a support, the loss has kinks, which finite differences include and
                // gradients do not.
                p.log_scale = p.log_scale.map(|l| l + 1.2);
            }
            let target = Planes::new(&pixels);
            let problem = Problem { scene, target: &target };
            let fitter = Fitter::new(&device, &problem, pixels.depth(), &free, &Bounds::new(width, height)).unwrap();
            let mut c = Case { pixels, target, scene, free, fitter };
            let got = c.fitter.inspect(RowSet::ALL, RATES, left).unwrap();
            let mut worst = 0.0f64;
            for i in 0..c.free.len() {
                let p: [f32; 9] = bytemuck::cast(packed(&c.free[i]));
                let gradient = twin::adam::gradient(&got.scene, &p, &got.moments, i);
                let f = c.free[i];
                let (sin, cos) = f.rotation.sin_cos();
                let [s1, s2] = f.log_scale.map(f32::exp);
                let moved: [Box<dyn Fn(f32) -> Free>; 8] = [
                    Box::new(|h| Free { mean: [f.mean[0] + h * s1 * cos, f.mean[1] + h * s1 * sin], ..f }),
                    Box::new(|h| Free { mean: [f.mean[0] - h * s2 * sin, f.mean[1] + h * s2 * cos], ..f }),
                    Box::new(|h| Free { log_scale: [f.log_scale[0] + h, f.log_scale[1]], ..f }),
                    Box::new(|h| Free { log_scale: [f.log_scale[0], f.log_scale[1] + h], ..f }),
                    Box::new(|h| Free { rotation: f.rotation + h, ..f }),
                    Box::new(|h| Free { color: [f.color[0] + h, f.color[1], f.color[2], 0.0], ..f }),
                    Box::new(|h| Free { color: [f.color[0], f.color[1] + h, f.color[2], 0.0], ..f }),
                    Box::new(|h| Free { color: [f.color[0], f.color[1], f.color[2] + h, 0.0], ..f }),
                ];
                for (k, moved) in moved.iter().enumerate() {
                    const H: f32 = 1.0 / 256.0;
                    let at = |h: f32| {
                        let mut free = c.free.clone();
                        free[i] = moved(h);
                        loss(&c, &free)
                    };
                    let numeric = (at(H) - at(-H)) / (2.0 * f64::from(H));
                    let scale = 0.05 + numeric.abs();
                    let off = (f64::from(gradient[k]) - numeric).abs() / scale;
                    worst = worst.max(off);
                    assert!(off < 0.02, "{blend:?} primitive {i} parameter {k}: {} against {numeric}", gradient[k]);
                }
            }
            eprintln!("{blend:?}: worst relative difference {worst:.5}");
        }
    }

    /// Removes and adds primitives once, and records their final number.
    struct TakesAndAdds {
        count: usize,
        is_first: bool,
    }

    impl Watcher for TakesAndAdds {
        fn step(&mut self, _: f32, _: &mut dyn Snapshot) -> crate::Result<()> {
            Ok(())
        }

        fn recount(&mut self, _: &[Free]) -> crate::Result<usize> {
            Ok(if std::mem::take(&mut self.is_first) { self.count - 20 } else { self.count })
        }
    }

    fn fitted(engine: &mut impl Engine, problem: Problem<'_>, plan: &Plan) {
        let count = engine.count();
        let rng = Pcg64Mcg::seed_from_u64(plan.seed);
        let mut watcher = TakesAndAdds { count, is_first: true };
        schedule::run(&Job { problem, count, plan }, engine, (rng, 0..plan.iterations), &mut watcher).unwrap();
    }

    /// Returns `count` primitives whose density follows the detail.
    pub(in crate::gpu) fn scattered(target: &Planes, count: usize, seed: u64) -> State {
        let primitives = sample::by_detail(target, count, &mut Pcg64Mcg::seed_from_u64(seed));
        State::new(primitives, Bounds::new(target.width, target.height))
    }

    pub(in crate::gpu) fn decibels(error: f64, pixels: &Pixels) -> f64 {
        let samples = pixels.width() as usize * pixels.height() as usize * pixels.channels().count();
        -10.0 * (error / samples as f64).log10()
    }

    /// A photograph, because the first steps of fits to smooth drawings are chaotic and do not tell anything.
    fn photograph() -> Pixels {
        crop("kodim05", [300, 200], [192, 128])
    }

    /// Returns a part of a photograph.
    pub(in crate::gpu) fn crop(name: &str, [x, y]: [u32; 2], [width, height]: [u32; 2]) -> Pixels {
        let path = format!("{}/tests/images/{name}.png", env!("CARGO_MANIFEST_DIR"));
        let part = image::imageops::crop_imm(&image::open(path).unwrap().to_rgb8(), x, y, width, height).to_image();
        Pixels::new(width, height, Channels::Rgb, Samples::U8(part.into_raw())).unwrap()
    }

    /// Fits `count` primitives in `steps` steps. Returns the PSNR on the CPU, and the difference of the GPU's to it,
    /// dB.
    fn compared(device: &Device, (blend, weighted): (Blend, bool), count: usize, steps: u32, seed: u64) -> (f64, f64) {
        let pixels = photograph();
        let target = planes(&pixels, weighted);
        let scene = Scene { width: 192, height: 128, blend, background: target.mean };
        let problem = Problem { scene, target: &target };
        let plan = Plan::steps(steps, seed);
        let mut cpu = scattered(&target, count, seed);
        let start = cpu.primitives.clone();
        let gpu = || {
            let mut fitter = Fitter::new(device, &problem, pixels.depth(), &start, &Bounds::new(192, 128)).unwrap();
            fitted(&mut fitter, problem, &plan);
            let error = fitter.error(&problem).unwrap();
            (fitter.primitives().unwrap(), error)
        };
        let (primitives, error) = gpu();
        assert_eq!(primitives.len(), count);
        fitted(&mut cpu, problem, &plan);
        let of = |p: &[Free]| decibels(float_error(&problem, p), &pixels);
        let (want, got) = (of(&cpu.primitives), of(&primitives));
        eprintln!("{blend:?}, weighted {weighted}, {steps} steps, seed {seed}: CPU {want:.3} dB, GPU {got:.3} dB");
        assert!((decibels(error, &pixels) - got).abs() < 0.01, "{error}");
        if seed == 1 {
            assert_eq!(gpu().0, primitives, "a second run");
        }
        (want, got - want)
    }

    /// Returns the mean of `values` and its standard error.
    pub(in crate::gpu) fn mean(values: &[f64]) -> (f64, f64) {
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        (mean, (values.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / (n * (n - 1.0))).sqrt())
    }

    #[test]
    fn short_fits_are_as_good_as_on_the_cpu_and_reproducible() {
        let Some(device) = device() else { return };
        for (blend, weighted, count, seeds) in [
            (Blend::Normalized, false, 1000, 1..5),
            (Blend::Normalized, true, 1000, 1..3),
            (Blend::Sum, false, 2000, 1..3),
        ] {
            let one = |seed| compared(&device, (blend, weighted), count, 40, seed).1;
            let differences: Vec<f64> = seeds.map(one).collect();
            // A tenth of a decibel, plus twice the standard error of the mean over the few seeds.
            let (mean, scatter) = mean(&differences);
            assert!(mean.abs() < 0.1 + 2.0 * scatter && scatter < 0.2, "{blend:?}: {differences:?}");
        }
    }

    /// Compares fits as above, with enough seeds to determine the mean. For comparison, it also runs the CPU alone
    /// with the means of the same start moved by 10⁻⁴ pixels.
    #[test]
    #[ignore = "minutes on software Vulkan"]
    fn many_fits_differ_from_the_cpu_only_by_rounding() {
        let Some(device) = device() else { return };
        let pixels = photograph();
        let target = Planes::new(&pixels);
        for (blend, count, steps, seeds) in
            [(Blend::Normalized, 1000, 40, 24), (Blend::Sum, 2000, 40, 8), (Blend::Normalized, 1000, 200, 8)]
        {
            let scene = Scene { width: 192, height: 128, blend, background: target.mean };
            let (mut devices, mut nudges) = (Vec::new(), Vec::new());
            for seed in 1..=seeds {
                let (want, difference) = compared(&device, (blend, false), count, steps, seed);
                devices.push(difference);
                let plan = Plan::steps(steps, seed);
                let problem = Problem { scene, target: &target };
                let mut nudged = scattered(&target, count, seed);
                for (i, p) in nudged.primitives.iter_mut().enumerate() {
                    p.mean[i % 2] += 1e-4;
                }
                fitted(&mut nudged, problem, &plan);
                let error = float_error(&problem, &nudged.primitives);
                nudges.push(decibels(error, &pixels) - want);
            }
            let ((by_device, a), (by_nudge, b)) = (mean(&devices), mean(&nudges));
            eprintln!(
                "{blend:?}, {steps} steps, {seeds} seeds: GPU − CPU {by_device:+.3} ± {a:.3} dB; CPU nudged − CPU \
                 {by_nudge:+.3} ± {b:.3} dB"
            );
            assert!(by_device.abs() < 0.1, "{blend:?}, {steps} steps: {devices:?}");
        }
    }

    #[test]
    fn the_best_state_is_kept_if_the_end_is_clearly_worse() {
        let Some(device) = device() else { return };
        let mut c = case(&device, Channels::Rgb, Blend::Normalized, [false, false]);
        let target = Planes::new(&c.pixels);
        let problem = Problem { scene: c.scene, target: &target };
        let fitter = &mut c.fitter;
        fitter.descend(&problem, RowSet::ALL, RATES).unwrap();
        fitter.remember(&problem).unwrap();
        let best = fitter.primitives().unwrap();
        let wild = Rates { mean: 8.0, color: 1.0, ..RATES };
        (0..3).for_each(|_| _ = fitter.descend(&problem, RowSet::ALL, wild).unwrap());
        assert_ne!(fitter.primitives().unwrap(), best);
        fitter.keep_best().unwrap();
        assert_eq!(fitter.primitives().unwrap(), best);
        // A state that is not clearly worse is kept, and so is one without a predecessor.
        for remembers in [true, false] {
            if remembers {
                fitter.remember(&problem).unwrap();
            }
            fitter.descend(&problem, RowSet::ALL, RATES.scaled(1e-3)).unwrap();
            let last = fitter.primitives().unwrap();
            fitter.keep_best().unwrap();
            assert_eq!(fitter.primitives().unwrap(), last);
        }
    }

    #[test]
    fn overflowing_lists_grow_and_change_nothing() {
        let Some(device) = device() else { return };
        let run = |capacity: Option<u32>| {
            let mut c = case(&device, Channels::Rgb, Blend::Normalized, [false, false]);
            if let Some(capacity) = capacity {
                c.fitter.limit_lists(capacity);
            }
            let target = Planes::new(&c.pixels);
            let problem = Problem { scene: c.scene, target: &target };
            for i in 0..12 {
                c.fitter.descend(&problem, RowSet { step: 2, phase: i % 2 }, RATES).unwrap();
            }
            c.fitter.relocate(&problem, RowSet::ALL, 5).unwrap();
            (c.fitter.sizes(), c.fitter.primitives().unwrap())
        };
        let (bands, want) = run(None);
        let (grown, got) = run(Some(100));
        assert!(grown[2] > 100 && bands[2] >= 1 << 14, "{grown:?}");
        assert_eq!(got, want);
    }
}
