//! Results of other codecs: from a CSV file, or by running those that are installed.

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Instant;

use image::codecs::pnm::{PnmEncoder, PnmSubtype, SampleEncoding};
use ssplat::Pixels;

use ssplat_cli::compare;
use ssplat_cli::failure::Failure;
use ssplat_cli::input;
use ssplat_cli::source::{self, Turn};

/// One file of another codec.
#[derive(Debug, Clone, PartialEq)]
pub struct Anchor {
    pub image: String,
    pub codec: String,
    pub bytes: u64,
    pub psnr: f64,
    pub ssim: Option<f64>,
    pub ms_ssim: Option<f64>,
    pub ssimulacra2: Option<f64>,
    pub butteraugli: Option<f64>,
    pub encode_seconds: f64,
    pub decode_seconds: f64,
    pub setting: String,
}

/// A codec's programs, and the settings that cover the ratios of a report.
struct Codec {
    name: &'static str,
    encoder: &'static str,
    decoder: &'static str,
    extension: &'static str,
    settings: &'static [&'static str],
    encode: fn(setting: &str, input: &str, output: &str) -> Vec<String>,
    decode: fn(input: &str, output: &str) -> Vec<String>,
}

fn words(list: &[&str]) -> Vec<String> {
    list.iter().map(|&w| w.into()).collect()
}

const CODECS: [Codec; 4] = [
    Codec {
        name: "jpeg",
        encoder: "cjpeg",
        decoder: "djpeg",
        extension: "jpg",
        settings: &["3", "6", "10", "16", "25", "40", "60"],
        encode: |s, i, o| words(&["-optimize", "-progressive", "-quality", s, "-outfile", o, i]),
        decode: |i, o| words(&["-outfile", o, i]),
    },
    Codec {
        name: "webp",
        encoder: "cwebp",
        decoder: "dwebp",
        extension: "webp",
        settings: &["0", "5", "12", "25", "45", "65"],
        encode: |s, i, o| words(&["-quiet", "-m", "6", "-q", s, i, "-o", o]),
        decode: |i, o| words(&["-quiet", "-ppm", i, "-o", o]),
    },
    Codec {
        name: "avif",
        encoder: "avifenc",
        decoder: "avifdec",
        extension: "avif",
        settings: &["63", "59", "54", "48", "42", "36", "30"],
        encode: |s, i, o| {
            let level = format!("cq-level={s}");
            words(&[
                "-j",
                "1",
                "-s",
                "6",
                "-y",
                "420",
                "-d",
                "8",
                "--min",
                "0",
                "--max",
                "63",
                "-a",
                "end-usage=q",
                "-a",
                &level,
                i,
                o,
            ])
        },
        decode: |i, o| words(&["-j", "1", i, o]),
    },
    Codec {
        name: "jxl",
        encoder: "cjxl",
        decoder: "djxl",
        extension: "jxl",
        settings: &["25", "15", "10", "6.5", "4.5", "3", "2"],
        encode: |s, i, o| words(&[i, o, "-d", s, "--num_threads=0", "--quiet"]),
        decode: |i, o| words(&[i, o, "--num_threads=0", "--quiet"]),
    },
];

/// Returns the names of the installed codecs.
pub fn installed() -> Vec<&'static str> {
    let found = |program: &str| {
        let path = std::env::var_os("PATH").unwrap_or_default();
        std::env::split_paths(&path).any(|folder| folder.join(program).is_file())
    };
    CODECS.iter().filter(|c| found(c.encoder) && found(c.decoder)).map(|c| c.name).collect()
}

/// Runs one installed codec with all of its settings. If a program fails on a picture, the point is omitted.
pub fn run(name: &str, image: &str, pixels: &Pixels) -> Result<Vec<Anchor>, Failure> {
    let codec = CODECS.iter().find(|c| c.name == name).expect("an installed codec");
    let folder = tempfile::tempdir().map_err(|e| Failure::io(&std::env::temp_dir(), &e))?;
    let path = |file: &str| folder.path().join(file).to_string_lossy().into_owned();
    // cjpeg reads PPM, avifenc PNG; the others read both.
    let input = path(if codec.name == "jpeg" { "in.ppm" } else { "in.png" });
    let picture = image::DynamicImage::from(pixels.clone()).to_rgb8();
    let failed = |e| Failure::image(Path::new(&input), &e);
    match codec.name {
        // `save` would write PAM, which cjpeg does not read.
        "jpeg" => {
            let file = std::fs::File::create(&input).map_err(|e| Failure::io(Path::new(&input), &e))?;
            let pixmap = PnmSubtype::Pixmap(SampleEncoding::Binary);
            picture.write_with_encoder(PnmEncoder::new(file).with_subtype(pixmap)).map_err(failed)?;
        }
        _ => picture.save(&input).map_err(failed)?,
    }
    let reference =
        Pixels::try_from(image::DynamicImage::from(picture)).map_err(|e| Failure::library(Path::new(image), &e))?;
    let mut anchors = Vec::new();
    for setting in codec.settings {
        let coded = path(&format!("coded.{}", codec.extension));
        let output = path(if codec.name == "jpeg" || codec.name == "webp" { "out.ppm" } else { "out.png" });
        let Some(encode_seconds) = timed(codec.encoder, &(codec.encode)(setting, &input, &coded)) else { continue };
        let Some(decode_seconds) = timed(codec.decoder, &(codec.decode)(&coded, &output)) else { continue };
        let Ok(metadata) = std::fs::metadata(&coded) else { continue };
        let decoded = source::open(Path::new(&output), Turn::Keep)?.pixels;
        let Ok(found) = compare::measure(&reference, &decoded) else { continue };
        anchors.push(Anchor {
            image: image.into(),
            codec: codec.name.into(),
            bytes: metadata.len(),
            psnr: found.psnr.min(compare::IDENTICAL),
            ssim: found.ssim,
            ms_ssim: found.ms_ssim,
            ssimulacra2: found.perceived.ssimulacra2,
            butteraugli: found.perceived.butteraugli,
            encode_seconds,
            decode_seconds,
            setting: (*setting).into(),
        });
    }
    Ok(anchors)
}

/// Returns the seconds that a program took; `None` if it failed.
fn timed(program: &str, arguments: &[String]) -> Option<f64> {
    let start = Instant::now();
    let status = Command::new(program)
        .args(arguments)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status()
        .ok()?;
    status.success().then(|| start.elapsed().as_secs_f64())
}

const COLUMNS: [&str; 9] = ["image", "codec", "bytes", "psnr", "msssim", "ssim", "enc_s", "dec_s", "setting"];

/// Optional columns of a CSV.
const OPTIONAL_COLUMNS: [&str; 2] = ["ssimulacra2", "butteraugli"];

/// Formats results as a CSV that [`parse`] reads.
pub fn as_csv(anchors: &[Anchor]) -> String {
    let of = |v: Option<f64>| v.map_or_else(|| "N/A".into(), |v| format!("{v:.5}"));
    let [ms_ssim, rest] = [&COLUMNS[..5], &COLUMNS[5..]];
    let mut text = [ms_ssim, &OPTIONAL_COLUMNS, rest].concat().join(",") + "\n";
    for a in anchors {
        text += &format!(
            "{},{},{},{:.3},{},{},{},{},{:.3},{:.3},{}\n",
            a.image,
            a.codec,
            a.bytes,
            a.psnr,
            of(a.ms_ssim),
            of(a.ssimulacra2),
            of(a.butteraugli),
            of(a.ssim),
            a.encode_seconds,
            a.decode_seconds,
            a.setting
        );
    }
    text
}

/// Reads a CSV with at least the columns `image, codec, bytes, psnr, msssim, ssim, enc_s, dec_s, setting`, in any
/// order, and optionally `ssimulacra2` and `butteraugli`. Rows without a size (`N/A`) are skipped.
pub fn parse(path: &Path) -> Result<Vec<Anchor>, Failure> {
    let text = String::from_utf8_lossy(&input::read_at_most(path, 64 << 20)?).into_owned();
    let mut lines = text.lines();
    let header: Vec<&str> = lines.next().unwrap_or("").split(',').map(str::trim).collect();
    let mut columns = [0; COLUMNS.len()];
    for (place, name) in columns.iter_mut().zip(COLUMNS) {
        *place = header
            .iter()
            .position(|h| *h == name)
            .ok_or_else(|| Failure::usage(format!("{}: no column {name}", path.display())))?;
    }
    let further = OPTIONAL_COLUMNS.map(|name| header.iter().position(|h| *h == name));
    let mut anchors = Vec::new();
    for line in lines {
        // Only the last column of such files is ever quoted, and no column after it is read.
        let cells: Vec<&str> = line.split(',').map(str::trim).collect();
        let cell = |i: usize| cells.get(columns[i]).copied().unwrap_or("");
        let value = |i: usize| cell(i).parse::<f64>().ok();
        let [ssimulacra2, butteraugli] =
            further.map(|place| place.and_then(|i| cells.get(i)).and_then(|v| v.parse::<f64>().ok()));
        let (Some(bytes), Some(psnr)) = (value(2), value(3)) else { continue };
        anchors.push(Anchor {
            image: cell(0).into(),
            codec: cell(1).into(),
            bytes: bytes as u64,
            psnr,
            ms_ssim: value(4),
            ssimulacra2,
            butteraugli,
            ssim: value(5),
            encode_seconds: value(6).unwrap_or(0.0),
            decode_seconds: value(7).unwrap_or(0.0),
            setting: cell(8).into(),
        });
    }
    Ok(anchors)
}

/// Interpolates a curve of (bytes, value) points at `bytes`, linearly in log bytes; `None` beyond its ends.
pub fn at_bytes(curve: &[(f64, f64)], bytes: f64) -> Option<f64> {
    let mut sorted = curve.to_vec();
    sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
    // Tolerance for the last few bytes that a size search leaves.
    let slack = 1.03;
    let (first, last) = (*sorted.first()?, *sorted.last()?);
    if bytes < first.0 / slack || bytes > last.0 * slack {
        return None;
    }
    let above = sorted.iter().position(|p| p.0 >= bytes).unwrap_or(sorted.len() - 1).max(1).min(sorted.len() - 1);
    if sorted.len() == 1 {
        return Some(first.1);
    }
    let (a, b) = (sorted[above - 1], sorted[above]);
    let share = (bytes / a.0).ln() / (b.0 / a.0).ln();
    Some(a.1 + (b.1 - a.1) * share)
}
