//! One method at work on one picture: its floats, and its file.

use crate::recipes::{self, Counted, Method};
use ssplat::unstable::{Ablation, Needs, Outside, PackOptions, Precision, Recipe, Trace, metrics};
use ssplat::unstable::{DecodeOptions, EncodeOptions};
use ssplat::{Pixels, Result, Target};

/// Method that is measured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Contender {
    /// This crate's own fit.
    Ssplat,
    /// SmartSplat's, with this crate's rounding and coder.
    SmartSplat,
    /// A published method with its step sizes times a factor.
    Published { method: Method, rate: f32 },
}

/// Settings shared by all contenders.
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

/// Result of a contender; `None` where there is no such number.
#[derive(Debug, Clone, Default)]
pub struct Measured {
    /// PSNR of the floats before rounding to code values, dB.
    pub float_psnr: Option<f64>,
    /// MS-SSIM of the picture that the method itself draws of its floats; the encoder of ours and SmartSplat keeps no such picture.
    pub ms_ssim: Option<f64>,
    /// Seconds of the fit.
    pub seconds: f64,
    /// Iterations that were run of a published method, which may end before those that were asked for.
    pub iterations: Option<u32>,
    /// PSNR of the decoded file of the asked size, dB; where there is no file, of the estimate of that size.
    pub file_psnr: Option<f64>,
    /// MS-SSIM of the decoded file.
    pub file_ms_ssim: Option<f64>,
    /// Bytes of that file.
    pub bytes: Option<u64>,
    /// Bytes of the same Gaussians by the method's own count, and PSNR of the picture of the numbers as it rounds them.
    pub counted: Option<Counted>,
    /// Reason why something is missing.
    pub problem: Option<String>,
    /// PSNR of the fit along its seconds.
    pub trace: Vec<(f64, f64)>,
}

impl Measured {
    /// Looks at the file that came of it.
    fn filed(&mut self, pixels: &Pixels, file: &[u8]) -> Result<()> {
        let found = metrics::compare(pixels, &ssplat::unstable::decode(file, &DecodeOptions::default())?.pixels)?;
        (self.bytes, self.file_psnr, self.file_ms_ssim) = (Some(file.len() as u64), Some(found.psnr), found.ms_ssim);
        Ok(())
    }
}

impl Contender {
    /// Whether its sizes are estimates: no file holds its blend.
    pub fn is_estimated(self) -> bool {
        self.published_as().is_some_and(Method::is_estimated)
    }

    /// The method's name alone.
    pub fn method(self) -> &'static str {
        match self {
            Contender::Ssplat => "ssplat",
            Contender::SmartSplat => "smartsplat",
            Contender::Published { method, .. } => method.name(),
        }
    }

    /// The published method, if it is one.
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

    /// Fits and writes; a failure is a result too.
    pub fn measure(self, pixels: &Pixels, setup: &Setup) -> Measured {
        let mut measured = Measured::default();
        let done = match self {
            Contender::Ssplat => own(pixels, setup, Recipe::Ssplat, &mut measured),
            Contender::SmartSplat => own(pixels, setup, Recipe::SmartSplat(Ablation::Colors), &mut measured),
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

/// By the encoder: once with the number of Gaussians, once with the size of the file.
fn own(pixels: &Pixels, setup: &Setup, recipe: Recipe, measured: &mut Measured) -> Result<()> {
    let mut options = EncodeOptions::default();
    (options.effort, options.seed, options.recipe) = (setup.effort, setup.seed, recipe);
    (options.needs, options.trace) = (Needs::Everything, Trace::On);
    options.target = Target::Primitives(setup.count);
    let encoded = ssplat::unstable::encode(pixels, &options)?;
    measured.float_psnr = Some(encoded.report.float_psnr);
    measured.seconds = encoded.report.stages.iter().filter(|s| s.name == "fit").map(|s| s.seconds).sum();
    let fitted = encoded.report.trace.iter().filter(|p| p.stage == "fit");
    measured.trace = fitted.map(|p| (p.seconds, p.psnr)).collect();
    options.target = Target::Bytes(setup.bytes);
    options.trace = Trace::Off;
    let encoded = ssplat::unstable::encode(pixels, &options)?;
    measured.filed(pixels, &encoded.bytes)
}

/// By the method, and by import of what it found.
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
    let mut options = PackOptions::default();
    // Pixel centres are at whole numbers there: the last column is half a pixel outside.
    (options.precision, options.outside) = (Precision::Bytes(setup.bytes), Outside::Crop);
    measured.filed(pixels, &ssplat::unstable::bitstream::to_bytes(&ssplat::unstable::pack(&fit.picture, &options)?)?)
}
