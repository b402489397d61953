//! Stiff and extreme cases: what each does to the worst error, and what guards it. The test suite runs the same ones.

use ssplat::raster::{Renderer, View, reference};
use ssplat::{
    Blend, Channels, Depth, EncodeOptions, Error, Gaussian, Limits, Picture, Pixels, Samples, Target, encode, metrics,
};

use super::scenes;

/// One row of the table.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    pub group: String,
    pub case: String,
    /// The worst that was seen, in the unit of `bound`.
    pub worst: f64,
    /// What it may be.
    pub bound: Bound,
    /// What keeps it there.
    pub guard: String,
}

/// The promise of a row.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Bound {
    /// At most this many 8-bit code values from the f64 definition.
    Codes(f64),
    /// At least this many decibels above the picture of one constant colour, or above an earlier state of the same fit.
    Gain(f64),
    /// A relative error of at most this.
    Relative(f64),
    /// Nothing: it is there to be known.
    Reported,
}

impl Row {
    pub fn holds(&self) -> bool {
        match self.bound {
            Bound::Codes(most) | Bound::Relative(most) => self.worst <= most,
            Bound::Gain(least) => self.worst >= least,
            Bound::Reported => true,
        }
    }

    /// How near its bound the row is, for finding the worst of several; NaN counts as the worst.
    pub fn badness(&self) -> f64 {
        let v = match self.bound {
            Bound::Codes(most) | Bound::Relative(most) => self.worst / most,
            Bound::Gain(least) => least - self.worst,
            Bound::Reported => self.worst,
        };
        if v.is_nan() { f64::INFINITY } else { v }
    }

    /// The row as one line of tab-separated text.
    pub fn line(&self) -> String {
        let (unit, bound) = match self.bound {
            Bound::Codes(v) => ("codes", v),
            Bound::Gain(v) => ("gain", v),
            Bound::Relative(v) => ("relative", v),
            Bound::Reported => ("reported", 0.0),
        };
        format!("stability\t{}\t{}\t{:.3e}\t{unit}\t{bound:e}\t{}", self.group, self.case, self.worst, self.guard)
    }
}

/// Reads the lines of [`Row::line`] among others.
pub fn parse(text: &str) -> Vec<Row> {
    let rows = text.lines().filter_map(|line| {
        // The harness of tests may have begun the line.
        let line = &line[line.find("stability\t")?..];
        let cells: Vec<&str> = line.trim().split('\t').collect();
        let ["stability", group, case, worst, unit, bound, guard] = cells[..] else { return None };
        let bound: f64 = bound.parse().ok()?;
        let bound = match unit {
            "codes" => Bound::Codes(bound),
            "gain" => Bound::Gain(bound),
            "reported" => Bound::Reported,
            _ => Bound::Relative(bound),
        };
        let worst = worst.parse().unwrap_or(f64::NAN);
        Some(Row { group: group.into(), case: case.into(), worst, bound, guard: guard.into() })
    });
    rows.collect()
}

/// Worst difference to the definition over the pixels of `picture`, in units of an 8-bit code value.
fn render_error(picture: &Picture) -> f64 {
    let view = View::full(picture);
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

fn scene(blend: Blend, gaussians: Vec<Gaussian>) -> Picture {
    let background = [0.4, 0.7, 0.2, 0.0];
    Picture { width: 160, height: 144, channels: Channels::Rgb, blend, background, gaussians }
}

fn gaussian(mean: [f32; 2], scale: [f32; 2], rotation: f32) -> Gaussian {
    Gaussian { mean, scale, rotation, color: [1.2, -0.3, 0.6, 0.0] }
}

/// f32 pictures against the f64 definition over scales, aspects, places and numbers.
pub fn rendering() -> Vec<Row> {
    let blends = [Blend::Normalized, Blend::Sum];
    let mut rows = Vec::new();
    let mut add = |case: String, guard: &str, pictures: Vec<Picture>| {
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

/// A picture to fit.
pub struct Fit {
    pub name: String,
    pub pixels: Pixels,
    pub target: Target,
    pub effort: u8,
}

/// The pictures of the table.
pub fn fits() -> Vec<Fit> {
    use Channels::{Grey, GreyAlpha, Rgb, Rgba};
    const SIDE: u32 = 48;
    let grey = |f: &dyn Fn(u32, u32) -> f64| scenes::picture(SIDE, SIDE, Grey, |x, y, _| f(x, y));
    let mut list: Vec<(String, Pixels, Target)> = Vec::new();
    let mut add = |name: &str, pixels| list.push((name.into(), pixels, Target::Primitives(60)));
    add("constant", scenes::picture(SIDE, SIDE, Rgb, |_, _, k| [0.3, 0.6, 0.1][k]));
    add("black", grey(&|_, _| 0.0));
    add("white", grey(&|_, _| 1.0));
    add("single bright pixel", grey(&|x, y| f64::from(x == 20 && y == 31)));
    add("checkerboard of single pixels", grey(&|x, y| f64::from((x + y) % 2)));
    for (name, angle) in [
        ("0°", 0.0),
        ("1°", 0.0175),
        ("27°", 0.47),
        ("45°", std::f64::consts::FRAC_PI_4),
        ("90°", std::f64::consts::FRAC_PI_2),
    ] {
        add(&format!("line of one pixel at {name}"), grey(&|x, y| scenes::line(SIDE, 0.5, angle, x, y)));
    }
    add("step edge", grey(&|x, _| f64::from(x >= SIDE / 2)));
    add("zone plate", grey(&|x, y| scenes::zone_plate(SIDE, x, y)));
    add("white noise", scenes::picture(SIDE, SIDE, Rgb, scenes::noise));
    add("ramp", grey(&|x, _| f64::from(x) / 47.0));
    add(
        "saturated colours",
        scenes::picture(SIDE, SIDE, Rgb, |x, y, k| f64::from((x / 12 + y / 12) as usize % 3 == k)),
    );
    add(
        "transparent everywhere",
        scenes::picture(SIDE, SIDE, Rgba, |x, y, k| if k == 3 { 0.0 } else { scenes::noise(x, y, k) }),
    );
    add(
        "alpha with a hard edge",
        scenes::picture(SIDE, SIDE, GreyAlpha, |x, y, k| if k == 1 { f64::from(y > x) } else { 0.8 }),
    );
    add("1 × 1", scenes::picture(1, 1, Rgb, |_, _, k| [0.9, 0.2, 0.4][k]));
    add("2 × 1", scenes::picture(2, 1, Grey, |x, _, _| f64::from(x)));
    add("1 × 65535", scenes::picture(1, 65535, Grey, |_, y, _| 0.5 + 0.5 * (f64::from(y) / 900.0).sin()));
    add("65535 × 1", scenes::picture(65535, 1, Grey, |x, _, _| 0.5 + 0.5 * (f64::from(x) / 900.0).sin()));
    add(
        "primes 53 × 31",
        scenes::picture(53, 31, Rgb, |x, y, k| 0.5 + 0.5 * (f64::from(x * (k as u32 + 1) + y) / 7.0).sin()),
    );
    let wave =
        || scenes::picture(96, 96, Rgb, |x, y, k| 0.5 + 0.4 * (f64::from(x * (k as u32 + 1) + 2 * y) / 9.0).sin());
    for ratio in [2.0, 10.0, 100.0, 1000.0] {
        // As many primitives as a ratio of 2 asks for take their time even on a stamp.
        let pixels = if ratio < 5.0 { scenes::picture(40, 40, Rgb, scenes::noise) } else { wave() };
        list.push((format!("ratio {ratio}"), pixels, Target::Ratio(ratio)));
    }
    // A ramp there and back: a file of a few dozen bytes for millions of samples.
    let wide = |side: u32| {
        scenes::picture(side, side, Rgb, |x, y, _| f64::from((x + y).min(2 * side - x - y)) / f64::from(side))
    };
    for (side, ratio, name) in [(500, 1e4, "1e4"), (1300, 1e5, "1e5"), (3400, 1e6, "1e6"), (1300, 1e6, "1e6")] {
        list.push((format!("ratio {name}, {side} × {side}"), wide(side), Target::Ratio(ratio)));
    }
    list.push(("N = 0".into(), wave(), Target::Primitives(0)));
    list.push(("N = 1".into(), wave(), Target::Primitives(1)));
    list.push(("N = 2".into(), wave(), Target::Primitives(2)));
    list.push(("N beyond the pixels".into(), grey(&|x, y| scenes::noise(x, y, 5)), Target::Primitives(4000)));
    let effort = |pixels: &Pixels| match pixels.width().max(pixels.height()) {
        ..3000 => 2,
        _ => 1,
    };
    list.into_iter().map(|(name, pixels, target)| Fit { effort: effort(&pixels), name, pixels, target }).collect()
}

/// Fits, writes, reads and draws one picture, and compares with the picture of its mean colour.
///
/// # Errors
/// What the encoder or the decoder says; a size that cannot hold any picture is one of them.
pub fn fit(case: &Fit) -> Result<Row, Error> {
    let mut options = EncodeOptions::default();
    options.target = case.target;
    options.effort = case.effort;
    let guard = "log-scales, bounded aspect, ε; best state kept";
    let row = |worst| Row {
        group: "fit".into(),
        case: case.name.clone(),
        worst,
        bound: Bound::Gain(-0.01),
        guard: guard.into(),
    };
    let encoded = match encode(&case.pixels, &options) {
        // A size that holds not even a header is refused, and says so.
        Err(Error::Parameter { name: "bytes", .. }) => {
            return Ok(Row { guard: "refused with a typed error: too few bytes for any picture".into(), ..row(0.0) });
        }
        encoded => encoded?,
    };
    let splats = ssplat::bitstream::read(&encoded.bytes[..], &Limits::default())?;
    let picture = splats.to_picture();
    let finite = picture.gaussians.iter().all(|g| {
        let all = g.mean.iter().chain(&g.scale).chain(&g.color).chain([&g.rotation]);
        all.copied().all(f32::is_finite)
    });
    let renderer = Renderer::new(&picture, &View::full(&picture), &Limits::default())?;
    let drawn = renderer.render(splats.depth)?;
    let reached = metrics::psnr(&premultiplied(&case.pixels), &premultiplied(&drawn))?;
    let constant = metrics::psnr(&premultiplied(&case.pixels), &premultiplied(&mean(&case.pixels)))?;
    let limited = |v: f64| v.min(99.0);
    let most = match case.target {
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

/// Colours times alpha, so that the colour of what nobody sees does not count.
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

/// The picture of the mean colour; colours of transparent pixels do not count.
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
    scenes::picture(pixels.width(), pixels.height(), pixels.channels(), |_, _, k| value(k))
}

/// Every row, those of the fits last.
pub fn all() -> Vec<Row> {
    let failed = |case: &Fit| Row {
        group: "fit".into(),
        case: case.name.clone(),
        worst: f64::NAN,
        bound: Bound::Gain(-0.01),
        guard: "none: the encoder failed".into(),
    };
    let mut rows = rendering();
    rows.extend(fits().iter().map(|case| fit(case).unwrap_or_else(|_| failed(case))));
    rows
}
