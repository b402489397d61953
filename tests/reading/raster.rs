//! Compares the rasterizer with its definition in f64, and parts of views with the whole.

use std::f32::consts::FRAC_PI_2;

use crate::scenes::{Random, codes, scene};
use ssplat::unstable::bitstream::splats::Steps;
use ssplat::unstable::raster::reference;
use ssplat::{Blend, Channels, Depth, Error, Gaussian, Gaussians, Limit, Limits, Rect, Samples};
use ssplat::{Renderer, SamplesMut, View};

fn picture(width: u32, height: u32, channels: Channels, blend: Blend, gaussians: Vec<Gaussian>) -> Gaussians {
    Gaussians { width, height, channels, depth: Depth::Eight, blend, background: [0.4, 0.7, 0.2, 0.9], list: gaussians }
}

fn render(picture: &Gaussians, view: &View, depth: Depth) -> Vec<u16> {
    codes(Renderer::new(picture, view, &Limits::default()).unwrap().render(depth).unwrap().into_samples())
}

/// Returns the largest difference to the reference at `depth`, in code values.
fn worst(picture: &Gaussians, view: &View, depth: Depth) -> u16 {
    let drawn = render(picture, view, depth);
    let want = reference::filtered(picture, view);
    assert_eq!(drawn.len(), want.len());
    drawn.iter().zip(want).map(|(&a, v)| a.abs_diff(reference::code(v, depth))).max().unwrap()
}

/// Returns the PSNR of a reduced `view` of the whole picture against the averages of the full view's pixels that each
/// of its pixels covers, dB.
fn psnr_to_averages(picture: &Gaussians, view: &View) -> f64 {
    let drawn = render(picture, view, Depth::Sixteen);
    let full = View::new(picture.width, picture.height);
    let pixels = render(picture, &full, Depth::Sixteen);
    let (count, [across, down]) = (picture.channels.count(), view.step());
    // The fraction of each pixel of the full view that lies within output pixel `i`.
    let covered = |i: u32, step: f64| {
        let (start, end) = (f64::from(i) * step, f64::from(i + 1) * step);
        let last = (end - 1e-9).floor() as u32;
        (start as u32..=last).map(move |p| (p as usize, end.min(f64::from(p) + 1.0) - start.max(f64::from(p))))
    };
    let mut error = 0.0;
    for j in 0..view.height() {
        for i in 0..view.width() {
            for c in 0..count {
                let mut sum = 0.0;
                for (y, tall) in covered(j, down) {
                    for (x, wide) in covered(i, across) {
                        sum += wide * tall * f64::from(pixels[(y * full.width() as usize + x) * count + c]);
                    }
                }
                let got = f64::from(drawn[(j * view.width() + i) as usize * count + c]);
                error += (got - sum / across / down).powi(2);
            }
        }
    }
    10.0 * (65535.0f64.powi(2) * drawn.len() as f64 / error).log10()
}

fn one(mean: [f32; 2], scale: [f32; 2], rotation: f32) -> Gaussian {
    Gaussian { mean, scale, rotation, color: [3.5, -2.0, 1.0, 0.3] }
}

#[test]
fn fitted_scenes_are_within_one_code_value_for_all_channels_and_blends() {
    for channels in [Channels::Grey, Channels::GreyAlpha, Channels::Rgb, Channels::Rgba] {
        for blend in [Blend::Normalized, Blend::Sum] {
            let p = scene(150, 131, 300, channels, blend, 1);
            assert!(worst(&p, &View::new(p.width, p.height), Depth::Eight) <= 1, "{channels:?} {blend:?}");
            // 16 bits resolve f32 and the recurrence's drift: 1.2e-4 of a weight is 8 code values.
            assert!(worst(&p, &View::new(p.width, p.height), Depth::Sixteen) <= 8, "{channels:?} {blend:?}");
        }
    }
}

#[test]
#[allow(clippy::approx_constant, reason = "angles near a quarter turn")]
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
                    let found = worst(&p, &View::new(p.width, p.height), Depth::Eight);
                    assert!(found <= 1, "{found} for {blend:?} {major} {minor} {angle}");
                }
            }
        }
    }
}

#[test]
fn narrow_gaussians_are_exact_at_any_position_in_a_strip() {
    // Strips have eight columns. The range of the narrow ones' exponents in a strip depends on the position.
    for scale in
        [[0.25f32, 0.25], [0.4, 0.3], [0.6, 0.5], [0.85, 0.85], [1.3, 0.25], [2.5, 0.5], [9.0, 0.3], [60.0, 0.7]]
    {
        for angle in [0.0f32, 0.4, 0.8, 1.2, 1.5, 2.0, 2.7] {
            for place in 0..32 {
                let mean = [12.0 + 0.27 * place as f32, 9.0 + 0.31 * (place % 5) as f32];
                for blend in [Blend::Normalized, Blend::Sum] {
                    let p = picture(32, 22, Channels::Grey, blend, vec![one(mean, scale, angle)]);
                    let found = worst(&p, &View::new(p.width, p.height), Depth::Sixteen);
                    assert!(found <= 8, "{found} for {blend:?} {scale:?} {angle} at {mean:?}");
                }
            }
        }
    }
}

#[test]
fn shapes_that_end_far_from_their_mean_are_within_one_code_value() {
    // The mean of a needle is up to 2²⁰ pixels away from the pixels that are rendered.
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
            let view =
                View::new(p.width, p.height).crop(Rect::new(at[0] as u32 - 20, at[1] as u32 - 20, 40, 40)).unwrap();
            let found = worst(&p, &view, Depth::Eight);
            assert!(found <= 1, "{found} for {major} {minor} {angle} at {mean:?}");
        }
    }
}

#[test]
fn sparse_pictures_with_small_weight_sums_are_within_one_code_value() {
    // One Gaussian per 40 × 40 pixels, with scales that leave most pixels with Σw below 0.02.
    for seed in 0..20 {
        let mut p = scene(160, 120, 12, Channels::Rgb, Blend::Normalized, seed);
        for g in &mut p.list {
            g.color = [-4.0, 4.0, 2.0, 0.0];
        }
        assert!(worst(&p, &View::new(p.width, p.height), Depth::Eight) <= 1, "seed {seed}");
    }
}

/// A picture of any valid integers: narrow, huge and tiny Gaussians, colours up to the ends of their range.
fn legal(seed: u64, count: usize, blend: Blend, channels: Channels) -> Gaussians {
    let mut random = crate::synthetic::Random(seed);
    let steps = Steps {
        scale: random.below(16) as u8,
        angle: random.below(4) as u8,
        position: random.below(16) as u8,
        coarsest: random.below(6) as i8,
        range: random.below(10) as u8,
        luma: random.below(16) as u8,
        chroma: random.below(4) as u8,
    };
    let mut splats = crate::synthetic::scene(&crate::synthetic::Scene {
        channels,
        size: [41, 131],
        count: 0,
        seed,
        steps,
        ..Default::default()
    });
    splats.blend = blend;
    let most = splats.quantizer().most_color();
    splats.gaussians = (0..count).map(|_| crate::synthetic::any_primitive(&splats, &mut random)).collect();
    for p in &mut splats.gaussians {
        // Most have a size at which several overlap, and extreme colours.
        if random.below(4) > 0 {
            for (c, most) in p.color.iter_mut().zip(most).take(channels.count()) {
                *c = if *c < 0 { -most } else { most };
            }
        }
    }
    splats.to_gaussians()
}

#[test]
fn the_largest_valid_colours_are_within_tolerance_at_16_bits() {
    let mut worst = [0.0f64; 2];
    for seed in 0..400 {
        for (k, blend) in [Blend::Normalized, Blend::Sum].into_iter().enumerate() {
            let channels = [Channels::Rgb, Channels::Grey, Channels::Rgba, Channels::GreyAlpha][seed as usize % 4];
            let p = legal(seed, 2 + seed as usize % 60, blend, channels);
            let view = View::new(p.width, p.height);
            let drawn = render(&p, &view, Depth::Sixteen);
            let want = reference::filtered(&p, &view);
            // The terms of the sum blend without their signs.
            let mut amounts = p.clone();
            amounts.background = p.background.map(f32::abs);
            amounts.list.iter_mut().for_each(|g| g.color = g.color.map(f32::abs));
            let amounts = reference::sample(&amounts, &view);
            for ((got, want), amount) in drawn.into_iter().zip(want).zip(amounts) {
                let most = if blend == Blend::Sum { (amount / 16.0).max(1.0) } else { 1.0 };
                let off = f64::from(got.abs_diff(reference::code(want, Depth::Sixteen)));
                worst[k] = worst[k].max(off / most);
            }
        }
    }
    println!("{worst:?}");
    assert!(worst.iter().all(|&off| off <= 257.0), "{worst:?}");
}

#[test]
fn enlarged_views_sample_the_continuous_picture() {
    let p = scene(60, 50, 80, Channels::Rgb, Blend::Normalized, 3);
    for (w, h) in [(60, 50), (61, 50), (175, 333), (600, 500)] {
        let view = View::new(p.width, p.height).resized(w, h).unwrap();
        assert!(worst(&p, &view, Depth::Eight) <= 1, "{w}×{h}");
        assert_eq!(reference::filtered(&p, &view), clamped(reference::sample(&p, &view)), "{w}×{h}");
    }
    let part = View::new(p.width, p.height).crop(Rect::new(20, 10, 9, 7)).unwrap().resized(90, 140).unwrap();
    assert!(worst(&p, &part, Depth::Eight) <= 1);
    assert_eq!(reference::filtered(&p, &part), clamped(reference::sample(&p, &part)));
}

fn clamped(values: Vec<f64>) -> Vec<f64> {
    values.into_iter().map(|v| v.clamp(0.0, 1.0)).collect()
}

#[test]
fn reduced_views_are_within_one_code_value_of_their_definition() {
    // Steps along x and y that need each number of samples, with and without widening, combined with enlarging, and
    // beyond the maximum.
    let sizes = [(109, 131), (64, 80), (50, 33), (20, 300), (19, 16), (5, 7), (1, 1)];
    for channels in [Channels::Grey, Channels::GreyAlpha, Channels::Rgb, Channels::Rgba] {
        for blend in [Blend::Normalized, Blend::Sum] {
            let mut p = scene(150, 131, 60, channels, blend, 31);
            p.list.push(one([70.0, 60.0], [400.0, 0.25], 0.7));
            p.list.push(one([20.0, 90.0], [0.25, 0.25], 0.0));
            for (w, h) in sizes {
                let view = View::new(p.width, p.height).resized(w, h).unwrap();
                let want = reference::filtered(&p, &view);
                for (depth, most) in [(Depth::Eight, 1), (Depth::Sixteen, 8)] {
                    let drawn = render(&p, &view, depth);
                    assert_eq!(drawn.len(), want.len());
                    for (i, (&got, &value)) in drawn.iter().zip(&want).enumerate() {
                        let off = f64::from(got.abs_diff(reference::code(value, depth)));
                        // The tolerance for colours of nearly transparent pixels is larger.
                        let pixel = &want[i - i % channels.count()..][..channels.count()];
                        let alpha = channels.alpha().filter(|&k| k != i % channels.count()).map_or(1.0, |k| pixel[k]);
                        let most = f64::from(most) * (1.0 / (16.0 * alpha)).max(1.0);
                        assert!(off <= most, "{off} of {most} for {channels:?} {blend:?} {w}×{h} {depth:?}");
                    }
                }
            }
        }
    }
}

#[test]
#[allow(clippy::approx_constant, reason = "angles near a quarter turn")]
fn single_gaussians_of_every_shape_are_within_one_code_value_when_reduced() {
    let scales = [0.25f32, 0.8, 3.0, 40.0, 1e4, 1_048_576.0];
    for blend in [Blend::Normalized, Blend::Sum] {
        for (i, &major) in scales.iter().enumerate() {
            for &minor in &scales[..=i] {
                for angle in [0.0f32, 1e-4, 0.7, 1.57, std::f32::consts::FRAC_PI_2, 2.4] {
                    let p = picture(400, 210, Channels::Rgb, blend, vec![one([186.37, 81.81], [major, minor], angle)]);
                    for (w, h) in [(280, 26), (40, 20), (6, 3)] {
                        let view = View::new(p.width, p.height).resized(w, h).unwrap();
                        let found = worst(&p, &view, Depth::Eight);
                        assert!(found <= 1, "{found} for {blend:?} {major} {minor} {angle} at {w}×{h}");
                    }
                }
            }
        }
    }
}

#[test]
fn reduced_views_are_close_to_the_averages_of_the_full_view() {
    // Spaced by 7 pixels as at a ratio of 50, with scales down to the smallest.
    for (blend, seed) in [(Blend::Normalized, 12), (Blend::Sum, 13)] {
        let mut p = scene(768, 512, 8000, Channels::Rgb, blend, seed);
        for g in &mut p.list {
            g.color = g.color.map(|c| if blend == Blend::Sum { 0.2 * c } else { c });
        }
        let full = View::new(p.width, p.height);
        for (w, h, least) in [(384, 256, 70.0), (192, 128, 70.0), (96, 64, 70.0), (256, 171, 40.0), (48, 32, 40.0)] {
            let found = psnr_to_averages(&p, &full.resized(w, h).unwrap());
            assert!(found >= least, "{found} dB for {blend:?} at {w}×{h}");
        }
    }
}

/// An opaque white disc on a transparent red (or black) background. It has no fringe at full size, because the white
/// continues for a few pixels beyond the disc.
fn logo(channels: Channels) -> Gaussians {
    let hidden = if channels == Channels::Rgba { [1.0, 0.0, 0.0, 0.0] } else { [0.0; 4] };
    let mut p = picture(96, 96, channels, Blend::Normalized, Vec::new());
    p.background = hidden;
    for i in 0..48 * 48 {
        let mean = [i % 48, i / 48].map(|v| v as f32 * 2.0 + 1.0);
        let radius = (mean[0] - 48.0).hypot(mean[1] - 48.0);
        let mut color = if radius < 34.0 { [1.0; 4] } else { hidden };
        color[channels.count() - 1] = f32::from(radius < 28.0);
        p.list.push(Gaussian { mean, scale: [1.0; 2], rotation: 0.0, color });
    }
    p
}

#[test]
fn hidden_colours_leave_no_fringe_when_reduced() {
    for channels in [Channels::Rgba, Channels::GreyAlpha] {
        let (p, count) = (logo(channels), channels.count());
        for (w, h) in [(96, 96), (48, 48), (19, 31), (12, 12), (5, 6)] {
            let drawn = render(&p, &View::new(p.width, p.height).resized(w, h).unwrap(), Depth::Eight);
            let mut partly = 0;
            for pixel in drawn.chunks_exact(count) {
                let alpha = f64::from(pixel[count - 1]) / 255.0;
                partly += u32::from(alpha > 0.1 && alpha < 0.9);
                // Over white, white stays white.
                for &color in &pixel[..count - 1] {
                    let over_white = alpha * f64::from(color) + 255.0 * (1.0 - alpha);
                    assert!(over_white > 254.0, "{pixel:?} over white at {w}×{h}");
                }
            }
            assert!(partly > 3, "{partly} pixels of the edge at {w}×{h}");
        }
    }
}

#[test]
fn lines_of_one_pixel_do_not_alias_when_reduced() {
    // Alternating black and white columns: grey at every reduced size.
    let lines = (0..640)
        .map(|x| Gaussian {
            mean: [x as f32 + 0.5, 30.0],
            scale: [200.0, 0.4],
            rotation: std::f32::consts::FRAC_PI_2,
            color: [(x % 2) as f32; 4],
        })
        .collect();
    let p = picture(640, 60, Channels::Grey, Blend::Normalized, lines);
    let range = |values: &[f64]| {
        // Columns at the ends include half a line more of one kind.
        let inner = &values[2..values.len() - 2];
        inner.iter().fold(0.0, |m: f64, &v| m.max(v)) - inner.iter().fold(1.0, |m: f64, &v| m.min(v))
    };
    // From 4 to 16 pixels of the picture per output pixel. Averages over 9.14 pixels still depend on whether a tenth
    // is black or white, and beyond 12 the samples are further apart than the lines require.
    let most =
        [(162, 0.03), (158, 0.03), (107, 0.03), (82, 0.05), (80, 0.01), (78, 0.05), (70, 0.11), (53, 0.03), (39, 0.25)];
    for (width, most) in most {
        let view = View::new(p.width, p.height).resized(width, 1).unwrap();
        let drawn: Vec<f64> = render(&p, &view, Depth::Eight).into_iter().map(|v| f64::from(v) / 255.0).collect();
        let found = range(&drawn);
        assert!(found <= most, "{found} at {width}");
        // The range without a filter; at 80, each sample lies between two lines.
        let sampled = range(&clamped(reference::sample(&p, &view)));
        assert!(sampled > 0.8 || width == 80, "{sampled} at {width}");
    }
}

#[test]
fn far_reductions_are_cheap() {
    // One tile and one pair per primitive, however large the picture.
    let side = 1 << 20;
    let mut r = Random(3);
    let gaussians = (0..2000)
        .map(|_| one([r.within(0.0, side as f32), r.within(0.0, side as f32)], [9.0, 2.0], r.within(0.0, 3.0)))
        .collect();
    let p = picture(side, side, Channels::Rgb, Blend::Normalized, gaussians);
    let mut limits = Limits::default();
    limits.tile_pairs = 2000;
    for (w, h) in [(1, 1), (16, 16)] {
        let view = View::new(p.width, p.height).resized(w, h).unwrap();
        assert!(Renderer::new(&p, &view, &limits).is_ok(), "{w}×{h}");
        assert!(worst(&p, &view, Depth::Eight) <= 1, "{w}×{h}");
    }
}

#[test]
fn tile_pairs_of_reduced_views_are_those_of_their_samples() {
    // 80 × 80 output pixels of 8 × 8 samples each: 5 × 5 tiles.
    let giants = vec![one([500.0, 500.0], [1e4, 1e4], 0.0); 1000];
    let p = picture(640, 640, Channels::Rgb, Blend::Normalized, giants);
    let view = View::new(p.width, p.height).resized(80, 80).unwrap();
    let mut limits = Limits::default();
    limits.tile_pairs = 24_999;
    let error = Renderer::new(&p, &view, &limits).unwrap_err();
    assert!(matches!(error, Error::LimitExceeded { limit: Limit::TilePairs, .. }));
    limits.tile_pairs = 25_000;
    assert!(Renderer::new(&p, &view, &limits).is_ok());
}

#[test]
fn every_division_into_parts_gives_the_same_bits() {
    let mut p = scene(401, 277, 900, Channels::Rgb, Blend::Normalized, 5);
    p.list.push(one([200.0, 100.0], [900.0, 0.4], 0.61));
    p.list.push(one([-50.0, 300.0], [300.0, 200.0], 2.0));
    let full = View::new(p.width, p.height);
    let sizes = [(401, 277), (1000, 300), (300, 200), (150, 90), (40, 200), (31, 23), (13, 9)];
    for view in sizes.map(|(w, h)| full.resized(w, h).unwrap()) {
        let whole = render(&p, &view, Depth::Sixteen);
        let mut r = Random(11);
        for _ in 0..40 {
            let (x, y) = (r.within(0.0, view.width() as f32) as u32, r.within(0.0, view.height() as f32) as u32);
            let w = 1 + r.within(0.0, (view.width() - x - 1) as f32) as u32;
            let h = 1 + r.within(0.0, (view.height() - y - 1) as f32) as u32;
            let part = render(&p, &view.crop(Rect::new(x, y, w, h)).unwrap(), Depth::Sixteen);
            for j in 0..h as usize {
                let row = 3 * ((y as usize + j) * view.width() as usize + x as usize);
                let got = &part[3 * j * w as usize..3 * (j + 1) * w as usize];
                assert_eq!(got, &whole[row..row + 3 * w as usize], "row {j} of {x},{y} {w}×{h}");
            }
        }
    }
}

#[test]
fn bands_together_equal_the_whole() {
    let p = scene(300, 333, 500, Channels::Rgba, Blend::Sum, 6);
    let full = View::new(p.width, p.height);
    let reduced = full.resized(100, 60).unwrap();
    for view in [
        full,
        full.crop(Rect::new(17, 41, 200, 250)).unwrap(),
        reduced,
        reduced.crop(Rect::new(9, 11, 50, 43)).unwrap(),
    ] {
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
    let views = [View::new(p.width, p.height), View::new(p.width, p.height).resized(90, 70).unwrap()];
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| views.map(|view| render(&p, &view, Depth::Sixteen)))
    };
    let one = with(1);
    for threads in [2, 3, 7] {
        assert_eq!(one, with(threads), "{threads} threads");
    }
}

#[test]
fn pictures_of_zero_one_and_two_primitives_render() {
    for blend in [Blend::Normalized, Blend::Sum] {
        for count in 0..3 {
            let all = [one([10.0, 9.0], [4.0, 2.0], 0.3), one([1.0, 20.0], [0.25, 0.25], 0.0)];
            let p = picture(33, 21, Channels::Rgb, blend, all[..count].to_vec());
            assert!(worst(&p, &View::new(p.width, p.height), Depth::Eight) <= 1);
        }
    }
}

#[test]
fn primitives_outside_the_view_do_not_change_it() {
    let mut p = scene(200, 100, 200, Channels::Rgb, Blend::Normalized, 9);
    let view = View::new(p.width, p.height).crop(Rect::new(64, 32, 70, 40)).unwrap();
    let before = render(&p, &view, Depth::Sixteen);
    p.list.push(one([1000.0, 1000.0], [100.0, 50.0], 0.3));
    p.list.insert(0, one([-1e6, 40.0], [1000.0, 1.0], 0.0));
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
        assert!(worst(&p, &View::new(p.width, p.height), Depth::Eight) <= 1, "round {round}");
    }
}

/// Fuzzing found a sum that overflowed for a support wider than any integer.
#[test]
fn the_largest_finite_scale_covers_the_picture() {
    let scene = picture(300, 200, Channels::Rgb, Blend::Sum, vec![one([150.0, 100.0], [f32::MAX; 2], 0.3)]);
    assert!(worst(&scene, &View::new(scene.width, scene.height), Depth::Eight) <= 1);
}

#[test]
fn tile_pairs_are_checked_before_the_work() {
    let giants = vec![one([500.0, 500.0], [1e4, 1e4], 0.0); 1000];
    let p = picture(1000, 1000, Channels::Rgb, Blend::Normalized, giants);
    let mut limits = Limits::default();
    limits.tile_pairs = 60_000;
    // 8 × 8 tiles for each of 1000.
    let error = Renderer::new(&p, &View::new(p.width, p.height), &limits).unwrap_err();
    assert!(matches!(error, Error::LimitExceeded { limit: Limit::TilePairs, requested: 60_001.., allowed: 60_000 }));
    limits.tile_pairs = 64_000;
    assert!(Renderer::new(&p, &View::new(p.width, p.height), &limits).is_ok());
}

#[test]
fn work_is_limited_in_proportion_to_pixels_and_primitives() {
    // 16384 primitives on each of 64 tiles.
    let giants = vec![one([500.0, 500.0], [1e4, 1e4], 0.0); 16384];
    let p = picture(1000, 1000, Channels::Rgb, Blend::Normalized, giants);
    let error = Renderer::new(&p, &View::new(p.width, p.height), &Limits::default()).unwrap_err();
    assert!(matches!(error, Error::LimitExceeded { limit: Limit::Work, .. }));
}

#[test]
fn the_work_of_narrow_gaussians_counts_their_exponentials() {
    // Two strips of 8 columns are rendered for each.
    let of = |scale: [f32; 2]| {
        let p = picture(400, 1000, Channels::Rgb, Blend::Normalized, vec![one([200.0, 500.0], scale, FRAC_PI_2)]);
        let mut limits = Limits::default();
        limits.work = 0;
        match Renderer::new(&p, &View::new(p.width, p.height), &limits) {
            Err(Error::LimitExceeded { limit: Limit::Work, requested, .. }) => requested,
            other => panic!("{other:?}"),
        }
    };
    let (needle, bar) = (of([1e4, 0.25]), of([1e4, 2.0]));
    // Eight tiles at an edge between columns of tiles.
    let pairs = 8 * 1024;
    assert!((4 * 16_000..4 * 20_000).contains(&(needle - pairs)), "{needle}");
    assert!((16_000..32_000).contains(&(bar - pairs)), "{bar}");
}

#[test]
fn two_million_primitives_on_a_16k_picture_are_within_the_limits() {
    // Each pixel is covered by 40 Gaussians, more than twice as many as in fits of photographs (kodim05 and kodim15 at
    // ratios from 20 to 1000: 4 to 16).
    for (width, height) in [(10848, 16320), (16384, 16384)] {
        let mut r = Random(9);
        let area = 40.0 * (width as f32 * height as f32) / 2e6 / (std::f32::consts::PI * 3.5 * 3.5);
        let gaussians = (0..2_000_000)
            .map(|_| {
                let stretch = r.within(0.0, 2.0).exp2();
                let mean = [r.within(0.0, width as f32), r.within(0.0, height as f32)];
                one(mean, [area.sqrt() * stretch, area.sqrt() / stretch], r.within(0.0, 3.0))
            })
            .collect();
        let p = picture(width, height, Channels::Rgba, Blend::Normalized, gaussians);
        let renderer = Renderer::new(&p, &View::new(p.width, p.height), &Limits::default());
        assert!(renderer.is_ok(), "{renderer:?}");
        if usize::BITS == 64 {
            // The rest of the limit holds the pixels, the primitives as integers and floats, and the memory for
            // reading them.
            let pixels = u64::from(width) * u64::from(height) * 8;
            let each = 200 + size_of::<Gaussian>() as u64 + 300;
            assert!(pixels + 2_000_000 * each < Limits::default().alloc);
        }
    }
}

#[test]
fn memory_is_checked_before_it_is_allocated() {
    let p = scene(64, 64, 100, Channels::Rgb, Blend::Normalized, 1);
    let mut limits = Limits::default();
    limits.alloc = 4096;
    assert!(matches!(
        Renderer::new(&p, &View::new(p.width, p.height), &limits),
        Err(Error::LimitExceeded { limit: Limit::Alloc, .. })
    ));
    limits.alloc = 64 * 64 * 3 - 1;
    let empty = picture(64, 64, Channels::Rgb, Blend::Normalized, Vec::new());
    let renderer = Renderer::new(&empty, &View::new(empty.width, empty.height), &limits).unwrap();
    assert!(matches!(renderer.render(Depth::Eight), Err(Error::LimitExceeded { limit: Limit::Alloc, .. })));
}

#[test]
fn non_finite_floats_are_parameter_errors() {
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
            assert!(matches!(
                Renderer::new(&p, &View::new(p.width, p.height), &Limits::default()),
                Err(Error::Parameter { .. })
            ));
        }
    }
}

#[test]
fn views_outside_their_parent_are_parameter_errors() {
    let view = View::new(10, 10);
    assert!(view.crop(Rect::new(0, 0, 0, 1)).is_err());
    assert!(view.crop(Rect::new(5, 0, 6, 1)).is_err());
    assert!(view.crop(Rect::new(u32::MAX, 0, 2, 1)).is_err());
    assert!(view.resized(0, 1).is_err());
    assert!(view.resized(1, (1 << 20) + 1).is_err());
}
