//! `ssplat compare`: PSNR, SSIM, MS-SSIM, SSIMULACRA2 and Butteraugli between two pictures of any format.

use serde_json::{Value, json};
use ssplat::unstable::{colour, metrics};
use ssplat::{Channels, Depth, Pixels, Samples};

use crate::args;
use crate::failure::Failure;
use crate::perceived::{self, Perceived};
use crate::sink::{say, tell};
use crate::source::{self, Source, Turn};

/// PSNR in dB that is reported for equal samples, whose PSNR is infinite.
pub const IDENTICAL: f64 = 99.0;

pub fn run(args: &args::Compare) -> Result<(), Failure> {
    let open = |path| -> Result<Source, Failure> {
        let source = source::open(path, Turn::Keep)?;
        if source.is_cut_off {
            tell(&format!("{}: the file is cut off", Failure::input(path)));
        }
        Ok(source)
    };
    let (mut reference, mut test) = (open(&args.reference)?, open(&args.test)?);
    let both = format!("{} and {}", Failure::input(&args.reference), Failure::input(&args.test));
    if reference.orientation != test.orientation {
        tell(&format!("{both}: their orientations differ; the pictures are compared upright"));
        (reference, test) = (reference.upright(&args.reference)?, test.upright(&args.test)?);
    }
    if reference.cicp != test.cicp {
        let name = |source: &Source| source.cicp.map_or("none".into(), |cicp| cicp.to_string());
        let (a, b) = (name(&reference), name(&test));
        tell(&format!(
            "{both}: the code points of their colours differ ({a}; {b}); the samples are compared as stored"
        ));
    }
    let profile = |source: &Source| source.icc.clone().filter(|icc| !colour::is_srgb(icc));
    if profile(&reference) != profile(&test) {
        tell(&format!("{both}: their ICC profiles differ; the samples are compared as they are stored"));
    }
    let (reference, test) = (reference.pixels, test.pixels);
    let found = measure(&reference, &test)
        .map_err(|e| Failure::usage(format!("{} and {}: {e}", args.reference.display(), args.test.display())))?;
    say(&if args.json { format!("{}\n", as_json(&found)) } else { format!("{}\n", as_text(&found)) })
}

/// Metrics of the difference between two pictures.
#[derive(Debug, Clone, Copy)]
pub struct Found {
    /// In dB; infinite if all samples are equal.
    pub psnr: f64,
    pub ssim: Option<f64>,
    pub ms_ssim: Option<f64>,
    pub perceived: Perceived,
}

/// Compares two pictures of the same size; channels and depths may differ.
pub fn measure(reference: &Pixels, test: &Pixels) -> ssplat::Result<Found> {
    let alike = |a: &Pixels, b: &Pixels| -> ssplat::Result<Found> {
        let found = metrics::compare(a, b)?;
        let perceived = perceived::measure(a, b);
        Ok(Found { psnr: found.psnr, ssim: found.ssim, ms_ssim: found.ms_ssim, perceived })
    };
    if reference.channels() == test.channels() && reference.depth() == test.depth() {
        return alike(reference, test);
    }
    let channels = join(reference.channels(), test.channels());
    let depth = if reference.depth() == test.depth() { reference.depth() } else { Depth::Sixteen };
    alike(&converted(reference, channels, depth)?, &converted(test, channels, depth)?)
}

/// Returns the smallest set of channels that includes both.
fn join(a: Channels, b: Channels) -> Channels {
    let color = a.count().max(b.count()) >= 3;
    let alpha = a.alpha().or(b.alpha()).is_some();
    match (color, alpha) {
        (false, false) => Channels::Grey,
        (false, true) => Channels::GreyAlpha,
        (true, false) => Channels::Rgb,
        (true, true) => Channels::Rgba,
    }
}

/// Converts a picture to more channels or bits: grey becomes equal red, green and blue, and missing alpha becomes
/// opaque.
fn converted(p: &Pixels, channels: Channels, depth: Depth) -> ssplat::Result<Pixels> {
    let samples = match (p.samples(), depth) {
        (Samples::U8(v), Depth::Eight) => Samples::U8(spread(v, p.channels(), channels, 255)),
        (Samples::U8(v), Depth::Sixteen) => {
            let wide: Vec<u16> = v.iter().map(|&v| u16::from(v) * 257).collect();
            Samples::U16(spread(&wide, p.channels(), channels, 65535))
        }
        (Samples::U16(v), _) => Samples::U16(spread(v, p.channels(), channels, 65535)),
    };
    Pixels::new(p.width(), p.height(), channels, samples)
}

/// Converts samples of the channels `from` to the channels `to`, which include them.
fn spread<T: Copy>(samples: &[T], from: Channels, to: Channels, opaque: T) -> Vec<T> {
    let colors = to.count() - usize::from(to.alpha().is_some());
    let source = |pixel: &[T], k: usize| match from.alpha() {
        _ if k < colors => pixel[if from.count() < 3 { 0 } else { k }],
        Some(a) => pixel[a],
        None => opaque,
    };
    samples.chunks_exact(from.count()).flat_map(|pixel| (0..to.count()).map(move |k| source(pixel, k))).collect()
}

/// Returns the metrics under the keys `psnr`, `ssim`, `ms_ssim`, `ssimulacra2`, `butteraugli`.
pub fn as_json(found: &Found) -> Value {
    let Perceived { ssimulacra2, butteraugli } = found.perceived;
    json!({
        "psnr": found.psnr.min(IDENTICAL), "ssim": found.ssim, "ms_ssim": found.ms_ssim,
        "ssimulacra2": ssimulacra2, "butteraugli": butteraugli,
    })
}

/// Returns the metrics in one line.
pub fn as_text(found: &Found) -> String {
    let psnr = if found.psnr.is_finite() { format!("{:.2} dB", found.psnr) } else { "identical samples".into() };
    let of = |v: Option<f64>, digits: usize| v.map_or_else(|| "-".into(), |v| format!("{v:.digits$}"));
    let Perceived { ssimulacra2, butteraugli } = found.perceived;
    format!(
        "PSNR {psnr}, SSIM {}, MS-SSIM {}, SSIMULACRA2 {}, Butteraugli {}",
        of(found.ssim, 4),
        of(found.ms_ssim, 4),
        of(ssimulacra2, 2),
        of(butteraugli, 3)
    )
}
