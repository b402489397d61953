//! Compares decoding with other codecs in one run: CPU time, wall time and peak memory for files of equal size.
//!
//! ```sh
//! cargo run --release -p ssplat-lab --example decode_speed -- PICTURE... --ratio 200
//! ```
//!
//! Each picture is encoded at the ratio by ssplat, by `image`'s JPEG encoder (decoded by zune-jpeg, which `image`
//! uses), losslessly as PNG, and by `cwebp`, `avifenc` and `cjxl` if they are installed. The quality is the highest at
//! which the file is no larger than requested, or the lowest available. Every decode runs in a process of its own that
//! decodes into memory repeatedly. The time is that of the fastest repetition, and the peak memory that of the
//! process. Programs (`ssplat decode` if it lies beside this example's folder, `djpeg`, `dwebp`, `avifdec`, `djxl`) are
//! timed as a whole, including writing a temporary file.
//! ssplat renders a region (the middle 1024² or less) and a thumbnail (256 pixels wide) directly; the other codecs
//! decode the whole picture for them.
//!
//! With `--lossless`, the files are those without loss of ssplat and of `cwebp -lossless -m 6 -q 100`, and PNG. All decodes
//! run on one thread and are measured in turn, several times, so that other work on the machine slows all of them. The
//! unit is then `image-webp`, and a column has the nanoseconds of CPU time a pixel:
//!
//! ```sh
//! cargo run --release -p ssplat-lab --example decode_speed -- PICTURE... --lossless
//! ```
//!
//! A decode into newly allocated memory waits for the system to map each page of the picture. Rows marked "reused"
//! decode into the buffer of the previous repetition, as a viewer or a player would. Programs do not offer this.

use std::error::Error;
use std::fs;
use std::io::Cursor;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use clap::Parser;
use image::codecs::jpeg::JpegEncoder;
use image::{DynamicImage, ImageDecoder, ImageReader};
use nix::sys::resource::{UsageWho, getrusage};
use ssplat::SamplesMut;
use ssplat::unstable::bitstream::header::Header;
use ssplat::unstable::{DecodeOptions, EncodeOptions};
use ssplat::{Limits, Pixels, Rect, Target};

type Result<T> = std::result::Result<T, Box<dyn Error>>;

/// Compare decoding with other codecs in one run
#[derive(Debug, Parser)]
struct Args {
    /// The pictures
    #[arg(required = true)]
    pictures: Vec<PathBuf>,
    /// Ratio of 8-bit sample bytes to file bytes
    #[arg(long, default_value_t = 200.0)]
    ratio: f64,
    /// Effort of the ssplat encodes, 1 to 9
    #[arg(long, default_value_t = 5)]
    effort: u8,
    /// Repetitions of each decode; the fastest counts
    #[arg(long, default_value_t = 5)]
    repeat: u32,
    /// Run only the decoders whose names begin with one of these, as `ssplat,dwebp`
    #[arg(long, value_delimiter = ',')]
    only: Vec<String>,
    /// Compare files without loss
    #[arg(long)]
    lossless: bool,
    /// Keep the files in this folder, and reuse the files that it contains
    #[arg(long)]
    keep: Option<PathBuf>,
    /// For internal use: decode a single file with this codec and print the figures
    #[arg(long, hide = true)]
    by: Option<String>,
}

fn main() -> Result<()> {
    let args = Args::parse();
    if let Some(by) = &args.by {
        println!("{}", measured(by, &args.pictures[0], args.repeat)?);
        return Ok(());
    }
    let temporary = tempfile::tempdir()?;
    let folder = args.keep.clone().unwrap_or_else(|| temporary.path().to_owned());
    fs::create_dir_all(&folder)?;
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    if args.lossless {
        println!("Without loss, one thread, fastest of {}.\n", ROUNDS * args.repeat);
        println!("| picture | decoder | bytes | CPU ms | ns a pixel | peak MB | CPU, image-webp = 1 |");
        println!("|---|---|--:|--:|--:|--:|--:|");
        return args.pictures.iter().try_for_each(|picture| lossless_table(picture, &args, &folder));
    }
    println!("Ratio {}, effort {}, {threads} threads, fastest of {}.\n", args.ratio, args.effort, args.repeat);
    println!("| picture | decoder | bytes | CPU ms | wall ms | peak MB | CPU, zune-jpeg = 1 |");
    println!("|---|---|--:|--:|--:|--:|--:|");
    for picture in &args.pictures {
        table(picture, &args, &folder)?;
    }
    Ok(())
}

/// Rounds in which the decoders of files without loss are measured in turn.
const ROUNDS: u32 = 3;

/// The rows of one picture without loss.
fn lossless_table(path: &Path, args: &Args, folder: &Path) -> Result<()> {
    let picture = DynamicImage::ImageRgb8(ImageReader::open(path)?.with_guessed_format()?.decode()?.into_rgb8());
    let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let pixels = f64::from(picture.width()) * f64::from(picture.height());
    let file = |extension: &str| folder.join(format!("{name}-lossless.{extension}"));
    let (png, ours, webp) = (file("png"), file("ssplat"), file("webp"));
    picture.save(&png)?;
    if !ours.exists() {
        let mut options = EncodeOptions::default();
        options.target = Target::Lossless;
        options.effort = args.effort;
        fs::write(&ours, ssplat::unstable::encode(&Pixels::try_from(picture)?, &options)?.bytes)?;
    }
    if !webp.exists() {
        let options: [&Path; 6] = ["-quiet", "-lossless", "-m", "6", "-q", "100"].map(Path::new);
        program("cwebp", &[&options[..], &[png.as_path(), Path::new("-o"), webp.as_path()]].concat())?;
    }
    let rows = [
        ("image-webp", &webp),
        ("image-webp, reused", &webp),
        ("ssplat", &ours),
        ("ssplat, reused", &ours),
        ("ssplat, reading alone", &ours),
        ("png (image)", &png),
    ];
    let wanted = |by: &str| args.only.is_empty() || args.only.iter().any(|start| by.starts_with(start.as_str()));
    let mut best = [[f64::INFINITY; 3]; 6];
    for _ in 0..ROUNDS {
        for ((by, file), best) in rows.iter().zip(&mut best).filter(|row| wanted(row.0.0)) {
            let figures = measured_apart(by, file, args.repeat)?;
            *best = std::array::from_fn(|k| best[k].min(figures[k]));
        }
    }
    for ((by, file), [cpu, _, peak]) in rows.into_iter().zip(best).filter(|row| wanted(row.0.0)) {
        let (bytes, each) = (fs::metadata(file)?.len(), cpu * 1e6 / pixels);
        println!("| {name} | {by} | {bytes} | {cpu:.1} | {each:.1} | {peak:.0} | {:.2} |", cpu / best[0][0]);
    }
    Ok(())
}

/// Returns what [`measured`] returns, measured in a process of its own with one thread.
fn measured_apart(by: &str, file: &Path, repeat: u32) -> Result<[f64; 3]> {
    let mut command = Command::new(std::env::current_exe()?);
    command.arg(file).args(["--by", by, "--repeat", &repeat.to_string()]).env("RAYON_NUM_THREADS", "1");
    let output = command.output()?;
    let figures = String::from_utf8(output.stdout)?;
    let figures: Vec<f64> = figures.split_whitespace().filter_map(|v| v.parse().ok()).collect();
    let failed = |_| format!("{by} on {}: {}", file.display(), String::from_utf8_lossy(&output.stderr)).into();
    figures.try_into().map_err(failed)
}

/// The rows of one picture.
fn table(path: &Path, args: &Args, folder: &Path) -> Result<()> {
    let picture = DynamicImage::ImageRgb8(ImageReader::open(path)?.with_guessed_format()?.decode()?.into_rgb8());
    let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let most = (f64::from(picture.width()) * f64::from(picture.height()) * 3.0 / args.ratio) as u64;
    let file = |extension: &str| folder.join(format!("{name}-{}.{extension}", args.ratio));
    let png = file("png");
    picture.save(&png)?;
    let ours = file("ssplat");
    if !ours.exists() {
        let mut options = EncodeOptions::default();
        options.target = Target::Bytes(most);
        options.effort = args.effort;
        fs::write(&ours, ssplat::unstable::encode(&Pixels::try_from(picture.clone())?, &options)?.bytes)?;
    }
    let jpeg = file("jpg");
    search(1, 100, most, &jpeg, |quality| {
        let mut bytes = Vec::new();
        picture.write_with_encoder(JpegEncoder::new_with_quality(&mut bytes, quality as u8))?;
        Ok(fs::write(&jpeg, bytes)?)
    })?;
    let wanted = |by: &str| args.only.is_empty() || args.only.iter().any(|start| by.starts_with(start.as_str()));
    let mut rows = vec![
        ("zune-jpeg", jpeg.clone()),
        ("zune-jpeg, reused", jpeg.clone()),
        ("ssplat", ours.clone()),
        ("ssplat, reused", ours.clone()),
        ("ssplat, reading alone", ours.clone()),
        ("ssplat, 1024² region", ours.clone()),
        ("ssplat, 256 wide", ours.clone()),
        ("ssplat, its thumbnail", ours.clone()),
        ("png (image)", png.clone()),
        ("png (image), reused", png.clone()),
    ];
    if program_of_ssplat().is_some() {
        rows.push(("ssplat decode", ours));
    }
    if wanted("djpeg") && installed("djpeg") {
        rows.push(("djpeg", jpeg));
    }
    let run = |program: &str, arguments: &[&str]| -> Result<()> {
        let output = Command::new(program).args(arguments).output()?;
        let said = || String::from_utf8_lossy(&output.stderr).into_owned();
        if output.status.success() { Ok(()) } else { Err(format!("{program}: {}", said()).into()) }
    };
    let text = |p: &Path| p.to_string_lossy().into_owned();
    if (wanted("dwebp") || wanted("image-webp")) && installed("cwebp") {
        let webp = file("webp");
        search(0, 100, most, &webp, |q| {
            run("cwebp", &["-quiet", "-q", &q.to_string(), &text(&png), "-o", &text(&webp)])
        })?;
        rows.push(("image-webp", webp.clone()));
        rows.push(("image-webp, reused", webp.clone()));
        if installed("dwebp") {
            rows.push(("dwebp", webp));
        }
    }
    if wanted("avifdec") && installed("avifenc") && installed("avifdec") {
        let avif = file("avif");
        search(0, 63, most, &avif, |q| {
            let q = (63 - q).to_string();
            run("avifenc", &["-s", "8", "-j", "all", "--min", &q, "--max", &q, &text(&png), &text(&avif)])
        })?;
        rows.push(("avifdec", avif));
    }
    if wanted("djxl") && installed("cjxl") && installed("djxl") {
        let jxl = file("jxl");
        search(0, 100, most, &jxl, |q| {
            let distance = format!("{:.2}", 25.0 - 0.249 * f64::from(q));
            run("cjxl", &["-e", "4", "-d", &distance, &text(&png), &text(&jxl)])
        })?;
        rows.push(("djxl", jxl));
    }
    let mut unit = None;
    for (by, file) in rows.into_iter().filter(|row| wanted(row.0)) {
        let exe = std::env::current_exe()?;
        let repeat = args.repeat.to_string();
        let output = Command::new(exe).arg(&file).args(["--by", by, "--repeat", &repeat]).output()?;
        let figures = String::from_utf8(output.stdout)?;
        let figures: Vec<f64> = figures.split_whitespace().filter_map(|v| v.parse().ok()).collect();
        let [cpu, wall, peak] = figures[..] else {
            return Err(format!("{by} on {}: {}", file.display(), String::from_utf8_lossy(&output.stderr)).into());
        };
        let unit = *unit.get_or_insert(cpu);
        let bytes = fs::metadata(&file)?.len();
        println!("| {name} | {by} | {bytes} | {cpu:.1} | {wall:.1} | {peak:.0} | {:.2} |", cpu / unit);
    }
    Ok(())
}

/// Returns the program `ssplat` of the same build.
fn program_of_ssplat() -> Option<PathBuf> {
    let program = std::env::current_exe().ok()?.parent()?.parent()?.join("ssplat");
    program.exists().then_some(program)
}

/// Writes the file with the highest quality in `low..=high` that has at most `most` bytes, or with the lowest quality.
/// An existing file is kept.
fn search(low: u32, high: u32, most: u64, file: &Path, mut write: impl FnMut(u32) -> Result<()>) -> Result<()> {
    if file.exists() {
        return Ok(());
    }
    let (mut good, mut bad) = (low, high + 1);
    while bad - good > 1 {
        let middle = (good + bad) / 2;
        write(middle)?;
        if fs::metadata(file)?.len() <= most { good = middle } else { bad = middle }
    }
    write(good)
}

fn installed(program: &str) -> bool {
    Command::new(program).arg("--help").output().is_ok()
}

/// Returns CPU and wall milliseconds of the fastest repetition, and the peak memory in MB.
fn measured(by: &str, file: &Path, repeat: u32) -> Result<String> {
    let bytes = fs::read(file)?;
    let output = tempfile::Builder::new().suffix(".ppm").tempfile()?;
    let png = tempfile::Builder::new().suffix(".png").tempfile()?;
    let who = if ["ssplat decode", "djpeg", "dwebp", "avifdec", "djxl"].contains(&by) {
        UsageWho::RUSAGE_CHILDREN
    } else {
        UsageWho::RUSAGE_SELF
    };
    let mut best = (f64::INFINITY, f64::INFINITY);
    let mut buffer = Vec::new();
    if by.ends_with("reused") {
        let decoder = reader(&bytes)?;
        // Fill the buffer once, so that every page is mapped before the first repetition.
        buffer.resize(usize::try_from(decoder.total_bytes())?, 1);
    }
    for _ in 0..repeat {
        let (cpu, wall) = (cpu_time(who)?, Instant::now());
        match by {
            "ssplat decode" => {
                let ssplat = program_of_ssplat().ok_or("no program ssplat")?;
                program(&ssplat.to_string_lossy(), &["decode".as_ref(), file, output.path(), "--quiet".as_ref()])?;
            }
            "djpeg" => program("djpeg", &["-outfile".as_ref(), output.path(), file])?,
            "dwebp" => program("dwebp", &["-quiet".as_ref(), "-ppm".as_ref(), file, "-o".as_ref(), output.path()])?,
            "avifdec" => program(
                "avifdec",
                &["--jobs".as_ref(), "1".as_ref(), "--png-compress".as_ref(), "0".as_ref(), file, png.path()],
            )?,
            "djxl" => program("djxl", &[file, output.path()])?,
            "ssplat" => drop(ssplat::unstable::decode(&bytes, &DecodeOptions::default())?),
            "ssplat, reused" => {
                drop(ssplat::unstable::decode_into(&bytes, &DecodeOptions::default(), SamplesMut::U8(&mut buffer))?);
            }
            _ if by.ends_with("reused") => reader(&bytes)?.read_image(&mut buffer)?,
            "ssplat, reading alone" => drop(ssplat::unstable::bitstream::read(&bytes[..], &Limits::default())?),
            "ssplat, 1024² region" => {
                let size = Header::read(&mut &bytes[..], &Limits::default())?;
                let [w, h] = [size.width, size.height].map(|side| side.min(1024));
                let mut options = DecodeOptions::default();
                options.region = Some(Rect::new((size.width - w) / 2, (size.height - h) / 2, w, h));
                drop(ssplat::unstable::decode(&bytes, &options)?);
            }
            "ssplat, 256 wide" => {
                let size = Header::read(&mut &bytes[..], &Limits::default())?;
                let mut options = DecodeOptions::default();
                options.size = Some([256, (256 * size.height).div_ceil(size.width)]);
                drop(ssplat::unstable::decode(&bytes, &options)?);
            }
            "ssplat, its thumbnail" => drop(ssplat::Reader::new(&bytes, &Limits::default())?.thumbnail([256; 2])?),
            _ => drop(image::load_from_memory(&bytes)?),
        }
        let used = cpu_time(who)? - cpu;
        best = (best.0.min(used.as_secs_f64()), best.1.min(wall.elapsed().as_secs_f64()));
    }
    // The reported peak includes the size of the parent process at the fork. Only Linux reports a process's own peak.
    let own = fs::read_to_string("/proc/self/status").ok().filter(|_| who == UsageWho::RUSAGE_SELF);
    let own = own.as_ref().and_then(|s| s.lines().find_map(|l| l.strip_prefix("VmHWM:")?.split_whitespace().next()));
    let peak = match own {
        Some(kilobytes) => kilobytes.parse()?,
        None => getrusage(who)?.max_rss() as f64,
    } / 1024.0;
    Ok(format!("{} {} {peak}", best.0 * 1e3, best.1 * 1e3))
}

/// Returns a decoder of the `image` crate for a file of any format.
fn reader(bytes: &[u8]) -> Result<impl ImageDecoder + '_> {
    ssplat::register();
    Ok(ImageReader::new(Cursor::new(bytes)).with_guessed_format()?.into_decoder()?)
}

fn cpu_time(who: UsageWho) -> Result<Duration> {
    let usage = getrusage(who)?;
    let micros = |t: nix::sys::time::TimeVal| t.tv_sec() as u64 * 1_000_000 + t.tv_usec() as u64;
    Ok(Duration::from_micros(micros(usage.user_time()) + micros(usage.system_time())))
}

fn program(name: &str, arguments: &[&Path]) -> Result<()> {
    let output = Command::new(name).args(arguments).output()?;
    let said = || String::from_utf8_lossy(&output.stderr).into_owned();
    if output.status.success() { Ok(()) } else { Err(format!("{name}: {}", said()).into()) }
}
