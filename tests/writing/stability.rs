//! Stiff and extreme cases: each picture is finite, close to its definition, and no worse than one constant colour.
//!
//! `cargo test --release --test writing stability -- --nocapture` prints the rows that `ssplat-lab report --stability` shows.

use crate::stiff::{Bound, Fit, Row};
use crate::synthetic::{Levels, Scene, with_layer};
use ssplat::unstable::bitstream::{DetailHead, read, to_bytes};
use ssplat::unstable::metrics;
use ssplat::unstable::raster::reference;
use ssplat::unstable::{DecodeOptions, EncodeOptions, encode};
use ssplat::{Blend, Channels, Depth, Detail, Error, Gaussian, Gaussians, Limits, Pixels, Samples, Target};
use ssplat::{Renderer, View};

/// Worst difference to the definition over the pixels of `picture`, in units of an 8-bit code value.
fn render_error(picture: &Gaussians) -> f64 {
    let view = View::new(picture.width, picture.height);
    let renderer = match Renderer::new(picture, &view, &Limits::default()) {
        Ok(renderer) => renderer,
        Err(_) => return f64::INFINITY,
    };
    let Ok(pixels) = renderer.render(Depth::Sixteen) else { return f64::INFINITY };
    let Samples::U16(drawn) = pixels.samples() else { return f64::INFINITY };
    let want = reference::sample(picture, &view);
    let difference = |(&d, w): (&u16, &f64)| (f64::from(d) / 65535.0 - w.clamp(0.0, 1.0)).abs() * 255.0;
    drawn.iter().zip(&want).map(difference).fold(0.0, |a, d| if d.is_nan() { f64::INFINITY } else { a.max(d) })
}

fn scene(blend: Blend, gaussians: Vec<Gaussian>) -> Gaussians {
    let background = [0.4, 0.7, 0.2, 0.0];
    Gaussians {
        width: 160,
        height: 144,
        channels: Channels::Rgb,
        depth: Depth::Eight,
        blend,
        background,
        list: gaussians,
    }
}

fn gaussian(mean: [f32; 2], scale: [f32; 2], rotation: f32) -> Gaussian {
    Gaussian { mean, scale, rotation, color: [1.2, -0.3, 0.6, 0.0] }
}

/// f32 pictures against the f64 definition, over scales, aspects, positions and numbers.
fn rendering() -> Vec<Row> {
    let blends = [Blend::Normalized, Blend::Sum];
    let mut rows = Vec::new();
    let mut add = |case: String, guard: &str, pictures: Vec<Gaussians>| {
        let worst = pictures.iter().map(render_error).fold(0.0, f64::max);
        rows.push(Row { group: "f32 picture".into(), case, worst, bound: Bound::Codes(1.0), guard: guard.into() });
    };
    let turns = [0.0, 0.3, std::f32::consts::FRAC_PI_4, 1.5, 2.8];
    let conditioned = "conic from scales and angle, never inverted; ε in the division";
    for scale in [0.05f32, 0.25, 0.5, 1.0, 10.0, 100.0, 1e3, 1e4, 1e5] {
        let each = |blend| turns.map(|t| scene(blend, vec![gaussian([70.3, 61.8], [scale, scale * 0.8], t)]));
        add(format!("scale {scale} px"), conditioned, blends.into_iter().flat_map(each).collect());
    }
    for aspect in [1.0f32, 10.0, 100.0, 1e3, 1e4] {
        let minor = 0.4;
        let each = |blend| turns.map(|t| scene(blend, vec![gaussian([70.3, 61.8], [minor * aspect, minor], t)]));
        add(
            format!("aspect {aspect} : 1"),
            "exponent in the Gaussian's own axes; recurrences restarted",
            blends.into_iter().flat_map(each).collect(),
        );
    }
    let places: [(&str, [f32; 2]); 6] = [
        ("on a pixel centre", [64.5, 64.5]),
        ("on a pixel edge", [80.0, 70.0]),
        ("on a tile corner", [128.0, 128.0]),
        ("on the picture's corner", [0.0, 0.0]),
        ("outside by 300 px", [-300.0, 460.0]),
        ("outside by 1e6 px", [1e6, -1e6]),
    ];
    for (name, mean) in places {
        let each = |blend| [[3.0, 2.0], [40.0, 0.5], [200.0, 90.0]].map(|s| scene(blend, vec![gaussian(mean, s, 0.6)]));
        add(format!("centre {name}"), "bins from the support's box", blends.into_iter().flat_map(each).collect());
    }
    for count in [0, 1, 2] {
        let each = |blend| scene(blend, vec![gaussian([80.0, 72.0], [30.0, 12.0], 0.4); count]);
        add(format!("N = {count}"), "background and ε stand alone", blends.into_iter().map(each).collect());
    }
    let many = |blend| scene(blend, vec![gaussian([80.2, 71.7], [20.0, 6.0], 1.1); 1000]);
    add("1000 coincident".into(), "order-independent sums", vec![many(Blend::Normalized)]);
    rows
}

/// Pictures of two layers against their definition: extreme steps and levels, at the picture's size and at others.
fn layers() -> Vec<Row> {
    let head = |change: fn(&mut DetailHead)| {
        let mut head = DetailHead::PLAIN;
        change(&mut head);
        head
    };
    let seen = |step: u16, slopes: [u8; 2], chroma: [u8; 2]| {
        let mut head = DetailHead::SEEN;
        (head.step, head.slopes, head.chroma) = (step, slopes, chroma);
        head
    };
    let mut drawing = seen(600, [20, 40], [64, 32]);
    drawing.sizes[1][0] = drawing.sizes[0][0];
    let cases = [
        ("step 1, levels to 9", head(|h| h.step = 1), 9),
        ("step 1, levels to 32767", head(|h| h.step = 1), 32_767),
        ("step 65535, levels to 2", head(|h| h.step = 65_535), 2),
        ("step 65535, levels to 32767", head(|h| h.step = 65_535), 32_767),
        (
            "slopes 255, classes 8, ratios 255",
            { head(|h| (h.step, h.slopes, h.classes, h.chroma) = (900, [255, 255], 8, [255, 255])) },
            5,
        ),
        // The steps of `--tune iq` at both ends of its range and beyond them, and those of drawings.
        ("steps for perceptual quality, step 1", seen(1, [10, 40], [80, 40]), 32_767),
        ("steps for perceptual quality, step 100", seen(100, [10, 40], [80, 40]), 255),
        ("steps for perceptual quality, step 3000", seen(3000, [130, 60], [64, 32]), 15),
        ("steps for perceptual quality, step 65535", seen(65_535, [130, 60], [64, 32]), 32_767),
        ("steps for drawings, step 600", drawing, 63),
        ("blocks of 4", head(|h| h.sizes = [[0, 0], [0, 0]]), 4),
        ("blocks of 32", head(|h| h.sizes = [[3, 3], [3, 3]]), 4),
    ];
    let mut rows = Vec::new();
    for (name, head, largest) in cases {
        let mut worst = 0.0f64;
        for (channels, depth, blend) in [
            (Channels::Rgb, Depth::Eight, Blend::Normalized),
            (Channels::Grey, Depth::Sixteen, Blend::Sum),
            (Channels::Rgba, Depth::Eight, Blend::Normalized),
        ] {
            let mut splats =
                crate::synthetic::scene(&Scene { channels, size: [270, 61], count: 12, seed: 5, ..Scene::default() });
            (splats.depth, splats.blend) = (depth, blend);
            let levels = Levels { largest, filled: 1, ..Levels::new(7) };
            let bytes = to_bytes(&with_layer(splats, head, levels)).expect("a legal file");
            let splats = read(&bytes[..], &Limits::default()).expect("a legal file");
            // Enlarged, reduced along one axis, and at its own size. Where alpha is small, colours of reduced views
            // have a wider bound (§5.5).
            let sizes: &[[u32; 2]] =
                if channels == Channels::Rgba { &[[270, 61]] } else { &[[270, 61], [611, 61], [89, 40]] };
            for &[width, height] in sizes {
                let view = View::new(270, 61).resized(width, height).expect("a legal view");
                let drawn = splats.renderer(&view, &Limits::default()).and_then(|r| r.render(depth));
                let want = reference::detailed(&splats, &view);
                let Ok(drawn) = drawn else { return vec![row_of_layers(name, f64::INFINITY)] };
                for (i, w) in want.iter().enumerate() {
                    let difference = (value(&drawn, i) - w.clamp(0.0, 1.0)).abs() * 255.0;
                    worst = if difference.is_nan() { f64::INFINITY } else { worst.max(difference) };
                }
            }
        }
        rows.push(row_of_layers(name, worst));
    }
    rows
}

/// Returns sample `i`; white is 1.
fn value(pixels: &Pixels, i: usize) -> f64 {
    match pixels.samples() {
        Samples::U8(v) => f64::from(v[i]) / 255.0,
        Samples::U16(v) => f64::from(v[i]) / 65535.0,
    }
}

fn row_of_layers(name: &str, worst: f64) -> Row {
    let guard = "integers modulo 2³², clamped to 16 bits; sums in f32 after that";
    Row { group: "two layers".into(), case: name.into(), worst, bound: Bound::Codes(1.0), guard: guard.into() }
}

/// Fits, writes, reads and renders one picture, and compares it with a picture of its mean colour. With `has_layer`,
/// half of the bytes are for a detail layer.
fn fit(case: &Fit, has_layer: bool) -> Result<Row, Error> {
    let mut options = EncodeOptions::default();
    options.target = case.target;
    if has_layer {
        options.detail = Detail::GaussianShare(0.5);
        if matches!(case.target, Target::Gaussians(_)) {
            options.target = Target::Bytes(400 + samples(&case.pixels).len() as u64 / 10);
        }
    }
    options.effort = if case.pixels.width().max(case.pixels.height()) < 1000 { 2 } else { 1 };
    let guard = "log-scales, bounded aspect, ε; best state kept";
    let row = |worst| Row {
        group: if has_layer { "fit of two layers" } else { "fit" }.into(),
        case: case.name.clone(),
        worst,
        bound: Bound::Gain(-0.01),
        guard: guard.into(),
    };
    let encoded = match encode(&case.pixels, &options) {
        // A size that does not even hold a header is refused with this error.
        Err(Error::TooSmall { .. }) => {
            return Ok(Row { guard: "refused with a typed error: too few bytes for any picture".into(), ..row(0.0) });
        }
        encoded => encoded?,
    };
    let splats = read(&encoded.bytes[..], &Limits::default())?;
    let picture = splats.to_gaussians();
    let finite = picture.list.iter().all(|g| {
        let all = g.mean.iter().chain(&g.scale).chain(&g.color).chain([&g.rotation]);
        all.copied().all(f32::is_finite)
    });
    let drawn = ssplat::unstable::decode(&encoded.bytes, &DecodeOptions::default())?.pixels;
    let reached = metrics::psnr(&premultiplied(&case.pixels), &premultiplied(&drawn))?;
    let constant = metrics::psnr(&premultiplied(&case.pixels), &premultiplied(&mean(&case.pixels)))?;
    let limited = |v: f64| v.min(99.0);
    let most = match options.target {
        Target::Bytes(most) => most as usize,
        Target::Ratio(ratio) => (samples(&case.pixels).len() as f64 / ratio) as usize,
        _ => usize::MAX,
    };
    let sound = finite && encoded.bytes.len() <= most;
    let worst = if sound { limited(reached) - limited(constant) } else { f64::NAN };
    Ok(row(worst))
}

fn samples(pixels: &Pixels) -> &[u8] {
    match pixels.samples() {
        Samples::U8(v) => v,
        Samples::U16(_) => unreachable!("the cases have 8 bits a sample"),
    }
}

/// Multiplies colours by alpha, so that invisible colours do not count.
fn premultiplied(pixels: &Pixels) -> Pixels {
    let count = pixels.channels().count();
    let mut v = samples(pixels).to_vec();
    if let Some(alpha) = pixels.channels().alpha() {
        for p in v.chunks_exact_mut(count) {
            for k in (0..count).filter(|&k| k != alpha) {
                p[k] = (u32::from(p[k]) * u32::from(p[alpha]) / 255) as u8;
            }
        }
    }
    Pixels::new(pixels.width(), pixels.height(), pixels.channels(), Samples::U8(v)).expect("the same size")
}

/// Returns a picture of the mean colour; colours of transparent pixels do not count.
fn mean(pixels: &Pixels) -> Pixels {
    let (count, alpha) = (pixels.channels().count(), pixels.channels().alpha());
    let (mut sum, mut weight) = ([0.0; 4], [0.0f64; 4]);
    for p in samples(pixels).chunks_exact(count) {
        for k in 0..count {
            let w = alpha.filter(|&a| a != k).map_or(1.0, |a| f64::from(p[a]));
            sum[k] += w * f64::from(p[k]);
            weight[k] += w;
        }
    }
    let value = |k: usize| if weight[k] > 0.0 { sum[k] / weight[k] / 255.0 } else { 0.0 };
    crate::stiff::picture(pixels.width(), pixels.height(), pixels.channels(), |_, _, k| value(k))
}

#[test]
fn pictures_in_f32_stay_within_a_code_value_of_their_f64_definition() {
    let rows = rendering();
    rows.iter().for_each(|r| println!("{}", r.line()));
    let failed: Vec<_> = rows.iter().filter(|r| !r.holds()).collect();
    assert!(failed.is_empty(), "{failed:#?}");
}

#[test]
fn pictures_of_two_layers_stay_within_a_code_value_of_their_definition() {
    let rows = layers();
    rows.iter().for_each(|r| println!("{}", r.line()));
    let failed: Vec<_> = rows.iter().filter(|r| !r.holds()).collect();
    assert!(failed.is_empty(), "{failed:#?}");
}

#[test]
fn fits_of_extreme_pictures_are_finite_and_no_worse_than_a_constant_colour() {
    let mut failed = Vec::new();
    for (case, has_layer) in crate::stiff::fits().iter().flat_map(|case| [(case, false), (case, true)]) {
        // The largest picture has a layer in .ci/slow only.
        let is_large = case.pixels.width().min(case.pixels.height()) > 3000;
        if is_large && has_layer && std::env::var_os("SSPLAT_CASES").is_none() {
            continue;
        }
        let row = fit(case, has_layer).unwrap_or_else(|e| panic!("{}: {e}", case.name));
        println!("{}", row.line());
        if !row.holds() {
            failed.push(row);
        }
    }
    assert!(failed.is_empty(), "{failed:#?}");
}
