//! Ablation study: from SmartSplat's pipeline to that of ssplat, one change at a time, in files of the same size.

use std::fmt::Write as _;
use std::fs::File;
use std::io::Write as _;
use std::time::Instant;

use ssplat::unstable::bitstream::splats::Layout;
use ssplat::unstable::{DecodeOptions, EncodeOptions};
use ssplat::unstable::{Needs, Recipe, Rung, metrics};
use ssplat::{Backend, Blend, Pixels, Result, Target, Tune};

use super::args::BenchMethods;
use super::{opened, page};
use crate::smartsplat::Ablation;
use ssplat_cli::failure::Failure;
use ssplat_cli::progress::Bar;
use ssplat_cli::sink::Sink;

/// A pipeline, and its change from the previous one.
struct Step {
    name: &'static str,
    recipe: Recipe,
    rung: Rung,
    layout: Layout,
    blend: Blend,
    tune: Tune,
}

/// Returns all steps, from the paper's pipeline to that of ssplat. The last two are not part of the sequence; each
/// changes one property of ssplat.
fn steps() -> Vec<Step> {
    let paper = Recipe::Other(&Ablation::Colors);
    let started = Recipe::StartOf(&Ablation::Colors);
    let step = |name, recipe, rung| Step {
        name,
        recipe,
        rung,
        layout: Layout::Coded,
        blend: Blend::Normalized,
        tune: Tune::Psnr,
    };
    vec![
        Step {
            layout: Layout::Packed,
            blend: Blend::Sum,
            ..step("SmartSplat, nearest integers in records of 7 bytes, zstd", paper, Rung::Fit)
        },
        Step { blend: Blend::Sum, ..step("entropy coder and its quantizer", paper, Rung::Fit) },
        Step {
            blend: Blend::Sum,
            ..step("descent over the integers: SmartSplat with this format", paper, Rung::Descent)
        },
        step("normalized blend", paper, Rung::Descent),
        step("squared error, steps in each Gaussian's own frame", started, Rung::Optimizer),
        step("sampled rows", started, Rung::Sampling),
        step("start by detail, along edges", Recipe::Ssplat, Rung::Sampling),
        step("relocation", Recipe::Ssplat, Rung::Relocation),
        step("price of size: ssplat, `--tune psnr`", Recipe::Ssplat, Rung::Price),
        Step { tune: Tune::Iq, ..step("ssplat, `--tune iq`", Recipe::Ssplat, Rung::Price) },
        Step { blend: Blend::Sum, ..step("ssplat, `--tune psnr --blend sum`", Recipe::Ssplat, Rung::Price) },
    ]
}

/// Number of rows of the sequence. The differences of later rows are relative to the last of these.
const LADDER: usize = 9;

/// Result of one encode.
#[derive(Debug, Clone)]
struct Outcome {
    bytes: u64,
    psnr: f64,
    ms_ssim: Option<f64>,
    primitives: usize,
    seconds: f64,
}

/// Results of each picture's seeds; `None` if one failed.
type OfPictures = Vec<Vec<Option<Outcome>>>;

impl Step {
    fn options(&self, (effort, seed): (u8, u64), bytes: u64) -> EncodeOptions {
        let mut options = EncodeOptions::default();
        (options.effort, options.seed, options.target) = (effort, seed, Target::Bytes(bytes));
        (options.recipe, options.rung, options.layout) = (self.recipe, self.rung, self.layout);
        (options.blend, options.tune) = (Some(self.blend), Some(self.tune));
        (options.backend, options.needs) = (Backend::Cpu, Needs::Everything);
        options
    }

    fn run(&self, pixels: &Pixels, options: &EncodeOptions) -> Result<Outcome> {
        let start = Instant::now();
        let encoded = ssplat::unstable::encode(pixels, options)?;
        let seconds = start.elapsed().as_secs_f64();
        let decoded = ssplat::unstable::decode(&encoded.bytes, &DecodeOptions::default())?.pixels;
        let found = metrics::compare(pixels, &decoded)?;
        let primitives = encoded.report.gaussians;
        Ok(Outcome { bytes: encoded.bytes.len() as u64, psnr: found.psnr, ms_ssim: found.ms_ssim, primitives, seconds })
    }
}

/// Runs all steps. Rows are written as they are measured, the page at the end.
pub fn run(args: &BenchMethods) -> std::result::Result<(), Failure> {
    let rows = args.out.join("ablation.csv");
    let mut file = File::create(&rows).map_err(|e| Failure::io(&rows, &e))?;
    let mut write = |line: String| writeln!(file, "{line}").map_err(|e| Failure::io(&rows, &e));
    write("picture,ratio,step,seed,bytes,gaussians,psnr,ms_ssim,seconds,problem".into())?;
    let (bar, steps) = (Bar::new(), steps());
    let all = args.images.len() * args.ratios.len() * args.seeds.len() * steps.len();
    let mut pictures = Vec::new();
    let mut found: Vec<Vec<OfPictures>> = vec![vec![Vec::new(); steps.len()]; args.ratios.len()];
    let mut done = 0;
    for path in &args.images {
        let name = path.file_stem().unwrap_or(path.as_os_str()).to_string_lossy().into_owned();
        let pixels = opened(path, args.side)?;
        pictures.push(format!("{name} {} × {}", pixels.width(), pixels.height()));
        let raw = f64::from(pixels.width()) * f64::from(pixels.height()) * pixels.channels().count() as f64;
        for (ratio, found) in args.ratios.iter().zip(&mut found) {
            for (step, found) in steps.iter().zip(found) {
                let mut of_seeds = Vec::new();
                for &seed in &args.seeds {
                    bar.show(done as f32 / all as f32, format!("{name} {ratio} {}", step.name));
                    done += 1;
                    let outcome = step.run(&pixels, &step.options((args.effort, seed), (raw / ratio) as u64));
                    let start = format!("{name},{ratio},{},{seed}", step.name.replace(',', ";"));
                    match &outcome {
                        Ok(o) => {
                            let ms_ssim = o.ms_ssim.map_or(String::new(), |v| format!("{v:.5}"));
                            let Outcome { bytes, primitives, psnr, seconds, .. } = o;
                            write(format!("{start},{bytes},{primitives},{psnr:.3},{ms_ssim},{seconds:.2},"))?;
                        }
                        Err(error) => write(format!("{start},,,,,,{}", error.to_string().replace(',', ";")))?,
                    }
                    of_seeds.push(outcome.ok());
                }
                found.push(of_seeds);
            }
        }
    }
    let page = markdown(args, &pictures, &steps, &found);
    Sink::create(&args.out.join("ablation.md"), &[])?.finish_with(page.as_bytes())?;
    Ok(())
}

/// Returns the page: a table of means over pictures and seeds for each ratio.
fn markdown(args: &BenchMethods, pictures: &[String], steps: &[Step], found: &[Vec<OfPictures>]) -> String {
    let seeds: Vec<String> = args.seeds.iter().map(u64::to_string).collect();
    let mut out = format!(
        "# From SmartSplat's pipeline to that of ssplat\n\n```sh\n{}\n```\n\n",
        page::command(std::env::args())
    );
    let _ = writeln!(
        out,
        "Pictures: {}. Seeds {}. Effort {}.\n\
         \n\
         Every file has at most the number of bytes of its ratio, and as many Gaussians as the encoder finds best. Each row\n\
         adds the named change to the rows above it; each of the last two rows changes one thing in ssplat. PSNR is the mean\n\
         over pictures and seeds, ± half the spread of the seeds for the picture where it is largest. All rows use the same\n\
         number of iterations and the format's kernel, which ends at 3.33 scales. `ablation.csv` lists every file.",
        pictures.join(", "),
        seeds.join(", "),
        args.effort,
    );
    for (ratio, found) in args.ratios.iter().zip(found) {
        let _ = writeln!(out, "\n## Ratio {ratio}\n");
        out.push_str(
            "| | PSNR, dB | gain, dB | MS-SSIM | Gaussians | seconds | failures |\n|---|--:|--:|--:|--:|--:|---|\n",
        );
        let mut before = None;
        for (i, (step, of_pictures)) in steps.iter().zip(found).enumerate() {
            let all: Vec<&Outcome> = of_pictures.iter().flatten().flatten().collect();
            let missing = of_pictures.iter().flatten().filter(|o| o.is_none()).count();
            let mean = |of: &dyn Fn(&Outcome) -> f64| all.iter().map(|o| of(o)).sum::<f64>() / all.len() as f64;
            let psnr = mean(&|o| o.psnr);
            let psnrs = |seeds: &[Option<Outcome>]| seeds.iter().flatten().map(|o| o.psnr).collect::<Vec<_>>();
            let spread = of_pictures.iter().map(|seeds| page::half_spread(&psnrs(seeds))).fold(0.0, f64::max);
            let gain = before.map_or(String::from("–"), |before: f64| format!("{:+.2}", psnr - before));
            if i < LADDER {
                before = Some(psnr);
            }
            let ms_ssim = match all.iter().all(|o| o.ms_ssim.is_some()) {
                true => format!("{:.4}", mean(&|o| o.ms_ssim.unwrap_or(f64::NAN))),
                false => "–".into(),
            };
            let failures = if missing == 0 { "none".into() } else { format!("{missing} of {}", all.len() + missing) };
            let _ = writeln!(
                out,
                "| {} | {psnr:.2} ± {spread:.2} | {gain} | {ms_ssim} | {:.0} | {:.1} | {failures} |",
                step.name,
                mean(&|o| o.primitives as f64),
                mean(&|o| o.seconds),
            );
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use ssplat::{Channels, Samples};

    use super::*;

    #[test]
    fn every_step_fills_its_size_and_changes_the_file_and_known_pipelines_are_among_them() {
        let (width, height) = (160u32, 120u32);
        let value = |x: u32, y: u32, k: u32| {
            let wave = (x as f32 * 0.3).sin() * (y as f32 * 0.23 + k as f32).cos();
            (128.0 + 70.0 * wave + if (x / 16 + y / 12).is_multiple_of(2) { 30.0 } else { 0.0 }) as u8
        };
        let samples = (0..width * height * 3).map(|i| value(i / 3 % width, i / 3 / width, i % 3)).collect();
        let pixels = Pixels::new(width, height, Channels::Rgb, Samples::U8(samples)).unwrap();
        let steps = steps();
        let files: Vec<Vec<u8>> = steps
            .iter()
            .map(|step| ssplat::unstable::encode(&pixels, &step.options((1, 0), 1500)).unwrap().bytes)
            .collect();
        for (i, file) in files.iter().enumerate() {
            assert!((1400..=1500).contains(&file.len()), "{} {}", steps[i].name, file.len());
            assert!(!files[..i].contains(file), "{}", steps[i].name);
        }
        let mut plain = EncodeOptions::default();
        (plain.effort, plain.target, plain.needs) = (1, Target::Bytes(1500), Needs::Everything);
        (plain.tune, plain.backend) = (Some(Tune::Psnr), Backend::Cpu);
        let encoded = |options: &EncodeOptions| ssplat::unstable::encode(&pixels, options).unwrap().bytes;
        assert_eq!(encoded(&plain), files[LADDER - 1]);
        plain.recipe = Recipe::Other(&Ablation::Colors);
        assert_eq!(encoded(&plain), files[2]);
    }
}
