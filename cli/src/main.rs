//! The program `ssplat`.

use std::process::ExitCode;

fn main() -> ExitCode {
    ssplat_cli::main()
}
