//! The `ssplat` program: encode, decode, info, compare; with the feature `report` also report.

mod args;
mod compare;
mod decode;
mod encode;
mod failure;
mod info;
mod left_out;
mod names;
mod progress;
#[cfg(feature = "report")]
mod report;
mod rows;
mod sink;
mod source;

use std::process::ExitCode;

use clap::Parser;

use args::{Args, Command};
use failure::Failure;

fn main() -> ExitCode {
    let args = Args::parse();
    match run(args) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            eprintln!("ssplat: {}", failure.message);
            ExitCode::from(failure.kind.code())
        }
    }
}

fn run(args: Args) -> Result<(), Failure> {
    sink::remove_on_interrupt()?;
    if let Some(threads) = args.threads {
        rayon::ThreadPoolBuilder::new()
            .num_threads(threads.get())
            .build_global()
            .map_err(|e| Failure::usage(format!("--threads {threads}: {e}")))?;
    }
    match args.command {
        Command::Encode(args) => encode::run(&args),
        Command::Decode(args) => decode::run(&args),
        Command::Info(args) => info::run(&args),
        Command::Compare(args) => compare::run(&args),
        #[cfg(feature = "report")]
        Command::Report(args) => report::run(&args),
    }
}
