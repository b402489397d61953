//! The program on a GPU: the choice of the device, and the report about it.
//!
//! Any adapter works, including software ones. Without an adapter, these tests are ignored, or fail with
//! `SSPLAT_REQUIRE_GPU=1`.

#[path = "../../tests/adapter/mod.rs"]
mod adapter;

use std::process::{Command, Output};

use ssplat::gpu::Device;

fn main() {
    adapter::run(&[
        ("the_program_fits_and_draws_on_the_gpu", fits_and_draws),
        ("the_program_draws_the_detail_layer_on_the_gpu", draws_layers),
        ("auto_never_takes_software_and_says_why", auto),
        ("a_missing_adapter_is_said_and_auto_goes_on", without),
    ]);
}

fn ssplat(folder: &tempfile::TempDir, backends: &str, args: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_ssplat"));
    command.current_dir(folder.path()).args(args);
    // The environment variable of `wgpu` that selects backends.
    if !backends.is_empty() {
        command.env("WGPU_BACKEND", backends);
    }
    command.output().unwrap()
}

#[track_caller]
fn said(output: &Output) -> serde_json::Value {
    assert!(output.status.success(), "{output:?}");
    serde_json::from_slice(&output.stdout).unwrap()
}

/// Returns a folder with a picture of this size.
fn folder(width: u32, height: u32) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let picture = image::RgbImage::from_fn(width, height, |x, y| {
        image::Rgb([(x * 255 / width) as u8, (y * 255 / height) as u8, ((x / 8 + y / 8) % 2 * 90) as u8])
    });
    picture.save(folder.path().join("in.png")).unwrap();
    folder
}

const SMALL: [&str; 8] = ["encode", "in.png", "out.ssplat", "--gaussians", "60", "--effort", "2", "--json"];

fn fits_and_draws(device: &Device) {
    let folder = folder(64, 48);
    let encoded = said(&ssplat(&folder, "", &[&SMALL[..], &["--backend", "gpu"]].concat()));
    assert_eq!(encoded["device"], device.name());
    let mut drawn = Vec::new();
    for backend in ["cpu", "gpu"] {
        let args = ["decode", "out.ssplat", "out.png", "--width", "100", "--json", "--backend", backend];
        let decoded = said(&ssplat(&folder, "", &args));
        assert_eq!(decoded["device"], if backend == "gpu" { device.name() } else { "CPU" });
        drawn.push(image::open(folder.path().join("out.png")).unwrap().to_rgb8());
    }
    assert!(drawn[0].iter().zip(drawn[1].iter()).all(|(a, b)| a.abs_diff(*b) <= 1));
}

fn draws_layers(device: &Device) {
    let folder = tempfile::tempdir().unwrap();
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../spec/vectors/valid/detail-blocks-mixed/file.ssplat");
    std::fs::copy(file, folder.path().join("in.ssplat")).unwrap();
    for layers in ["both", "gaussians", "detail"] {
        let mut drawn = Vec::new();
        for backend in ["cpu", "gpu"] {
            let args = ["decode", "in.ssplat", "out.png", "--json", "--layers", layers, "--backend", backend];
            let output = ssplat(&folder, "", &args);
            assert_eq!(said(&output)["device"], if backend == "gpu" { device.name() } else { "CPU" });
            // No notes of the program; drivers may print warnings.
            assert!(!String::from_utf8_lossy(&output.stderr).contains("ssplat:"), "{output:?}");
            drawn.push(image::open(folder.path().join("out.png")).unwrap().to_rgb8());
            std::fs::remove_file(folder.path().join("out.png")).unwrap();
        }
        assert!(drawn[0].iter().zip(drawn[1].iter()).all(|(a, b)| a.abs_diff(*b) <= 1), "{layers}");
    }
}

fn auto(device: &Device) {
    // Enough pixels for auto to choose a GPU.
    let folder = folder(512, 512);
    let encoded = said(&ssplat(&folder, "", &SMALL));
    if device.is_software() {
        assert_eq!(encoded["device"], "CPU");
        let reason = encoded["device_reason"].as_str().unwrap();
        assert!(reason.starts_with("no hardware adapter found, only"), "{reason}");
        assert!(leaves_out(&encoded, &format!("the GPU: {reason}")), "{encoded}");
    } else {
        assert_eq!(encoded["device"], device.name());
        assert!(!leaves_out(&encoded, "the GPU"), "{encoded}");
    }
}

/// Whether the report lists something that starts with `what` as left out.
fn leaves_out(encoded: &serde_json::Value, what: &str) -> bool {
    encoded["left_out"].as_array().unwrap().iter().any(|l| l["what"].as_str().unwrap().starts_with(what))
}

fn without(_: &Device) {
    let folder = folder(512, 512);
    let none = if cfg!(windows) { "metal" } else { "dx12" };
    let encoded = said(&ssplat(&folder, none, &SMALL));
    assert_eq!([&encoded["device"], &encoded["device_reason"]], ["CPU", "no adapter found"]);
    assert!(leaves_out(&encoded, "the GPU: no adapter found"), "{encoded}");
    for args in
        [&[&SMALL[..], &["--backend", "gpu"]].concat()[..], &["decode", "out.ssplat", "o.png", "--backend", "gpu"]]
    {
        let refused = ssplat(&folder, none, args);
        let text = String::from_utf8_lossy(&refused.stderr).into_owned();
        assert!(!refused.status.success() && text.contains("no adapter found"), "{text}");
    }
    assert!(!folder.path().join("o.png").exists());
}
