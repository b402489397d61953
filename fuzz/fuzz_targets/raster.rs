//! Renders any floats as a picture: they are refused, or rendered within one code value of the f64 definition, with
//! the same result in parts and as a whole, also in reduced views.
#![no_main]

use arbitrary::{Arbitrary, Unstructured};
use libfuzzer_sys::fuzz_target;
use ssplat::unstable::bitstream::rules::MAX_COLOR;
use ssplat::unstable::gaussian::{MAX_SCALE, MIN_SCALE};
use ssplat::unstable::raster::reference;
use ssplat::{Blend, Channels, Depth, Gaussian, Gaussians, Rect, Samples};
use ssplat::{Renderer, View};
use ssplat_fuzz::tight_limits;

#[derive(Debug)]
struct Input {
    picture: Gaussians,
    /// Left, top, width and height of a part.
    part: [u32; 4],
    /// Width and height of a reduced view.
    reduced: [u32; 2],
    /// Whether a file can hold every value.
    is_legal: bool,
}

impl<'a> Arbitrary<'a> for Input {
    fn arbitrary(u: &mut Unstructured<'a>) -> arbitrary::Result<Self> {
        let (width, height) = (u.int_in_range(1..=160)?, u.int_in_range(1..=90)?);
        let is_legal = u.ratio(7, 8)?;
        let channels = *u.choose(&[Channels::Grey, Channels::GreyAlpha, Channels::Rgb, Channels::Rgba])?;
        let (x, y) = (u.int_in_range(0..=width - 1)?, u.int_in_range(0..=height - 1)?);
        let part = [x, y, u.int_in_range(1..=width - x)?, u.int_in_range(1..=height - y)?];
        let reduced = [u.int_in_range(1..=width)?, u.int_in_range(1..=height)?];
        let mut picture = Gaussians {
            width,
            height,
            channels,
            depth: Depth::Eight,
            blend: if u.arbitrary()? { Blend::Normalized } else { Blend::Sum },
            background: [0.5, 0.25, 0.75, 1.0],
            list: Vec::new(),
        };
        let most_color = if u.arbitrary()? { 4.0 } else { 2.0 * MAX_COLOR };
        while !u.is_empty() && picture.list.len() < 40 {
            let mut unit = || -> arbitrary::Result<f32> { Ok(f32::from(u.arbitrary::<u16>()?) / 65535.0) };
            // Log-uniform, from the smallest scale to far beyond the picture.
            let log_scale = |t: f32| MIN_SCALE * (MAX_SCALE / MIN_SCALE).powf(t * t);
            // Up to the maximum colour of a file.
            let vivid = |t: f32| most_color * (2.0 * t - 1.0);
            let (a, b) = (log_scale(unit()?), log_scale(unit()?));
            let gaussian = Gaussian {
                mean: [unit()? * width as f32, unit()? * height as f32],
                scale: [a.max(b), a.min(b)],
                rotation: unit()? * std::f32::consts::PI,
                color: [vivid(unit()?), vivid(unit()?), vivid(unit()?), vivid(unit()?)],
            };
            picture.list.push(gaussian);
        }
        if !is_legal {
            let poison =
                u.choose(&[f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 0.0, -1.0, 1e-45, f32::MAX, f32::MIN])?;
            if let Some(g) = picture.list.last_mut() {
                match u.int_in_range(0..=4)? {
                    0 => g.mean[0] = *poison,
                    1 => g.mean[1] = *poison,
                    2 => g.scale = [*poison; 2],
                    3 => g.rotation = *poison,
                    _ => g.color[0] = *poison,
                }
            }
        }
        Ok(Input { picture, part, reduced, is_legal })
    }
}

fn bytes(samples: &Samples) -> &[u8] {
    match samples {
        Samples::U8(v) => v,
        Samples::U16(_) => unreachable!("drawn with 8 bits"),
    }
}

fuzz_target!(|input: Input| {
    let Input { picture, part, reduced, is_legal } = input;
    let full = View::new(picture.width, picture.height);
    check(&picture, &full, part, is_legal);
    let [width, height] = reduced;
    let small = full.resized(width, height).expect("a size");
    let [x, y] = [part[0].min(width - 1), part[1].min(height - 1)];
    check(&picture, &small, [x, y, part[2].min(width - x), part[3].min(height - y)], is_legal);
});

/// Renders `view` and a part of it.
fn check(picture: &Gaussians, view: &View, [x, y, width, height]: [u32; 4], is_legal: bool) {
    let limits = tight_limits();
    let renderer = match Renderer::new(picture, view, &limits) {
        Ok(renderer) => renderer,
        Err(e) => {
            assert!(!is_legal || matches!(e, ssplat::Error::LimitExceeded { .. }), "{e}");
            return;
        }
    };
    let whole = renderer.render(Depth::Eight).expect("within the limits");
    let crop = view.crop(Rect::new(x, y, width, height)).expect("a part");
    let part =
        Renderer::new(picture, &crop, &limits).expect("a part of it").render(Depth::Eight).expect("a part of it");
    let channels = picture.channels.count();
    for row in 0..height as usize {
        let start = ((y as usize + row) * view.width() as usize + x as usize) * channels;
        let length = width as usize * channels;
        assert!(
            bytes(part.samples())[row * length..][..length] == bytes(whole.samples())[start..][..length],
            "parts differ"
        );
    }
    if is_legal {
        let reference = reference::filtered(picture, view);
        // With the sum blend, the tolerance grows with the sum of the terms (spec §5.4).
        let largest = picture.list.iter().flat_map(|g| g.color).fold(1.0f32, |most, c| most.max(c.abs()));
        let added = if picture.blend == Blend::Sum { f64::from(largest) * picture.list.len() as f64 } else { 0.0 };
        let cancelled = (added / 16.0).max(1.0);
        for (i, (&drawn, &value)) in bytes(whole.samples()).iter().zip(&reference).enumerate() {
            let want = reference::code(value, Depth::Eight);
            // In a reduced view, the tolerance for colours of nearly transparent pixels is larger.
            let pixel = &reference[i - i % channels..][..channels];
            let alpha = picture.channels.alpha().filter(|&k| k != i % channels).map_or(1.0, |k| pixel[k]);
            let most = if view.step() == [1.0; 2] { 1.0 } else { (1.0 / (16.0 * alpha)).max(1.0) };
            assert!(
                f64::from(u16::from(drawn).abs_diff(want)) <= most * cancelled,
                "sample {i}: {drawn}, reference {want}"
            );
        }
    }
}
