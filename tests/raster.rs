//! The rasterizer against its definition in f64, and against itself cut differently.

use ssplat::raster::{Renderer, SamplesMut, View, reference};
use ssplat::{Blend, Channels, Depth, Error, Gaussian, Limits, Picture, Samples};

/// xorshift64*: enough for scenes, and the same everywhere.
struct Random(u64);

impl Random {
    fn unit(&mut self) -> f32 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 40) as f32 / (1u64 << 24) as f32
    }

    fn within(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * self.unit()
    }
}

fn picture(width: u32, height: u32, channels: Channels, blend: Blend, gaussians: Vec<Gaussian>) -> Picture {
    Picture { width, height, channels, blend, background: [0.4, 0.7, 0.2, 0.9], gaussians }
}

/// A scene with the statistics of a fitted picture: log-normal scales, aspects around 2.5, colours beyond 0..=1.
fn scene(width: u32, height: u32, count: usize, channels: Channels, blend: Blend, seed: u64) -> Picture {
    let mut r = Random(seed * 7919 + 12345);
    let spacing = (width as f32 * height as f32 / count as f32).sqrt();
    let gaussians = (0..count)
        .map(|_| {
            let size = spacing * 0.4 * r.within(-1.0, 1.0).exp();
            let aspect = r.within(0.0, 1.8).exp();
            Gaussian {
                mean: [r.within(0.0, width as f32), r.within(0.0, height as f32)],
                scale: [(size * aspect.sqrt()).max(0.25), (size / aspect.sqrt()).max(0.25)],
                rotation: r.within(0.0, std::f32::consts::PI),
                color: std::array::from_fn(|_| r.within(-0.3, 1.3)),
            }
        })
        .collect();
    picture(width, height, channels, blend, gaussians)
}

fn codes(samples: Samples) -> Vec<u16> {
    match samples {
        Samples::U8(v) => v.into_iter().map(u16::from).collect(),
        Samples::U16(v) => v,
    }
}

fn render(picture: &Picture, view: &View, depth: Depth) -> Vec<u16> {
    codes(Renderer::new(picture, view, &Limits::default()).unwrap().render(depth).unwrap().into_samples())
}

/// Largest difference to the reference at `depth`, code values.
fn worst(picture: &Picture, view: &View, depth: Depth) -> u16 {
    let drawn = render(picture, view, depth);
    let want = reference::sample(picture, view);
    assert_eq!(drawn.len(), want.len());
    drawn.iter().zip(want).map(|(&a, v)| a.abs_diff(reference::code(v, depth))).max().unwrap()
}

fn one(mean: [f32; 2], scale: [f32; 2], rotation: f32) -> Gaussian {
    Gaussian { mean, scale, rotation, color: [3.5, -2.0, 1.0, 0.3] }
}

#[test]
fn fitted_scenes_are_within_one_code_value_for_all_channels_and_blends() {
    for channels in [Channels::Grey, Channels::GreyAlpha, Channels::Rgb, Channels::Rgba] {
        for blend in [Blend::Normalized, Blend::Sum] {
            let p = scene(150, 131, 300, channels, blend, 1);
            assert!(worst(&p, &View::full(&p), Depth::Eight) <= 1, "{channels:?} {blend:?}");
            // 16 bits resolve f32 and the recurrence's drift: 1.2e-4 of a weight is 8 code values.
            assert!(worst(&p, &View::full(&p), Depth::Sixteen) <= 8, "{channels:?} {blend:?}");
        }
    }
}

#[test]
// Near a quarter turn on purpose.
#[allow(clippy::approx_constant)]
fn single_gaussians_of_every_shape_are_within_one_code_value() {
    let scales = [0.25f32, 0.3, 0.5, 0.8, 1.0, 1.7, 3.0, 9.0, 40.0, 300.0, 1e4, 1_048_576.0];
    let angles = [
        0.0f32,
        1e-4,
        0.1,
        std::f32::consts::FRAC_PI_4,
        1.2,
        std::f32::consts::FRAC_PI_2 - 1e-4,
        std::f32::consts::FRAC_PI_2,
        1.58,
        2.4,
        std::f32::consts::PI,
    ];
    for blend in [Blend::Normalized, Blend::Sum] {
        for (i, &major) in scales.iter().enumerate() {
            for &minor in &scales[..=i] {
                for &angle in &angles {
                    let p = picture(143, 70, Channels::Rgb, blend, vec![one([66.37, 31.81], [major, minor], angle)]);
                    let found = worst(&p, &View::full(&p), Depth::Eight);
                    assert!(found <= 1, "{found} for {blend:?} {major} {minor} {angle}");
                }
            }
        }
    }
}

#[test]
fn shapes_that_end_far_from_their_mean_are_within_one_code_value() {
    // The mean of a needle lies up to 2²⁰ pixels from the pixels that are drawn.
    let side = 1 << 20;
    let mut r = Random(7);
    for &(major, minor) in &[(2e5f32, 0.25), (2e5, 20.0), (1_048_576.0, 0.25), (1_048_576.0, 100.0), (3e5, 3e5)] {
        for _ in 0..20 {
            let mean = [r.within(3e5, 7e5), r.within(3e5, 7e5)];
            let angle = r.within(0.0, std::f32::consts::PI);
            let along = r.within(-3.4, 3.4) * major;
            let (sin, cos) = f64::from(angle).sin_cos();
            let at = [f64::from(mean[0]) + f64::from(along) * cos, f64::from(mean[1]) + f64::from(along) * sin];
            if at.iter().any(|&v| !(40.0..f64::from(side) - 40.0).contains(&v)) {
                continue;
            }
            let p = picture(side, side, Channels::Rgb, Blend::Normalized, vec![one(mean, [major, minor], angle)]);
            let view = View::full(&p).crop(at[0] as u32 - 20, at[1] as u32 - 20, 40, 40).unwrap();
            let found = worst(&p, &view, Depth::Eight);
            assert!(found <= 1, "{found} for {major} {minor} {angle} at {mean:?}");
        }
    }
}

#[test]
fn sparse_pictures_where_epsilon_conditions_the_division_are_within_one_code_value() {
    // One Gaussian in 40 × 40 pixels of scales that leave most pixels with Σw below .02.
    for seed in 0..20 {
        let mut p = scene(160, 120, 12, Channels::Rgb, Blend::Normalized, seed);
        for g in &mut p.gaussians {
            g.color = [-4.0, 4.0, 2.0, 0.0];
        }
        assert!(worst(&p, &View::full(&p), Depth::Eight) <= 1, "seed {seed}");
    }
}

#[test]
fn enlarged_views_sample_the_continuous_picture() {
    let p = scene(60, 50, 80, Channels::Rgb, Blend::Normalized, 3);
    for (w, h) in [(60, 50), (61, 50), (175, 333), (600, 500)] {
        let view = View::full(&p).resized(w, h).unwrap();
        assert!(worst(&p, &view, Depth::Eight) <= 1, "{w}×{h}");
    }
    let part = View::full(&p).crop(20, 10, 9, 7).unwrap().resized(90, 140).unwrap();
    assert!(worst(&p, &part, Depth::Eight) <= 1);
}

#[test]
fn every_way_of_cutting_gives_the_same_bits() {
    let mut p = scene(401, 277, 900, Channels::Rgb, Blend::Normalized, 5);
    p.gaussians.push(one([200.0, 100.0], [900.0, 0.4], 0.61));
    p.gaussians.push(one([-50.0, 300.0], [300.0, 200.0], 2.0));
    let full = View::full(&p);
    for view in [full, full.resized(1000, 300).unwrap(), full.resized(150, 90).unwrap()] {
        let whole = render(&p, &view, Depth::Sixteen);
        let mut r = Random(11);
        for _ in 0..40 {
            let (x, y) = (r.within(0.0, view.width() as f32) as u32, r.within(0.0, view.height() as f32) as u32);
            let w = 1 + r.within(0.0, (view.width() - x - 1) as f32) as u32;
            let h = 1 + r.within(0.0, (view.height() - y - 1) as f32) as u32;
            let part = render(&p, &view.crop(x, y, w, h).unwrap(), Depth::Sixteen);
            for j in 0..h as usize {
                let row = 3 * ((y as usize + j) * view.width() as usize + x as usize);
                let got = &part[3 * j * w as usize..3 * (j + 1) * w as usize];
                assert_eq!(got, &whole[row..row + 3 * w as usize], "row {j} of {x},{y} {w}×{h}");
            }
        }
    }
}

#[test]
fn bands_put_together_are_the_whole() {
    let p = scene(300, 333, 500, Channels::Rgba, Blend::Sum, 6);
    for view in [View::full(&p), View::full(&p).crop(17, 41, 200, 250).unwrap()] {
        let renderer = Renderer::new(&p, &view, &Limits::default()).unwrap();
        let whole = renderer.render(Depth::Eight).unwrap().into_samples();
        let mut rows = Vec::new();
        for band in 0..renderer.bands() {
            let range = renderer.band_rows(band);
            assert_eq!(range.start as usize * renderer.row_len(), rows.len());
            let mut part = vec![0u8; range.len() * renderer.row_len()];
            renderer.render_bands(band..band + 1, SamplesMut::U8(&mut part));
            rows.extend(part);
        }
        assert_eq!(whole, Samples::U8(rows));
    }
}

#[cfg(feature = "rayon")]
#[test]
fn thread_counts_do_not_change_bits() {
    let p = scene(500, 400, 1500, Channels::Rgb, Blend::Normalized, 8);
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| render(&p, &View::full(&p), Depth::Sixteen))
    };
    let one = with(1);
    for threads in [2, 3, 7] {
        assert_eq!(one, with(threads), "{threads} threads");
    }
}

#[test]
fn pictures_of_none_one_and_two_primitives_draw() {
    for blend in [Blend::Normalized, Blend::Sum] {
        for count in 0..3 {
            let all = [one([10.0, 9.0], [4.0, 2.0], 0.3), one([1.0, 20.0], [0.25, 0.25], 0.0)];
            let p = picture(33, 21, Channels::Rgb, blend, all[..count].to_vec());
            assert!(worst(&p, &View::full(&p), Depth::Eight) <= 1);
        }
    }
}

#[test]
fn primitives_outside_the_view_do_not_change_it() {
    let mut p = scene(200, 100, 200, Channels::Rgb, Blend::Normalized, 9);
    let view = View::full(&p).crop(64, 32, 70, 40).unwrap();
    let before = render(&p, &view, Depth::Sixteen);
    p.gaussians.push(one([1000.0, 1000.0], [100.0, 50.0], 0.3));
    p.gaussians.insert(0, one([-1e6, 40.0], [1000.0, 1.0], 0.0));
    assert_eq!(before, render(&p, &view, Depth::Sixteen));
}

#[test]
fn giants_and_needles_over_many_tiles_are_within_one_code_value() {
    let mut r = Random(21);
    for round in 0..6 {
        let gaussians = (0..30)
            .map(|_| {
                let major = r.within(30.0, 700.0);
                let minor = if round % 2 == 0 { major / 100.0 } else { major * r.within(0.2, 1.0) };
                Gaussian {
                    mean: [r.within(0.0, 420.0), r.within(0.0, 200.0)],
                    scale: [major, minor.max(0.25)],
                    rotation: r.within(0.0, std::f32::consts::PI),
                    color: std::array::from_fn(|_| r.within(-2.0, 3.0)),
                }
            })
            .collect();
        let p = picture(420, 200, Channels::Rgb, Blend::Normalized, gaussians);
        assert!(worst(&p, &View::full(&p), Depth::Eight) <= 1, "round {round}");
    }
}

/// Fuzzing found the sum that overflows: a support wider than any integer.
#[test]
fn the_largest_finite_scale_covers_the_picture() {
    let scene = picture(300, 200, Channels::Rgb, Blend::Sum, vec![one([150.0, 100.0], [f32::MAX; 2], 0.3)]);
    assert!(worst(&scene, &View::full(&scene), Depth::Eight) <= 1);
}

#[test]
fn tile_pairs_are_limited_before_the_work() {
    let giants = vec![one([500.0, 500.0], [1e4, 1e4], 0.0); 1000];
    let p = picture(1000, 1000, Channels::Rgb, Blend::Normalized, giants);
    let mut limits = Limits::default();
    limits.tile_pairs = 60_000;
    // 8 × 8 tiles for each of 1000.
    let error = Renderer::new(&p, &View::full(&p), &limits).unwrap_err();
    assert!(matches!(error, Error::LimitExceeded { what: "tile_pairs", requested: 60_001.., allowed: 60_000 }));
    limits.tile_pairs = 64_000;
    assert!(Renderer::new(&p, &View::full(&p), &limits).is_ok());
}

#[test]
fn work_is_limited_in_proportion_to_pixels_and_primitives() {
    // 16384 primitives on each of 64 tiles.
    let giants = vec![one([500.0, 500.0], [1e4, 1e4], 0.0); 16384];
    let p = picture(1000, 1000, Channels::Rgb, Blend::Normalized, giants);
    let error = Renderer::new(&p, &View::full(&p), &Limits::default()).unwrap_err();
    assert!(matches!(error, Error::LimitExceeded { what: "tile_pairs", .. }));
}

#[test]
fn memory_is_limited_before_it_is_taken() {
    let p = scene(64, 64, 100, Channels::Rgb, Blend::Normalized, 1);
    let mut limits = Limits::default();
    limits.alloc = 4096;
    assert!(matches!(Renderer::new(&p, &View::full(&p), &limits), Err(Error::LimitExceeded { what: "alloc", .. })));
    limits.alloc = 64 * 64 * 3 - 1;
    let empty = picture(64, 64, Channels::Rgb, Blend::Normalized, Vec::new());
    let renderer = Renderer::new(&empty, &View::full(&empty), &limits).unwrap();
    assert!(matches!(renderer.render(Depth::Eight), Err(Error::LimitExceeded { what: "alloc", .. })));
}

#[test]
fn floats_that_are_no_numbers_are_the_callers_fault() {
    let sound = one([1.0, 1.0], [1.0, 1.0], 0.0);
    for bad in [f32::NAN, f32::INFINITY] {
        for g in [
            Gaussian { mean: [bad, 0.0], ..sound },
            Gaussian { scale: [bad, 1.0], ..sound },
            Gaussian { rotation: bad, ..sound },
            Gaussian { color: [bad; 4], ..sound },
            Gaussian { scale: [1.0, 0.0], ..sound },
        ] {
            let p = picture(8, 8, Channels::Rgb, Blend::Normalized, vec![g]);
            assert!(matches!(Renderer::new(&p, &View::full(&p), &Limits::default()), Err(Error::Parameter { .. })));
        }
    }
}

#[test]
fn views_outside_their_parent_are_the_callers_fault() {
    let view = View::of_size(10, 10);
    assert!(view.crop(0, 0, 0, 1).is_err());
    assert!(view.crop(5, 0, 6, 1).is_err());
    assert!(view.crop(u32::MAX, 0, 2, 1).is_err());
    assert!(view.resized(0, 1).is_err());
    assert!(view.resized(1, (1 << 20) + 1).is_err());
}
