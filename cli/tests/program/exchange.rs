//! Guarantees of export and import: a round trip loses nothing, and invalid input is refused with a reason.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use ssplat::unstable::EncodeOptions;
use ssplat::unstable::bitstream::splats::{Layout, PackedSplats};
use ssplat::{Blend, Channels, Gaussian, Limits, Pixels, Samples, Target};

fn ssplat(args: &[&str], paths: [&Path; 2]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_ssplat")).arg(args[0]).args(paths).args(&args[1..]).output().unwrap()
}

#[track_caller]
fn succeeds(output: &Output) {
    assert!(output.status.success(), "{output:?}");
}

#[track_caller]
fn fails(output: &Output, status: i32, message: &str) {
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(status), "{said}");
    assert!(said.contains(message) && !said.contains("panicked"), "{said:?} does not contain {message:?}");
}

fn read(path: &Path) -> PackedSplats {
    ssplat::unstable::bitstream::read(&fs::read(path).unwrap()[..], &Limits::default()).unwrap()
}

/// Encodes a picture of a few ramps.
fn file(folder: &Path, channels: Channels, layout: Layout, blend: Blend) -> PathBuf {
    let count = channels.count() as u32;
    let samples = (0..48 * 32 * count).map(|i| (i * i / 7 % 251) as u8).collect();
    let pixels = Pixels::new(48, 32, channels, Samples::U8(samples)).unwrap();
    let mut options = EncodeOptions::default();
    (options.target, options.effort) = (Target::Gaussians(60), 1);
    (options.layout, options.blend) = (layout, Some(blend));
    let path = folder.join("fit.ssplat");
    fs::write(&path, ssplat::unstable::encode(&pixels, &options).unwrap().bytes).unwrap();
    path
}

#[test]
fn export_and_import_give_the_same_file() {
    let folder = tempfile::tempdir().unwrap();
    for (channels, layout, blend) in [
        (Channels::Rgb, Layout::Coded, Blend::Normalized),
        (Channels::Rgba, Layout::Planes, Blend::Sum),
        (Channels::Grey, Layout::Packed, Blend::Normalized),
        (Channels::GreyAlpha, Layout::Coded, Blend::Sum),
    ] {
        let fit = file(folder.path(), channels, layout, blend);
        for name in ["fit.npz", "fit.csv", "fit.ply"] {
            let (out, back) = (folder.path().join(name), folder.path().join("back.ssplat"));
            succeeds(&ssplat(&["export"], [&fit, &out]));
            succeeds(&ssplat(&["import"], [&out, &back]));
            assert_eq!(read(&back), read(&fit), "{name} {channels:?} {layout:?}");
            assert!(fs::read(&back).unwrap() == fs::read(&fit).unwrap(), "{name} {channels:?} {layout:?}: other bytes");
        }
    }
}

#[test]
fn import_fills_the_requested_size_and_uses_the_requested_precision() {
    let folder = tempfile::tempdir().unwrap();
    let fit = file(folder.path(), Channels::Rgb, Layout::Coded, Blend::Normalized);
    let (out, back) = (folder.path().join("fit.csv"), folder.path().join("back.ssplat"));
    succeeds(&ssplat(&["export"], [&fit, &out]));
    let length = |args: &[&str]| {
        succeeds(&ssplat(args, [&out, &back]));
        fs::metadata(&back).unwrap().len()
    };
    let lengths = ["0", "5", "9"].map(|level| length(&["import", "--precision", level]));
    assert!(lengths.is_sorted_by(|a, b| a < b), "{lengths:?}");
    assert!(length(&["import", "--bytes", &(lengths[1] + 1).to_string()]) <= lengths[1] + 1);
    fails(&ssplat(&["import", "--bytes", "50"], [&out, &back]), 2, "50 cannot hold");
}

#[test]
fn import_of_means_scales_and_colours_alone_stays_within_the_steps() {
    let folder = tempfile::tempdir().unwrap();
    let fit = read(&file(folder.path(), Channels::Rgb, Layout::Coded, Blend::Normalized)).to_gaussians();
    let (table, back) = (folder.path().join("fit.csv"), folder.path().join("back.ssplat"));
    let mut text = "x,y,scale_major,scale_minor,rotation,red,green,blue\n".to_owned();
    for g in &fit.list {
        let ([x, y], [a, b], [red, green, blue, _]) = (g.mean, g.scale, g.color);
        text += &format!("{x},{y},{a},{b},{},{red},{green},{blue}\n", g.rotation);
    }
    fs::write(&table, text).unwrap();
    let args = ["import", "--size", "48x32", "--blend", "normalized", "--precision", "9"];
    succeeds(&ssplat(&args, [&table, &back]));
    let found = read(&back);
    let quantizer = found.quantizer();
    let steps = quantizer.color_steps();
    assert_eq!(found.gaussians.len(), fit.list.len());
    // The file may reorder the Gaussians.
    let found: Vec<_> = found.gaussians.iter().map(|packed| quantizer.dequantize(packed)).collect();
    let distance = |a: &Gaussian, b: &Gaussian| {
        (a.mean[0] - b.mean[0]).hypot(a.mean[1] - b.mean[1]) + 10.0 * (a.color[0] - b.color[0]).abs()
    };
    for want in &fit.list {
        let g = found.iter().min_by(|a, b| distance(a, want).total_cmp(&distance(b, want))).unwrap();
        // Scales in steps of an eighth of an octave.
        assert!((0..2).all(|k| (g.scale[k] / want.scale[k]).log2().abs() <= 0.0625 + 1e-4), "{g:?} {want:?}");
        assert!((0..2).all(|k| (g.mean[k] - want.mean[k]).abs() < 0.1 * want.scale[0]), "{g:?} {want:?}");
        let most = 0.5 * steps[0] + 0.5 * steps[1] + 1e-5;
        assert!((0..3).all(|k| (g.color[k] - want.color[k]).abs() <= most), "{g:?} {want:?}");
    }
    fails(&ssplat(&args[..3], [&table, &back]), 2, "--blend");
    fails(&ssplat(&["import", "--blend", "sum"], [&table, &back]), 2, "--size");
}

#[test]
fn export_for_viewers_and_figures_has_every_gaussian() {
    let folder = tempfile::tempdir().unwrap();
    let fit = file(folder.path(), Channels::Rgb, Layout::Coded, Blend::Normalized);
    let count = read(&fit).gaussians.len();
    let (ply, svg) = (folder.path().join("a.ply"), folder.path().join("a.svg"));
    succeeds(&ssplat(&["export"], [&fit, &ply]));
    assert!(String::from_utf8_lossy(&fs::read(ply).unwrap()).contains(&format!("element vertex {count}\n")));
    succeeds(&ssplat(&["export"], [&fit, &svg]));
    assert_eq!(fs::read_to_string(svg).unwrap().matches("<ellipse").count(), count);
    fails(&ssplat(&["export"], [&fit, &folder.path().join("a.obj")]), 2, "npz, csv, ply or svg");
}

#[test]
fn import_refuses_broken_input_and_leaves_no_file() {
    let folder = tempfile::tempdir().unwrap();
    let (input, back) = (folder.path().join("fit.npz"), folder.path().join("back.ssplat"));
    let fit = file(folder.path(), Channels::Rgb, Layout::Coded, Blend::Normalized);
    succeeds(&ssplat(&["export"], [&fit, &input]));
    let good = fs::read(&input).unwrap();
    for end in [0, 3, good.len() / 2, good.len() - 1] {
        fs::write(&input, &good[..end]).unwrap();
        fails(&ssplat(&["import"], [&input, &back]), 4, ".npz");
    }
    let table = folder.path().join("fit.csv");
    let head = "# ssplat size=8x8;blend=sum\nx,y,scale_major,scale_minor,rotation,grey\n";
    for (text, message) in [
        (format!("{head}1,2,NaN,1,0,1\n"), "fit.csv: line 3: scale_major is 'NaN'"),
        (format!("{head}1,1e300,1,1,0,1\n"), "fit.csv: bad parameter mean: [1.0, inf] of Gaussian 0"),
        (format!("{head}1,2,1,-1,0,1\n"), "fit.csv: bad parameter scale: [1.0, -1.0] of Gaussian 0"),
        (head.replace("8x8", "0x8"), "fit.csv: size is 0x8"),
        ("\u{0}".into(), "fit.csv: the table has no columns x and y"),
    ] {
        fs::write(&table, text).unwrap();
        fails(&ssplat(&["import"], [&table, &back]), 4, message);
    }
    fs::write(&table, [0xff, 0xfe, 0]).unwrap();
    fails(&ssplat(&["import"], [&table, &back]), 4, "fit.csv: no text");
    assert!(!back.exists());
}

#[test]
fn import_checks_archives_against_the_limits_before_it_unpacks_them() {
    let folder = tempfile::tempdir().unwrap();
    let (input, back) = (folder.path().join("bomb.npz"), folder.path().join("back.ssplat"));
    for (kind, shape, status, message) in [
        ("<f8", "(300000000, 2)", 6, "bomb.npz: array means: rows 300000000 is more than the 16777216"),
        ("<f8", "(16777216, 100000)", 6, "bomb.npz: array means: bytes of memory 13421772800000"),
        ("<f4", "(2, 2)", 4, "bomb.npz: array means has data after its elements"),
        ("<f4", "(4100000, 2)", 4, "bomb.npz: array means of 8200000 elements: ends too early"),
        ("<f4", "(9999999, 2)", 6, "bomb.npz: array means: bytes of memory 159999984 is more than the 67108864"),
        ("<U999999999", "()", 6, "bomb.npz: array means: characters 999999999 is more than the 64"),
    ] {
        archive(&input, &[("means", kind, shape, &[0; 16 << 20])]);
        // 16 MB of zeros.
        assert!(fs::metadata(&input).unwrap().len() < 40_000);
        fails(&ssplat(&["import"], [&input, &back]), status, message);
    }
    let nan = [1.0, 2.0, 3.0, f32::NAN].map(f32::to_le_bytes).concat();
    let three = [0; 12];
    for (arrays, message) in [
        (&[("means", "<f4", "(2, 2)", &nan[..])][..], "array means, row 1: NaN is not finite"),
        (&[("means", "<f4", "(1, 3)", &three[..])], "array means has the shape [1, 3]"),
        (&[("means", "<f4", "(1, 2)", &three[..8])], "there is no array colors"),
        (
            &[("means", "<f4", "(1, 2)", &three[..8]), ("colors", "<f4", "(3, 1)", &three[..])],
            "there is no array covariances",
        ),
        (
            &[
                ("means", "<f4", "(1, 2)", &three[..8]),
                ("colors", "<f4", "(3, 1)", &three[..]),
                ("covariances", "<f4", "(1, 4)", &[0; 16][..]),
            ],
            "there are 1 means but 3 colors",
        ),
        (
            &[
                ("means", "<f4", "(1, 2)", &three[..8]),
                ("colors", "<f4", "(1, 3)", &three[..]),
                ("covariances", "<f4", "(1, 2, 2)", &[0; 16][..]),
            ],
            "array covariances, row 0: [0.0, 0.0, 0.0, 0.0] is not positive definite",
        ),
    ] {
        archive(&input, arrays);
        fails(&ssplat(&["import"], [&input, &back]), 4, &format!("bomb.npz: {message}"));
    }
    assert!(!back.exists());
}

/// Writes an archive of arrays, given by name, type, shape and data.
fn archive(path: &Path, arrays: &[(&str, &str, &str, &[u8])]) {
    let mut zip = zip::ZipWriter::new(fs::File::create(path).unwrap());
    for (name, descr, shape, data) in arrays {
        zip.start_file(format!("{name}.npy"), zip::write::SimpleFileOptions::default()).unwrap();
        let header = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}\n");
        zip.write_all(b"\x93NUMPY\x01\x00").unwrap();
        zip.write_all(&(header.len() as u16).to_le_bytes()).unwrap();
        zip.write_all(header.as_bytes()).unwrap();
        zip.write_all(data).unwrap();
    }
    zip.finish().unwrap();
}
