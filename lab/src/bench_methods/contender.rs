//! One method on one picture: its float result and its file.

use crate::recipes::{self, Counted, Method};
use crate::smartsplat::Ablation;
use crate::trace::traced;
use ssplat::unstable::{DecodeOptions, EncodeOptions};
use ssplat::unstable::{Needs, Outside, Recipe, metrics};
use ssplat::{Encoder, Pixels, Result, Target};

/// Method that is measured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Contender {
    /// This crate's own fit.
    Ssplat,
    /// SmartSplat's, with this crate's rounding and coder.
    SmartSplat,
    /// A published method, with its step sizes multiplied by a factor.
    Published { method: Method, rate: f32 },
}

/// Settings shared by all methods.
#[derive(Debug, Clone, Copy)]
pub struct Setup {
    pub count: u32,
    /// Size of the file.
    pub bytes: u64,
    pub seed: u64,
    /// Iterations of a published method.
    pub iterations: u32,
    pub effort: u8,
}

/// Result of a method; `None` for values that do not exist.
#[derive(Debug, Clone, Default)]
pub struct Measured {
    /// PSNR of the floats before rounding to code values, dB.
    pub float_psnr: Option<f64>,
    /// MS-SSIM of the picture as the method itself renders it; not available for ssplat and SmartSplat.
    pub ms_ssim: Option<f64>,
    /// Seconds of the fit.
    pub seconds: f64,
    /// Number of iterations of a published method, which may stop before the requested number.
    pub iterations: Option<u32>,
    /// PSNR of the decoded file of the requested size, dB; for methods without a file, of the estimate of that size.
    pub file_psnr: Option<f64>,
    /// MS-SSIM of the decoded file.
    pub file_ms_ssim: Option<f64>,
    /// Bytes of that file.
    pub bytes: Option<u64>,
    /// Size of the same Gaussians by the method's own count, and PSNR of the picture after the method's own rounding.
    pub counted: Option<Counted>,
    /// Reason for missing values.
    pub problem: Option<String>,
    /// PSNR of the fit over its seconds.
    pub trace: Vec<(f64, f64)>,
}

impl Measured {
    /// Measures the resulting file.
    fn filed(&mut self, pixels: &Pixels, file: &[u8]) -> Result<()> {
        let found = metrics::compare(pixels, &ssplat::unstable::decode(file, &DecodeOptions::default())?.pixels)?;
        (self.bytes, self.file_psnr, self.file_ms_ssim) = (Some(file.len() as u64), Some(found.psnr), found.ms_ssim);
        Ok(())
    }
}

impl Contender {
    /// Tells whether the sizes are estimates, because no file supports the blend.
    pub fn is_estimated(self) -> bool {
        self.published_as().is_some_and(Method::is_estimated)
    }

    /// Returns the method's name alone.
    pub fn method(self) -> &'static str {
        match self {
            Contender::Ssplat => "ssplat",
            Contender::SmartSplat => "smartsplat",
            Contender::Published { method, .. } => method.name(),
        }
    }

    /// Returns the published method, if it is one.
    pub fn published_as(self) -> Option<Method> {
        match self {
            Contender::Published { method, .. } => Some(method),
            Contender::Ssplat | Contender::SmartSplat => None,
        }
    }

    pub fn name(self) -> String {
        match self {
            Contender::Published { rate, .. } if rate != 1.0 => format!("{}, rates × {rate}", self.method()),
            _ => self.method().into(),
        }
    }

    /// Fits and writes. A failure is a result, too.
    pub fn measure(self, pixels: &Pixels, setup: &Setup) -> Measured {
        let mut measured = Measured::default();
        let done = match self {
            Contender::Ssplat => own(pixels, setup, Recipe::Ssplat, &mut measured),
            Contender::SmartSplat => own(pixels, setup, Recipe::Other(&Ablation::Colors), &mut measured),
            Contender::Published { method, rate } => published(pixels, setup, method, rate, &mut measured),
        };
        if let Err(error) = done {
            measured.problem = Some(error.to_string());
        } else if !measured.float_psnr.is_some_and(f64::is_finite) {
            measured.problem = Some("diverged".into());
        }
        measured
    }
}

/// Measures the encoder: once with the number of Gaussians, once with the size of the file.
fn own(pixels: &Pixels, setup: &Setup, recipe: Recipe, measured: &mut Measured) -> Result<()> {
    let mut options = EncodeOptions::default();
    (options.effort, options.seed, options.recipe) = (setup.effort, setup.seed, recipe);
    options.needs = Needs::Everything;
    options.target = Target::Gaussians(setup.count);
    let (encoded, trace) = traced(&options, |options| ssplat::unstable::encode(pixels, options));
    let encoded = encoded?;
    measured.float_psnr = Some(encoded.report.float_psnr);
    measured.seconds = encoded.report.stages.iter().filter(|s| s.name == "fit").map(|s| s.seconds).sum();
    let fitted = trace.iter().filter(|p| p.stage == "fit");
    measured.trace = fitted.map(|p| (p.seconds, p.psnr)).collect();
    options.target = Target::Bytes(setup.bytes);
    let encoded = ssplat::unstable::encode(pixels, &options)?;
    measured.filed(pixels, &encoded.bytes)
}

/// Measures a published method, and the import of its result.
fn published(pixels: &Pixels, setup: &Setup, method: Method, rate: f32, measured: &mut Measured) -> Result<()> {
    let mut options = recipes::Options::new(setup.count as usize);
    (options.iterations, options.rate, options.seed) = (setup.iterations, rate, setup.seed);
    (options.trace, options.bytes, options.second_stage) = (30, Some(setup.bytes), setup.iterations);
    let fit = recipes::fit(pixels, method, &options)?;
    measured.float_psnr = Some(fit.psnr);
    measured.ms_ssim = metrics::compare(pixels, &fit.pixels)?.ms_ssim;
    (measured.seconds, measured.iterations) = (fit.seconds, Some(fit.iterations));
    measured.trace = fit.trace.iter().map(|p| (p.seconds, p.psnr)).collect();
    measured.counted = fit.counted;
    if method.is_estimated() {
        (measured.bytes, measured.file_psnr) = fit.estimate.map_or((None, None), |e| (Some(e.bytes), Some(e.psnr)));
        return Ok(());
    }
    let mut options = EncodeOptions::default();
    // Pixel centres are at integers there, so the last column is half a pixel outside.
    (options.target, options.outside) = (Target::Bytes(setup.bytes), Outside::Crop);
    measured.filed(pixels, &Encoder::from(options).encode_gaussians(&fit.picture)?.bytes)
}
