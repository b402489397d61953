//! `ssplat-lab report`: encodes pictures with several ratios, efforts, recipes and backends, and writes one page and
//! its numbers.

pub mod args;
mod cells;
mod chart;
mod codecs;
mod crops;
mod left_out;
mod page;
mod scenes;
mod stability;
mod tables;

use std::path::Path;

use serde_json::{Value, json};
use ssplat::{Backend, Blend, Channels, Pixels, Samples};

use crate::smartsplat::{ABLATION, Ablation};
use args::{Codecs, Recipes};
use cells::{Cell, Job, Setup, Subject};
use codecs::Anchor;
use left_out::Needless;
use ssplat_cli::failure::Failure;
use ssplat_cli::input;
use ssplat_cli::progress::Bar;
use ssplat_cli::sink::{Sink, say};
use ssplat_cli::source::{self, Turn};
use stability::Row;

/// Side of the crop of the first picture that is the photograph among the scenes, pixels.
const PHOTOGRAPH: u32 = 256;

pub fn run(args: &args::Report) -> Result<(), Failure> {
    let kept = args.out.join("cells");
    std::fs::create_dir_all(&kept).map_err(|e| Failure::io(&kept, &e))?;
    let mut subjects = Vec::new();
    for path in &args.images {
        let name = path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned();
        subjects.push(Subject { name, pixels: source::open(path, Turn::Keep)?.pixels });
    }
    let middle = (middle(&args.ratios), middle(&args.efforts));
    let gpu = gpu();
    let backends = match &gpu {
        _ if !args.backends.is_empty() => &args.backends,
        Ok(_) => &[Backend::Cpu, Backend::Gpu][..],
        Err(_) => &[],
    };
    let jobs = jobs(args, backends, subjects.len(), middle);
    let bar = Bar::new();
    let steps = jobs.len() as f32 + 1.0;
    let mut cells = Vec::new();
    for (i, job) in jobs.into_iter().enumerate() {
        let subject = &subjects[job.subject];
        let path = cells::path(&kept, subject, &job.setup);
        let text = format!("{} 1:{} {}", subject.name, job.setup.ratio, job.setup.recipe_name());
        let cell = match cells::load(&path, job) {
            Some(cell) => cell,
            None => cells::run(&path, job, subject, &mut |p| bar.show((i as f32 + p) / steps, text.clone()))?,
        };
        cells.push(cell);
    }
    bar.show((steps - 1.0) / steps, "other codecs");
    let anchors = anchors(args, &kept, &subjects)?;
    bar.show((steps - 0.5) / steps, "scenes");
    let left_out = scenes(&kept, &subjects[0])?;
    let stability = stiff(args)?;
    let contents = page::Contents {
        subjects: &subjects,
        cells: &cells,
        anchors: &anchors,
        stability: &stability,
        left_out: &left_out,
        middle,
        gpu: &gpu,
        threads: rayon::current_num_threads(),
        command: command(args),
    };
    let write = |name: &str, text: String| {
        let path = args.out.join(name);
        Sink::create(&path, &[])?.finish_with(text.as_bytes())
    };
    write("index.html", contents.html())?;
    write("tables.md", tables::markdown(&contents))?;
    write("results.csv", csv(&cells))?;
    write("results.json", format!("{:#}\n", as_json(&cells, &anchors, &stability, &left_out)))?;
    write("anchors.csv", codecs::as_csv(&anchors))?;
    drop(bar);
    let failed: Vec<&Row> = stability.iter().filter(|r| !r.holds()).collect();
    for row in &failed {
        say(&format!("beyond its bound: {}: {}\n", row.group, row.case))?;
    }
    say(&format!("{}: {} encodes\n", args.out.join("index.html").display(), cells.len()))
}

fn middle<T: Copy>(list: &[T]) -> T {
    list[(list.len() - 1) / 2]
}

/// Returns the jobs to measure: ratios at the middle effort, efforts at the middle ratio, then recipes and backends at
/// both.
fn jobs(args: &args::Report, backends: &[Backend], subjects: usize, (ratio, effort): (f64, u8)) -> Vec<Job> {
    let own = Setup { ratio, effort, smartsplat: None, blend: None, backend: Backend::Auto };
    let mut setups = vec![own];
    setups.extend(args.ratios.iter().map(|&ratio| Setup { ratio, ..own }));
    setups.extend(args.efforts.iter().map(|&effort| Setup { effort, ..own }));
    setups.push(Setup { blend: Some(Blend::Sum), ..own });
    if args.recipes == Recipes::All {
        setups.extend(ABLATION.iter().map(|step| Setup { smartsplat: Some(step), ..own }));
        setups.push(Setup { smartsplat: Some(&Ablation::Colors), blend: Some(Blend::Normalized), ..own });
    }
    setups.extend(backends.iter().map(|&backend| Setup { backend, ..own }));
    let with_smartsplat = args.smartsplat_images.unwrap_or(subjects);
    let mut jobs: Vec<Job> = Vec::new();
    for job in (0..subjects).flat_map(|subject| setups.iter().map(move |&setup| Job { subject, setup })) {
        let is_wanted = job.setup.smartsplat.is_none() || job.subject < with_smartsplat;
        if is_wanted && !jobs.contains(&job) {
            jobs.push(job);
        }
    }
    jobs
}

/// Returns the name of the GPU for fits, or the reason why there is none. Software adapters do not count.
#[cfg(feature = "gpu")]
fn gpu() -> Result<String, String> {
    use ssplat::gpu::{Adapters, Device};
    match Device::open(Adapters::Hardware) {
        Ok(device) => Ok(device.name().to_owned()),
        Err(ssplat::Error::Gpu(e)) => Err(e.to_string()),
        Err(e) => Err(e.to_string()),
    }
}

#[cfg(not(feature = "gpu"))]
fn gpu() -> Result<String, String> {
    Err(ssplat::GpuError::NotBuilt.to_string())
}

/// Returns the results of other codecs: those in the CSV, and those of the installed programs.
fn anchors(args: &args::Report, kept: &Path, subjects: &[Subject]) -> Result<Vec<Anchor>, Failure> {
    let mut all = match &args.anchors {
        Some(path) => codecs::parse(path)?,
        None => Vec::new(),
    };
    all.retain(|a| subjects.iter().any(|s| s.name == a.image));
    if args.codecs == Codecs::None {
        return Ok(all);
    }
    for codec in codecs::installed() {
        // A codec that is in the CSV is not measured again.
        if all.iter().any(|a| a.codec == codec) {
            continue;
        }
        for subject in subjects {
            let path = kept.join(format!("{}-{codec}.csv", subject.name));
            let found = match path.exists() {
                true => codecs::parse(&path)?,
                false => {
                    let found = codecs::run(codec, &subject.name, &subject.pixels)?;
                    std::fs::write(&path, codecs::as_csv(&found)).map_err(|e| Failure::io(&path, &e))?;
                    found
                }
            };
            all.extend(found);
        }
    }
    Ok(all)
}

/// Returns the scenes of the encoder's savings, stored like the cells.
fn scenes(kept: &Path, photograph: &Subject) -> Result<Vec<Needless>, Failure> {
    let list = left_out::list(piece(&photograph.pixels));
    let mut rows = Vec::new();
    for scene in &list {
        let name = &scene.name;
        let path = kept.join(format!("scene-{}.json", name.replace(|c: char| !c.is_ascii_alphanumeric(), "-")));
        let row = match std::fs::read(&path).ok().and_then(|b| left_out::from_json(&serde_json::from_slice(&b).ok()?)) {
            Some(row) => row,
            None => {
                let row = left_out::measure(scene).map_err(|e| Failure::library(Path::new(name), &e))?;
                std::fs::write(&path, row.as_json().to_string()).map_err(|e| Failure::io(&path, &e))?;
                row
            }
        };
        rows.push(row);
    }
    Ok(rows)
}

/// Returns the middle of a picture, at most as large as the photograph among the scenes; `None` unless it has 8 bits.
fn piece(pixels: &Pixels) -> Option<Pixels> {
    let Samples::U8(samples) = pixels.samples() else { return None };
    let (w, h) = (pixels.width().min(PHOTOGRAPH), pixels.height().min(PHOTOGRAPH));
    let (left, top) = ((pixels.width() - w) / 2, (pixels.height() - h) / 2);
    let count = pixels.channels().count();
    let mut out = Vec::new();
    for y in top..top + h {
        let first = (y as usize * pixels.width() as usize + left as usize) * count;
        out.extend_from_slice(&samples[first..first + w as usize * count]);
    }
    Pixels::new(w, h, Channels::from_count(count)?, Samples::U8(out)).ok()
}

/// Returns the stiff cases of the given file.
fn stiff(args: &args::Report) -> Result<Vec<Row>, Failure> {
    let Some(path) = &args.stability else { return Ok(Vec::new()) };
    Ok(stability::parse(&String::from_utf8_lossy(&input::read_at_most(path, 64 << 20)?)))
}

/// Returns the command line, without what is specific to this machine.
fn command(args: &args::Report) -> String {
    let list = |v: Vec<String>| v.join(",");
    let names: Vec<String> = args.images.iter().map(|p| p.display().to_string()).collect();
    let mut text = format!(
        "ssplat-lab report {} --out {} --ratios {} --efforts {}",
        names.join(" "),
        args.out.display(),
        list(args.ratios.iter().map(f64::to_string).collect()),
        list(args.efforts.iter().map(u8::to_string).collect())
    );
    if args.recipes == Recipes::Own {
        text += " --recipes own";
    }
    if let Some(count) = args.smartsplat_images {
        text += &format!(" --smartsplat-images {count}");
    }
    if !args.backends.is_empty() {
        text +=
            &format!(" --backends {}", list(args.backends.iter().map(|&b| cells::backend_name(b).into()).collect()));
    }
    if let Some(path) = &args.anchors {
        text += &format!(" --anchors {}", path.display());
    }
    if args.codecs == Codecs::None {
        text += " --codecs none";
    }
    if let Some(path) = &args.stability {
        text += &format!(" --stability {}", path.display());
    }
    text
}

/// Columns of the CSV, keys of a cell's values.
const COLUMNS: [&str; 19] = [
    "image",
    "width",
    "height",
    "ratio_asked",
    "effort",
    "recipe",
    "backend",
    "device",
    "bytes",
    "primitives",
    "psnr",
    "ssim",
    "ms_ssim",
    "ssimulacra2",
    "butteraugli",
    "seconds",
    "decode_ms_full",
    "decode_ms_region",
    "decode_ms_thumbnail",
];

fn csv(cells: &[Cell]) -> String {
    let mut text = COLUMNS.join(",") + "\n";
    for cell in cells.iter().filter(|c| c.failed().is_none()) {
        let value = |key: &&str| match &cell.values[*key] {
            Value::String(s) => format!("\"{s}\""),
            Value::Number(n) if n.is_f64() => {
                let text = format!("{:.5}", n.as_f64().unwrap_or(f64::NAN));
                text.trim_end_matches('0').trim_end_matches('.').into()
            }
            other => other.to_string(),
        };
        text += &(COLUMNS.iter().map(value).collect::<Vec<_>>().join(",") + "\n");
    }
    text
}

fn as_json(cells: &[Cell], anchors: &[Anchor], stability: &[Row], left_out: &[Needless]) -> Value {
    let anchors: Vec<Value> = anchors
        .iter()
        .map(|a| {
            json!({
                "image": a.image, "codec": a.codec, "bytes": a.bytes, "psnr": a.psnr, "ssim": a.ssim,
                "ms_ssim": a.ms_ssim, "ssimulacra2": a.ssimulacra2, "butteraugli": a.butteraugli, "encode_seconds": a.encode_seconds, "decode_seconds": a.decode_seconds,
                "setting": a.setting,
            })
        })
        .collect();
    let stability: Vec<Value> = stability
        .iter()
        .map(|r| json!({ "group": r.group, "case": r.case, "worst": r.worst, "guard": r.guard, "holds": r.holds() }))
        .collect();
    json!({
        "version": env!("CARGO_PKG_VERSION"),
        "encodes": cells.iter().map(|c| &c.values).collect::<Vec<_>>(),
        "anchors": anchors,
        "stability": stability,
        "left_out": left_out.iter().map(Needless::as_json).collect::<Vec<_>>(),
    })
}
