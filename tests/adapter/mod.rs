//! Runs tests on any adapter, including software renderers. Without an adapter they are ignored, or fail with
//! `SSPLAT_REQUIRE_GPU=1`.

use libtest_mimic::{Arguments, Failed, Trial};
use ssplat::gpu::{Adapters, Device};
use ssplat::{Error, GpuError};

/// A test of a device.
pub type Test = fn(&Device);

/// Runs the tests that the command line selects, under names that begin with `gpu::`.
pub fn run(all: &[(&str, Test)]) -> ! {
    let arguments = Arguments::from_args();
    let required = std::env::var("SSPLAT_REQUIRE_GPU").is_ok_and(|v| v == "1");
    let opened = Device::open(Adapters::Any);
    match &opened {
        Ok(device) => eprintln!("adapter: {}; {}", device.name(), device.reason()),
        Err(e) => eprintln!("{e}: tests on the GPU are ignored"),
    }
    let missing = matches!(&opened, Err(Error::Gpu(GpuError::NoAdapter)));
    let trials = all
        .iter()
        .map(|&(name, test)| {
            let opened = opened.as_ref().map(Device::clone).map_err(ToString::to_string);
            let run = move || -> Result<(), Failed> {
                test(&opened?);
                Ok(())
            };
            Trial::test(format!("gpu::{name}"), run).with_ignored_flag(missing && !required)
        })
        .collect();
    libtest_mimic::run(&arguments, trials).exit()
}
