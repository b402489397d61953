//! The memory of an encode in tiles depends on the size of a tile, not on that of the picture.
//!
//! This test has a file of its own, because the peak that the system reports is that of all child processes.

#![cfg(target_os = "linux")]

use std::io::{BufWriter, Write};

use nix::sys::resource::{UsageWho, getrusage};

const WIDTH: u32 = 8192;
const HEIGHT: u32 = 1024;
/// Largest resident memory in bytes; 50 MB were measured. It is two thirds of the memory of the picture's planes, which
/// a fit of the whole needs in addition to as much for gradients. A detail layer takes 20 to 40 MB more, which is not
/// tested here.
const MOST: i64 = 64 << 20;

#[test]
#[ignore = "takes minutes; .ci/slow runs it"]
fn tiles_bound_the_memory_of_an_encode() {
    let planes = i64::from(WIDTH) * i64::from(HEIGHT) * 3 * 4;
    assert!(3 * MOST <= 2 * planes, "{planes}");
    let folder = tempfile::tempdir().unwrap();
    let [input, output] = ["wide.ppm", "wide.ssplat"].map(|name| folder.path().join(name));
    let mut file = BufWriter::new(std::fs::File::create(&input).unwrap());
    write!(file, "P6\n{WIDTH} {HEIGHT}\n255\n").unwrap();
    for y in 0..HEIGHT {
        for x in 0..WIDTH {
            let (u, v) = (x as f32, y as f32);
            let waves = 50.0 * (u / 37.0 + v / 91.0).sin() + 40.0 * (u / 91.0 - v / 23.0).sin();
            file.write_all(&[0.0, 9.0, 18.0].map(|k| (110.0 + k + waves) as u8)).unwrap();
        }
    }
    file.into_inner().unwrap();
    let arguments =
        ["--detail", "off", "--tiles=256", "--ratio", "500", "--effort", "1", "--backend", "cpu", "--quiet"];
    // Each thread has its own memory, so the number of threads is fixed.
    let run = std::process::Command::new(env!("CARGO_BIN_EXE_ssplat"))
        .args(["encode", "--threads", "2"])
        .args([&input, &output])
        .args(arguments)
        .output()
        .unwrap();
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    // In KiB on Linux.
    let peak = 1024 * getrusage(UsageWho::RUSAGE_CHILDREN).unwrap().max_rss();
    assert!(peak > 1 << 20 && peak < MOST, "{peak} bytes at the peak, {MOST} allowed");
}
