//! Every instruction set gives the same bytes and the same pixels. Each runs in a process of its own.

use std::process::Command;

use crate::synthetic::{Levels, Random, Scene, scene, with_layer};
use ssplat::unstable::bitstream::splats::Layout;
use ssplat::unstable::bitstream::{DetailHead, to_bytes};
use ssplat::unstable::{DecodeOptions, EncodeOptions, decode, encode};
use ssplat::{Blend, Channels, Depth, Pixels, Samples, Target, Tune};

/// CRC-32 of a picture's samples.
fn checksum(pixels: &Pixels) -> u32 {
    match pixels.samples() {
        Samples::U8(v) => crc32fast::hash(v),
        Samples::U16(v) => crc32fast::hash(&v.iter().flat_map(|s| s.to_le_bytes()).collect::<Vec<u8>>()),
    }
}

/// Returns the results of one instruction set for pictures and files, one per line.
fn results() -> String {
    let mut lines = format!("instructions {}\n", ssplat::unstable::instruction_set());
    for channels in [Channels::Grey, Channels::GreyAlpha, Channels::Rgb, Channels::Rgba] {
        for (blend, depth) in [(Blend::Normalized, Depth::Eight), (Blend::Sum, Depth::Sixteen)] {
            let made = Scene { layout: Layout::Packed, channels, count: 3000, size: [300, 200], ..Scene::default() };
            let mut splats = scene(&made);
            (splats.blend, splats.depth) = (blend, depth);
            let bytes = to_bytes(&splats).unwrap();
            for size in [[300, 200], [700, 450], [140, 33], [11, 7]] {
                let mut options = DecodeOptions::default();
                options.size = Some(size);
                let drawn = checksum(&decode(&bytes, &options).unwrap().pixels);
                lines += &format!("drawn {channels:?} {blend:?} {size:?} {drawn:08x}\n");
            }
        }
    }
    let mut head = DetailHead::SEEN;
    head.step = 600;
    let layered = scene(&Scene { count: 300, size: [300, 200], ..Scene::default() });
    let layered = to_bytes(&with_layer(layered, head, Levels::new(71))).unwrap();
    for size in [[300, 200], [140, 33], [400, 250]] {
        let mut options = DecodeOptions::default();
        options.size = Some(size);
        let drawn = checksum(&decode(&layered, &options).unwrap().pixels);
        lines += &format!("drawn with a detail layer {size:?} {drawn:08x}\n");
    }
    let mut random = Random(5);
    let samples = (0..60 * 44 * 3u64).map(|i| (i / 3 % 60 * 3 + i / 180 * 2 + random.below(40)) as u8).collect();
    let pixels = Pixels::new(60, 44, Channels::Rgb, Samples::U8(samples)).unwrap();
    for tune in [Tune::Psnr, Tune::Iq] {
        let mut options = EncodeOptions::default();
        (options.target, options.effort, options.tune) = (Target::Bytes(500), 1, Some(tune));
        options.backend = ssplat::Backend::Cpu;
        lines += &format!("encoded {tune:?} {:08x}\n", crc32fast::hash(&encode(&pixels, &options).unwrap().bytes));
    }
    lines
}

/// Prints the results of the process that runs it; the test below starts such processes.
#[test]
#[ignore = "a part of the other test"]
fn print_results() {
    // The test harness may have started a line.
    println!("\n{}", results());
}

fn results_with(variable: Option<&str>) -> Vec<String> {
    let mut child = Command::new(std::env::current_exe().unwrap());
    child.args(["simd::print_results", "--exact", "--ignored", "--nocapture"]).env_remove("SSPLAT_SIMD");
    child.envs(variable.map(|value| ("SSPLAT_SIMD", value)));
    let output = child.output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout).unwrap();
    let kinds = ["instructions ", "drawn ", "encoded "];
    text.lines().filter(|l| kinds.iter().any(|kind| l.starts_with(kind))).map(str::to_owned).collect()
}

#[test]
fn plain_and_best_instructions_give_the_same_files_and_pixels() {
    let (plain, best) = (results_with(Some("plain")), results_with(None));
    assert_eq!(plain[0], "instructions plain");
    if best[0] == plain[0] {
        println!("this machine has nothing better than plain instructions");
    }
    assert_eq!(plain.len(), 1 + 4 * 2 * 4 + 3 + 2);
    assert_eq!(plain[1..], best[1..]);
}
