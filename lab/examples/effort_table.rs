//! Measures time and quality of each effort, for one or more builds of the program in turn.
//!
//! ```sh
//! cargo build --release
//! cargo run --release -p ssplat-lab --example effort_table -- KODAK --programs target/release/ssplat
//! cargo run --release -p ssplat-lab --example effort_table -- KODAK --programs before/ssplat,target/release/ssplat \
//!     --efforts 1,3,5 --ratios 50,200 --seeds 0,1 --only kodim05.png,kodim13.png
//! ```
//!
//! Every picture is encoded at every ratio and effort and with every seed, by one program after the other, on one
//! thread. The table has the means over pictures and seeds: CPU seconds of the whole program, system time separately
//! (because it depends on the load of the machine), and the quality of the decoded files.

mod folder;

use std::error::Error;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use clap::Parser;
use nix::sys::resource::{UsageWho, getrusage};
use nix::sys::time::TimeVal;
use ssplat::Pixels;
use ssplat::unstable::DecodeOptions;
use ssplat::unstable::metrics;

/// Measure the time and the quality of each effort
#[derive(Debug, Parser)]
struct Args {
    /// The folder of pictures
    folder: PathBuf,
    /// Builds of the program
    #[arg(long, value_delimiter = ',', required = true)]
    programs: Vec<PathBuf>,
    /// Efforts
    #[arg(long, value_delimiter = ',', default_value = "1,2,3,4,5,6")]
    efforts: Vec<u8>,
    /// Ratios of 8-bit sample bytes to file bytes
    #[arg(long, value_delimiter = ',', default_value = "50,200")]
    ratios: Vec<u32>,
    /// Seeds
    #[arg(long, value_delimiter = ',', default_value = "0")]
    seeds: Vec<u64>,
    /// Only these file names
    #[arg(long, value_delimiter = ',')]
    only: Vec<String>,
}

/// Sums over the files of one row.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    files: f64,
    user: f64,
    system: f64,
    bytes: f64,
    psnr: f64,
    /// NaN as soon as one picture is too small for the measure.
    ms_ssim: f64,
}

fn main() -> Result<(), Box<dyn Error>> {
    let args = Args::parse();
    let folder = tempfile::tempdir()?;
    let file = folder.path().join("picture.ssplat");
    println!("| ratio | effort | program | user s | system s | bytes | PSNR | MS-SSIM |");
    println!("|--:|--:|---|--:|--:|--:|--:|--:|");
    for &ratio in &args.ratios {
        for &effort in &args.efforts {
            let mut sums = vec![Sums::default(); args.programs.len()];
            for path in folder::pictures(&args.folder, &args.only)? {
                let pixels = Pixels::try_from(image::open(&path)?)?;
                for seed in &args.seeds {
                    for (program, sums) in args.programs.iter().zip(&mut sums) {
                        let options = [
                            ("--ratio", ratio.to_string()),
                            ("--effort", effort.to_string()),
                            ("--seed", seed.to_string()),
                            // The default of `--tune` differs between builds.
                            ("--tune", "psnr".to_owned()),
                        ];
                        let [user, system] = encode(program, [&path, &file], options.into_iter())?;
                        let bytes = fs::read(&file)?;
                        let decoded = ssplat::unstable::decode(&bytes, &DecodeOptions::default())?;
                        let found = metrics::compare(&pixels, &decoded.pixels)?;
                        sums.files += 1.0;
                        sums.user += user;
                        sums.system += system;
                        sums.bytes += bytes.len() as f64;
                        sums.psnr += found.psnr;
                        sums.ms_ssim += found.ms_ssim.unwrap_or(f64::NAN);
                    }
                }
            }
            for (program, s) in args.programs.iter().zip(sums) {
                println!(
                    "| {ratio} | {effort} | {} | {:.2} | {:.2} | {:.0} | {:.3} | {:.4} |",
                    program.display(),
                    s.user / s.files,
                    s.system / s.files,
                    s.bytes / s.files,
                    s.psnr / s.files,
                    s.ms_ssim / s.files,
                );
            }
        }
    }
    Ok(())
}

/// Returns the CPU seconds in user and in system mode that encoding takes on one thread.
fn encode(
    program: &Path,
    [from, to]: [&Path; 2],
    options: impl Iterator<Item = (&'static str, String)>,
) -> Result<[f64; 2], Box<dyn Error>> {
    let before = children()?;
    let mut command = Command::new(program);
    command.arg("encode").args([from, to]).args(["--threads", "1", "--backend", "cpu"]);
    for (name, value) in options {
        command.arg(name).arg(value);
    }
    let output = command.output()?;
    if !output.status.success() {
        return Err(format!("{}: {}", program.display(), String::from_utf8_lossy(&output.stderr)).into());
    }
    let after = children()?;
    Ok([after[0] - before[0], after[1] - before[1]])
}

/// Returns the CPU seconds in user and in system mode of all programs that have been run so far.
fn children() -> Result<[f64; 2], Box<dyn Error>> {
    let usage = getrusage(UsageWho::RUSAGE_CHILDREN)?;
    let seconds = |t: TimeVal| t.tv_sec() as f64 + t.tv_usec() as f64 * 1e-6;
    Ok([seconds(usage.user_time()), seconds(usage.system_time())])
}
