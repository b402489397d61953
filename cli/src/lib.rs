//! The program `ssplat`. The lab uses some modules to read pictures and write files; they are not a public API.

pub mod args;
#[cfg(feature = "avif")]
mod avif;
mod batch;
mod carried;
pub mod compare;
mod completeness;
mod decode;
mod drawing;
mod encode;
mod exchange;
mod exif_text;
mod export;
pub mod failure;
mod floats;
mod formats;
mod guard;
mod import;
mod info;
pub mod input;
mod inputs;
mod jpeg_end;
#[cfg(feature = "jxl")]
mod jxl;
mod kept_times;
mod left_out;
mod limits;
mod manual;
pub mod names;
pub mod perceived;
mod placeholder;
pub mod progress;
mod resize;
mod rows;
pub mod sink;
mod sniff;
pub mod source;
mod spool;
mod tiff;
mod view;
mod written;
#[cfg(feature = "avif")]
mod ycbcr;

use std::process::ExitCode;

use clap::Parser;

use args::{Args, Command};
use failure::Failure;

/// Runs the command line.
pub fn main() -> ExitCode {
    // On Windows, programs expand patterns such as `*.png`, not the shell.
    let args = Args::parse_from(wild::args_os());
    match run(args) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            sink::tell(&failure.message);
            ExitCode::from(failure.kind.code())
        }
    }
}

fn run(args: Args) -> Result<(), Failure> {
    sink::remove_on_interrupt()?;
    if let Some(asked) = args.threads {
        let threads = asked.get().min(most_threads());
        if threads < asked.get() {
            sink::tell(&format!("--threads {asked}: {threads} are used, because more would not be faster"));
        }
        rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build_global()
            .map_err(|e| Failure::usage(format!("--threads {threads}: {e}")))?;
    }
    match args.command {
        Command::Encode(args) => encode::run(&args),
        Command::Decode(args) => decode::run(&args),
        Command::Info(args) => info::run(&args),
        Command::Compare(args) => compare::run(&args),
        Command::Placeholder(args) => placeholder::run(&args),
        Command::View(args) => view::run(&args),
        Command::Export(args) => export::run(&args),
        Command::Import(args) => import::run(&args),
        Command::Completions(args) => manual::completions(&args),
        Command::Formats => formats::run(),
        Command::Man(args) => manual::man(&args),
    }
}

/// Returns the largest useful number of threads; more would only wait for each other and take memory.
fn most_threads() -> usize {
    8 * std::thread::available_parallelism().map_or(1, |n| n.get())
}
