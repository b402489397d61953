//! Rate and distortion of ssplat on a folder of pictures, in actual file bytes, next to results of other codecs from a
//! CSV.
//!
//! ```sh
//! cargo run --release -p ssplat-lab --example rate_distortion -- DIR --anchors anchors.csv
//! cargo run --release -p ssplat-lab --example rate_distortion -- DIR --ratios 50 --effort 9 --only kodim05.png
//! ```
//!
//! Every picture is encoded at every ratio, decoded from the bytes, and compared with the original. The CSV has at
//! least the columns `image,codec,target_cr,bytes,psnr,msssim`, optionally `ssimulacra2` and `butteraugli`, and `N/A`
//! where a codec does not reach a ratio. Results are listed as PSNR / MS-SSIM / SSIMULACRA2 / Butteraugli. The first
//! table has a row for each picture and ratio; the second has the means.

mod folder;

use std::error::Error;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use clap::Parser;
use ssplat::unstable::EncodeOptions;
use ssplat::unstable::bitstream::splats::Layout;
use ssplat::unstable::metrics;
use ssplat::{Backend, Limits, Pixels, Target, Tune};
use ssplat::{Renderer, View};
use ssplat_cli::{names, perceived};

/// Rate and distortion of ssplat on a folder of pictures
#[derive(Debug, Parser)]
struct Args {
    /// The folder
    folder: PathBuf,
    /// Results of other codecs
    #[arg(long, value_name = "CSV")]
    anchors: Option<PathBuf>,
    /// Ratios of 8-bit sample bytes to file bytes
    #[arg(long, value_delimiter = ',', default_value = "20,50,100,200,500,1000,2000")]
    ratios: Vec<u32>,
    /// Only these file names
    #[arg(long, value_delimiter = ',')]
    only: Vec<String>,
    /// Amount of work, 1 to 9
    #[arg(long, default_value_t = 5)]
    effort: u8,
    /// Wall-clock budget of one fit, seconds
    #[arg(long)]
    time: Option<f64>,
    /// Seed of the random numbers
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Layout of the files
    #[arg(long, default_value = "coded", value_parser = names::layout())]
    layout: Layout,
    /// Measure to optimize for
    #[arg(long, default_value = "psnr", value_parser = names::tune())]
    tune: Tune,
    /// Device that fits
    #[arg(long, default_value = "auto", value_parser = names::backend())]
    backend: Backend,
    /// Repetitions of each decode; the fastest counts
    #[arg(long, default_value_t = 3)]
    repeat: u32,
    /// Threads to work with
    #[arg(long)]
    threads: Option<usize>,
    /// Also write the rows of ssplat as a CSV of the same form
    #[arg(long, value_name = "CSV")]
    csv: Option<PathBuf>,
}

/// Columns of the tables.
const MEASURES: [&str; 4] = ["PSNR", "MS-SSIM", "SSIMULACRA2", "Butteraugli"];
const SECONDS: [&str; 2] = ["enc s", "dec s"];

/// Columns of the CSV that is written.
const CSV_COLUMNS: &str = "image,codec,target_cr,bytes,actual_cr,psnr,msssim,ssimulacra2,butteraugli,ssim,enc_s,dec_s,\
                           setting,width,height,note";

/// One codec's result on one picture at one ratio.
#[derive(Debug, Clone)]
struct Row {
    image: String,
    codec: String,
    ratio: u32,
    /// `None` if the codec does not reach the ratio.
    quality: Option<Quality>,
}

#[derive(Debug, Clone, Copy)]
struct Quality {
    bytes: u64,
    psnr: f64,
    /// `None` if the picture is too small for it.
    ms_ssim: Option<f64>,
    /// `None` also if the CSV has no such column.
    ssimulacra2: Option<f64>,
    /// 3-norm; `None` as above.
    butteraugli: Option<f64>,
}

fn main() -> Result<(), Box<dyn Error>> {
    let args = Args::parse();
    if let Some(threads) = args.threads {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build_global()?;
    }
    let anchors = args.anchors.as_deref().map(read_anchors).transpose()?.unwrap_or_default();
    let mut codecs: Vec<String> = Vec::new();
    for row in &anchors {
        if !codecs.contains(&row.codec) {
            codecs.push(row.codec.clone());
        }
    }
    let mut csv = args.csv.as_ref().map(fs::File::create).transpose()?;
    if let Some(csv) = &mut csv {
        writeln!(csv, "{CSV_COLUMNS}")?;
    }
    println!("{}", header(&[&["image", "ratio", "bytes", "N"][..], &MEASURES, &SECONDS].concat(), &codecs));
    let mut rows = Vec::new();
    for path in folder::pictures(&args.folder, &args.only)? {
        let image = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let pixels = Pixels::try_from(image::open(&path)?)?;
        for &ratio in &args.ratios {
            let start = Instant::now();
            let encoded = ssplat::unstable::encode(&pixels, &options(&args, ratio))?;
            let encode_seconds = start.elapsed().as_secs_f64();
            let (decoded, decode_seconds) = decode(&encoded.bytes, args.repeat)?;
            let found = metrics::compare(&pixels, &decoded)?;
            let seen = perceived::measure(&pixels, &decoded);
            let quality = Quality {
                bytes: encoded.bytes.len() as u64,
                psnr: found.psnr,
                ms_ssim: found.ms_ssim,
                ssimulacra2: seen.ssimulacra2,
                butteraugli: seen.butteraugli,
            };
            let mut line = format!(
                "| {image} | {ratio} | {} | {} | {} | {encode_seconds:.2} | {decode_seconds:.4} |",
                quality.bytes,
                encoded.report.gaussians,
                quality.cells(" | "),
            );
            for codec in &codecs {
                let anchor = anchors.iter().find(|r| r.image == image && r.ratio == ratio && r.codec == *codec);
                line += &cell(anchor.and_then(|r| r.quality));
            }
            println!("{line}");
            if let Some(csv) = &mut csv {
                let (width, height) = (pixels.width(), pixels.height());
                let actual =
                    f64::from(width) * f64::from(height) * pixels.channels().count() as f64 / quality.bytes as f64;
                writeln!(
                    csv,
                    "{image},ssplat,{ratio},{},{actual:.2},{:.3},{},{},{},{},{encode_seconds:.3},{decode_seconds:.4},e={},\
                     {width},{height},",
                    quality.bytes,
                    quality.psnr,
                    or_none(found.ms_ssim, 5),
                    or_none(seen.ssimulacra2, 3),
                    or_none(seen.butteraugli, 3),
                    or_none(found.ssim, 5),
                    args.effort
                )?;
            }
            rows.push((
                Row { image: image.clone(), codec: "ssplat".into(), ratio, quality: Some(quality) },
                [encode_seconds, decode_seconds],
            ));
        }
    }
    print_means(&args.ratios, &rows, &anchors, &codecs);
    Ok(())
}

fn options(args: &Args, ratio: u32) -> EncodeOptions {
    let mut options = EncodeOptions::default();
    options.target = Target::Ratio(f64::from(ratio));
    options.effort = args.effort;
    options.time = args.time.map(Duration::from_secs_f64);
    options.seed = args.seed;
    options.layout = args.layout;
    options.tune = Some(args.tune);
    options.backend = args.backend;
    options
}

/// Decodes bytes to pixels, including parsing, and returns the seconds of the fastest of `repeat` runs.
fn decode(bytes: &[u8], repeat: u32) -> ssplat::Result<(Pixels, f64)> {
    let limits = Limits::default();
    let run = || -> ssplat::Result<(Pixels, f64)> {
        let start = Instant::now();
        let splats = ssplat::unstable::bitstream::read(bytes, &limits)?;
        let picture = splats.to_gaussians();
        let pixels =
            Renderer::new(&picture, &View::new(picture.width, picture.height), &limits)?.render(splats.depth)?;
        Ok((pixels, start.elapsed().as_secs_f64()))
    };
    let mut best = run()?;
    for _ in 1..repeat {
        best.1 = f64::min(best.1, run()?.1);
    }
    Ok(best)
}

/// Reads the results of other codecs. Only the last column may contain a comma.
fn read_anchors(path: &Path) -> Result<Vec<Row>, Box<dyn Error>> {
    let text = fs::read_to_string(path)?;
    let mut lines = text.lines();
    let names: Vec<&str> = lines.next().ok_or("the CSV is empty")?.split(',').collect();
    let column = |name: &str| names.iter().position(|n| *n == name).ok_or(format!("the CSV has no column {name}"));
    let columns = [column("image")?, column("codec")?, column("target_cr")?, column("bytes")?, column("psnr")?];
    let ms_ssim = column("msssim")?;
    let [ssimulacra2, butteraugli] = ["ssimulacra2", "butteraugli"].map(|name| column(name).ok());
    let row = |line: &str| -> Result<Row, Box<dyn Error>> {
        let cells: Vec<&str> = line.split(',').collect();
        let cell = |i: usize| cells.get(i).copied().ok_or(format!("short line {line:?}"));
        let [image, codec, ratio, bytes, psnr] = columns.map(cell);
        let quality = match psnr? {
            "N/A" | "" => None,
            psnr => Some(Quality {
                bytes: bytes?.parse()?,
                psnr: psnr.parse()?,
                ms_ssim: cell(ms_ssim)?.parse().ok(),
                ssimulacra2: ssimulacra2.map(cell).transpose()?.and_then(|v| v.parse().ok()),
                butteraugli: butteraugli.map(cell).transpose()?.and_then(|v| v.parse().ok()),
            }),
        };
        Ok(Row { image: image?.into(), codec: codec?.into(), ratio: ratio?.parse()?, quality })
    };
    lines.filter(|l| !l.is_empty()).map(row).collect()
}

/// Returns the head of a table: `columns` and one more for each codec.
fn header(columns: &[&str], codecs: &[String]) -> String {
    let names: Vec<&str> = columns.iter().copied().chain(codecs.iter().map(String::as_str)).collect();
    format!("| {} |\n|{}", names.join(" | "), "---|".repeat(names.len()))
}

/// Formats a value with `digits` decimals for the CSV.
fn or_none(v: Option<f64>, digits: usize) -> String {
    v.map_or("N/A".into(), |v| format!("{v:.digits$}"))
}

impl Quality {
    /// Formats the four measures, separated by `between`.
    fn cells(&self, between: &str) -> String {
        let of = |v: Option<f64>, digits: usize| v.map_or("-".into(), |v| format!("{v:.digits$}"));
        [of(Some(self.psnr), 2), of(self.ms_ssim, 4), of(self.ssimulacra2, 1), of(self.butteraugli, 2)].join(between)
    }

    /// Returns the mean of each measure; `None` if one of the values is missing.
    fn mean(all: &[Quality]) -> Quality {
        let of =
            |v: fn(&Quality) -> Option<f64>| all.iter().map(v).collect::<Option<Vec<_>>>().map(|v| mean(v.into_iter()));
        Quality {
            bytes: mean(all.iter().map(|q| q.bytes as f64)) as u64,
            psnr: mean(all.iter().map(|q| q.psnr)),
            ms_ssim: of(|q| q.ms_ssim),
            ssimulacra2: of(|q| q.ssimulacra2),
            butteraugli: of(|q| q.butteraugli),
        }
    }
}

/// The measures of a codec.
fn cell(quality: Option<Quality>) -> String {
    quality.map_or(" - |".into(), |q| format!(" {} |", q.cells(" / ")))
}

/// Prints the means of ssplat and of the other codecs at each ratio, over the pictures that were measured.
fn print_means(ratios: &[u32], rows: &[(Row, [f64; 2])], anchors: &[Row], codecs: &[String]) {
    println!(
        "\nMeans; in brackets over how many pictures where a codec does not reach all, and ssplat's lead there in dB.\n"
    );
    println!("{}", header(&[&["ratio", "pictures", "bytes"][..], &MEASURES, &SECONDS].concat(), codecs));
    for &ratio in ratios {
        let ours: Vec<_> = rows.iter().filter(|r| r.0.ratio == ratio).collect();
        let found: Vec<Quality> = ours.iter().filter_map(|r| r.0.quality).collect();
        let seconds = |k: usize| mean(ours.iter().map(|r| r.1[k]));
        let ours_mean = Quality::mean(&found);
        let mut line = format!(
            "| {ratio} | {} | {} | {} | {:.2} | {:.4} |",
            found.len(),
            ours_mean.bytes,
            ours_mean.cells(" | "),
            seconds(0),
            seconds(1),
        );
        for codec in codecs {
            let pairs: Vec<(Quality, Quality)> = ours
                .iter()
                .filter_map(|(r, _)| {
                    let same = |a: &&Row| a.image == r.image && a.ratio == ratio && a.codec == *codec;
                    r.quality.zip(anchors.iter().find(same)?.quality)
                })
                .collect();
            if pairs.is_empty() {
                line += " - |";
                continue;
            }
            let theirs: Vec<Quality> = pairs.iter().map(|p| p.1).collect();
            let lead = mean(pairs.iter().map(|p| p.0.psnr - p.1.psnr));
            let count = if pairs.len() < found.len() { format!(" ({})", pairs.len()) } else { String::new() };
            line += &format!(" {}{count} {lead:+.2} |", Quality::mean(&theirs).cells(" / "));
        }
        println!("{line}");
    }
}

fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0u32), |(s, n), v| (s + v, n + 1));
    sum / f64::from(count.max(1))
}
