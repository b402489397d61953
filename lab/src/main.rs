//! Measures the codec: a report that encodes pictures in many ways, and a comparison with other published methods. A
//! tool for developers.

mod bench_methods;
mod loss;
mod recipes;
mod report;
mod smartsplat;
mod trace;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// Measures ssplat.
#[derive(Debug, Parser)]
#[command(name = "lab", max_term_width = 100)]
struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Encode pictures in many ways and write the results to one HTML page
    Report(report::args::Report),
    /// Fit pictures by other published methods and compare them with ssplat
    BenchMethods(bench_methods::args::BenchMethods),
}

fn main() -> ExitCode {
    let done = ssplat_cli::sink::remove_on_interrupt().and_then(|()| match Args::parse().command {
        Command::Report(args) => report::run(&args),
        Command::BenchMethods(args) => bench_methods::run(&args),
    });
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            eprintln!("lab: {}", failure.message);
            ExitCode::from(failure.kind.code())
        }
    }
}
