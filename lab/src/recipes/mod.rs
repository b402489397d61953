//! Other methods that fit 2D Gaussians to pictures, for comparison.
//!
//! Each follows its published program: initialization, blend, loss, optimizer and growth, with the default constants
//! of the program. All share this crate's planes, gradients and measures, so that iterations and seconds can be
//! compared. The file of each method lists differences from the published program.
//!
//! ```
//! use crate::recipes::{self, Method, Options};
//! use ssplat::{Channels, Pixels, Samples};
//!
//! let ramp = (0..32 * 32).map(|i| (i % 32 * 8) as u8).collect();
//! let pixels = Pixels::new(32, 32, Channels::Grey, Samples::U8(ramp))?;
//! let mut options = Options::new(20);
//! options.iterations = 30;
//! let fit = recipes::fit(&pixels, Method::GaussianImageCholesky, &options)?;
//! assert_eq!(fit.picture.list.len(), 20);
//! # Ok::<(), ssplat::Error>(())
//! ```

mod blended;
mod categorical;
mod densify;
mod drawn;
mod estimate;
mod gaussian_image;
mod image_gs;
mod lig;
mod moments;
mod optimizer;
mod quantized;
mod splatting_3d;
mod tiles;
mod top_k;

use ssplat::Pixels;
use ssplat::unstable::fit::model::objective::planes::Planes;
use ssplat::unstable::gaussian::Gaussians;
use ssplat::{Error, Parameter, Result};

/// A published method.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Method {
    /// GaussianImage (Zhang et al., ECCV 2024) with covariances as Cholesky factors.
    GaussianImageCholesky,
    /// GaussianImage with covariances as rotation and scales.
    GaussianImageRs,
    /// Image-GS (Zhang et al., SIGGRAPH 2025).
    ImageGs,
    /// LIG (Zhu et al., AAAI 2025): a coarse level, and a second level for its residual.
    Lig,
    /// 3D Gaussian Splatting (Kerbl et al., SIGGRAPH 2023) in the plane: blended from front to back, with opacity.
    ///
    /// It grows to at most [`Options::count`] Gaussians, and prunes; the result may have fewer.
    Splatting3d,
    /// As `Splatting3d`, but with the final number of Gaussians from the start.
    Splatting3dFixed,
}

impl Method {
    /// All methods.
    pub const ALL: [Method; 6] = [
        Method::GaussianImageCholesky,
        Method::GaussianImageRs,
        Method::ImageGs,
        Method::Lig,
        Method::Splatting3d,
        Method::Splatting3dFixed,
    ];

    /// Tells whether the format does not support its blend, so that its size is an estimate.
    #[must_use]
    pub fn is_estimated(self) -> bool {
        matches!(self, Method::Splatting3d | Method::Splatting3dFixed)
    }

    /// Returns a short name.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Method::GaussianImageCholesky => "gaussianimage-cholesky",
            Method::GaussianImageRs => "gaussianimage-rs",
            Method::ImageGs => "image-gs",
            Method::Lig => "lig",
            Method::Splatting3d => "3dgs",
            Method::Splatting3dFixed => "3dgs-fixed",
        }
    }

    /// Returns the number of iterations that its program runs by default.
    #[must_use]
    pub fn published_iterations(self) -> u32 {
        match self {
            Method::GaussianImageCholesky | Method::GaussianImageRs => 50_000,
            Method::ImageGs => 10_000,
            Method::Lig | Method::Splatting3d | Method::Splatting3dFixed => 30_000,
        }
    }
}

/// Options of [`fit`].
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Options {
    /// Number of Gaussians at the end; with [`Method::Splatting3d`], the maximum.
    pub count: usize,
    /// Iterations. Events in a method's schedule happen after the same fraction of these iterations as of its own.
    pub iterations: u32,
    /// Factor of all step sizes; the published ones are chosen for the published number of iterations.
    pub rate: f32,
    /// Seed of the random numbers.
    pub seed: u64,
    /// Maximum number of points in the trace.
    pub trace: u32,
    /// Size of the estimate for blends that the format does not support; `None` for no estimate.
    pub bytes: Option<u64>,
    /// Iterations of GaussianImage's second stage, with quantizers in the loop; 0 to only round the numbers.
    pub second_stage: u32,
}

impl Options {
    /// Returns options for a thousand iterations at the published rates.
    #[must_use]
    pub fn new(count: usize) -> Self {
        Options { count, iterations: 1000, rate: 1.0, seed: 0, trace: 0, bytes: None, second_stage: 0 }
    }
}

/// Result of a fit.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Fit {
    /// The picture as the method itself renders it.
    pub pixels: Pixels,
    /// PSNR of that picture before rounding to code values, dB; NaN if the fit has diverged.
    pub psnr: f64,
    /// The Gaussians, with the blend of this crate that is closest to the method's.
    pub picture: Gaussians,
    /// Wall-clock seconds without the trace.
    pub seconds: f64,
    /// Iterations (of each level of [`Method::Lig`]); [`Method::ImageGs`] ends when it no longer improves.
    pub iterations: u32,
    /// PSNR during the fit.
    pub trace: Vec<Point>,
    /// Result of rounding and counting these Gaussians as the method's own program does, which writes no file; `None`
    /// if it does not count them.
    pub counted: Option<Counted>,
    /// Result of rounding these Gaussians to uniform grids, with the entropy of the codes as the size: at most
    /// [`Options::bytes`] for methods where [`Method::is_estimated`] holds.
    pub estimate: Option<Counted>,
}

/// A computed size, without a file, and the quality at that size.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Counted {
    /// Bytes.
    pub bytes: u64,
    /// Size in bytes if the program can also code its numbers, including its tables, with the coder of ssplat; `None`
    /// if it cannot.
    pub coded: Option<u64>,
    /// PSNR of the picture that the method renders from the rounded numbers, before rounding to code values, dB.
    pub psnr: f64,
}

/// A point of a trace.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Point {
    /// Iterations before it.
    pub iteration: u32,
    /// Seconds before it.
    pub seconds: f64,
    /// PSNR as in [`Fit::psnr`].
    pub psnr: f64,
}

/// Fits `pixels` by `method`.
///
/// # Errors
/// [`Error::Parameter`] if the picture has alpha, which none of the methods supports, or if there are no Gaussians or
/// more Gaussians than pixels.
pub fn fit(pixels: &Pixels, method: Method, options: &Options) -> Result<Fit> {
    if pixels.channels().alpha().is_some() {
        return Err(Error::Parameter {
            parameter: Parameter::Pixels,
            problem: format!("{:?} has alpha", pixels.channels()),
        });
    }
    let area = u64::from(pixels.width()) * u64::from(pixels.height());
    if options.count == 0 || options.count as u64 > area {
        let problem = format!("{} is not between 1 and the {area} pixels", options.count);
        return Err(Error::Parameter { parameter: Parameter::Other("count"), problem });
    }
    let target = Planes::new(pixels);
    Ok(match method {
        Method::GaussianImageCholesky => gaussian_image::fit(&target, gaussian_image::Covariance::Cholesky, options),
        Method::GaussianImageRs => gaussian_image::fit(&target, gaussian_image::Covariance::RotationScale, options),
        Method::ImageGs => image_gs::fit(&target, options),
        Method::Lig => lig::fit(&target, options),
        Method::Splatting3d => splatting_3d::fit(&target, splatting_3d::Number::Grows, options),
        Method::Splatting3dFixed => splatting_3d::fit(&target, splatting_3d::Number::Stays, options),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use ssplat::Samples;
    use ssplat::unstable::gaussian::Channels;

    /// A ramp with an edge.
    fn pixels(channels: Channels) -> Pixels {
        let count = channels.count() as u32;
        let value = |i: u32| {
            let (x, y) = (i / count % 40, i / count / 40);
            if x > 20 { 200 - y * 2 } else { 40 + x * 3 + 20 * (i % count) }
        };
        let samples = (0..40 * 32 * count).map(|i| value(i) as u8).collect();
        Pixels::new(40, 32, channels, Samples::U8(samples)).unwrap()
    }

    #[test]
    fn every_method_gets_better_and_depends_on_the_seed_alone() {
        for method in Method::ALL {
            let mut options = Options::new(60);
            (options.iterations, options.rate, options.trace) = (200, 10.0, 5);
            let pixels = pixels(Channels::Rgb);
            let fit = |options: &Options| super::fit(&pixels, method, options).unwrap();
            let first = fit(&options);
            let count = first.picture.list.len();
            let is_right = if method == Method::Splatting3d { (31..=60).contains(&count) } else { count == 60 };
            assert!(is_right, "{method:?}: {count}");
            let start = first.trace[0].psnr;
            assert!(first.psnr > start + 6.0, "{method:?}: {start} {}", first.psnr);
            assert_eq!(first.picture, fit(&options).picture, "{method:?}");
            options.seed = 1;
            assert_ne!(first.picture, fit(&options).picture, "{method:?}");
        }
    }

    #[test]
    fn fits_of_the_smallest_and_dullest_pictures_stay_finite() {
        let flat = |width, height, code| {
            Pixels::new(width, height, Channels::Rgb, Samples::U8(vec![code; (width * height * 3) as usize])).unwrap()
        };
        let ramp = pixels(Channels::Grey);
        for (pixels, count) in
            [(&flat(1, 1, 77), 1), (&flat(24, 16, 0), 30), (&flat(24, 16, 255), 1), (&flat(1, 40, 9), 7), (&ramp, 1)]
        {
            for method in Method::ALL {
                for rate in [1.0, 10.0] {
                    let mut options = Options::new(count);
                    (options.iterations, options.rate) = (40, rate);
                    let fit = fit(pixels, method, &options).unwrap();
                    let size = [pixels.width(), pixels.height()];
                    assert!(!fit.psnr.is_nan(), "{method:?} {size:?} × {rate}");
                    for g in &fit.picture.list {
                        let [values, scales] = [[g.mean, [g.rotation, g.color[0]]].concat(), g.scale.to_vec()];
                        assert!(values.iter().all(|v| v.is_finite()), "{method:?} {size:?} × {rate}: {g:?}");
                        assert!(
                            scales.iter().all(|s| *s > 0.0 && s.is_finite()),
                            "{method:?} {size:?} × {rate}: {g:?}"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn pictures_with_alpha_and_impossible_counts_are_refused() {
        let refused = |channels, count| fit(&pixels(channels), Method::ImageGs, &Options::new(count)).unwrap_err();
        assert!(refused(Channels::GreyAlpha, 10).to_string().contains("alpha"));
        assert!(refused(Channels::Grey, 0).to_string().contains("count"));
        assert!(refused(Channels::Grey, 40 * 32 + 1).to_string().contains("1281"));
    }

    /// Checks the counts against the papers' tables for 50 000 Gaussians on RGB, and for numbers of 16 and 32 bits.
    #[test]
    fn bytes_are_counted_as_the_programs_count_them() {
        assert_eq!(quantized::bytes(50_000, 3), 50_000 * 7 + 4 * (48 + 6));
        let counted = |method| {
            let mut options = Options::new(100);
            options.iterations = 4;
            fit(&pixels(Channels::Rgb), method, &options).unwrap().counted.map(|c| c.bytes)
        };
        assert_eq!(counted(Method::GaussianImageRs), Some(quantized::bytes(100, 3)));
        assert_eq!(counted(Method::ImageGs), Some(1600));
        assert_eq!(counted(Method::Lig), Some(3208));
        assert_eq!(counted(Method::Splatting3dFixed), None);
    }

    #[test]
    fn fitting_on_with_quantizers_wins_back_what_rounding_costs() {
        for method in [Method::GaussianImageCholesky, Method::GaussianImageRs] {
            let mut options = Options::new(120);
            (options.iterations, options.rate) = (300, 10.0);
            let fit = |options: &Options| super::fit(&pixels(Channels::Rgb), method, options).unwrap();
            let plain = fit(&options);
            options.second_stage = 300;
            let second = fit(&options);
            let [plain_psnr, second_psnr] = [&plain, &second].map(|f| f.counted.unwrap().psnr);
            assert!(plain_psnr < plain.psnr - 0.5, "{method:?}: {plain_psnr} {}", plain.psnr);
            assert!(second_psnr > plain_psnr + 1.0, "{method:?}: {plain_psnr} {second_psnr}");
            assert_eq!(plain.picture, second.picture, "{method:?}");
            // At most 24 bits of codes, and tables of 64 and 8 entries; less than 16 bits would be impossibly good.
            let coded = second.counted.and_then(|c| c.coded).unwrap();
            let fixed = 120 * 4 + quantized::bytes(0, 3);
            assert!((fixed + 120 * 2..fixed + 120 * 3 + 9 * 72 + 8).contains(&coded), "{method:?}: {coded}");
        }
    }

    #[test]
    fn an_estimate_is_within_its_bytes_and_near_the_floats() {
        let mut options = Options::new(60);
        (options.iterations, options.bytes) = (200, Some(60 * 9));
        let fit = fit(&pixels(Channels::Rgb), Method::Splatting3d, &options).unwrap();
        let estimate = fit.estimate.unwrap();
        assert!(estimate.bytes <= 540 && estimate.psnr > fit.psnr - 3.0, "{estimate:?} {}", fit.psnr);
    }
}
