//! `ssplat encode`: pictures to .ssplat files, with progress and a report.

use std::fs::File;
use std::io::Read;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use image::ImageFormat;
use serde_json::{Value, json};
use ssplat::report::{SkipReason, StageTime};
use ssplat::unstable::EncodeOptions;
use ssplat::unstable::colour::Profiles;
use ssplat::{EncodeReport, Encoded, Encoder, Error, Limits, MetadataPolicy, PixelSource, Pixels, Target};

use crate::batch::{self, Command, Done, Fate, Report, Show};
use crate::failure::Failure;
use crate::input::{self, Input};
use crate::inputs::Task;
use crate::kept_times::KeptTimes;
use crate::progress::{Bar, OutputMode, Stages};
use crate::rows::Format;
use crate::sink::{Identity, Sink, aside, printable, say, tell};
use crate::sniff::sniff;
use crate::source::{self, Reading, Source, Turn};
use crate::spool::{self, Opened, Spooled};
use crate::written::write_pixels;
use crate::{args, carried, compare, drawing, left_out, limits, perceived, resize};

/// Extensions of other picture formats that `image` does not know.
const OTHERS: [&str; 5] = ["heic", "heif", "jxl", "jp2", "svg"];

pub fn run(args: &args::Encode) -> Result<(), Failure> {
    let output_mode = OutputMode::new(args.json, args.quiet);
    if let Some(folder) = &args.many.out_dir {
        let command = Command {
            takes: &is_picture,
            extension: ssplat::EXTENSION,
            pixels: &pixels,
            run: &|task, show| one(args, task, show, &|_| Ok(())),
        };
        return batch::run(&args.paths, folder, &args.many, output_mode, &command);
    }
    // --tiles takes its value after =, so a number that follows it is parsed as a path.
    let is_number = |path: &&PathBuf| {
        args.tiles.is_some() && !path.exists() && path.to_str().is_some_and(|p| p.parse::<u32>().is_ok())
    };
    if let Some(side) = args.paths.iter().find(is_number).map(|path| path.display()) {
        return Err(Failure::usage(format!(
            "{side}: treated as a path; to set the side of tiles, write --tiles={side}"
        )));
    }
    let (input, output) = args::pair(&args.paths, args.output.as_deref())?;
    if args.json && output == Path::new("-") {
        return Err(Failure::usage("--json and the file cannot both go to standard output"));
    }
    if !args.force && is_of_another_format(output) {
        let path = output.display();
        return Err(Failure::usage(format!("{path}: has the extension of another format; --force writes it anyway")));
    }
    let bar = Bar::of(output_mode);
    let task = Task::new(input.into(), output.into());
    // A report that cannot be written is a failure, which leaves no output.
    let report = |done: &Done| {
        let mut outcome = Ok(());
        bar.aside(|| {
            if output_mode != OutputMode::Quiet {
                done.notes.iter().for_each(|note| tell(&format!("{}: {note}", Failure::input(input))));
            }
            outcome = match output_mode {
                OutputMode::Text if output == Path::new("-") => {
                    aside(&printable(&done.text));
                    Ok(())
                }
                OutputMode::Text => say(&done.text),
                OutputMode::Json => say(&format!("{:#}\n", done.result)),
                OutputMode::Quiet => Ok(()),
            };
        });
        outcome
    };
    one(args, &task, &|share, stage| bar.show(share, stage), &report)?;
    Ok(())
}

/// Whether the path has the extension of another picture format.
fn is_of_another_format(path: &Path) -> bool {
    let extension = path.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase);
    extension.is_some_and(|e| ImageFormat::from_extension(&e).is_some() || OTHERS.contains(&e.as_str()))
}

/// Whether a file of a folder is a picture: by its extension, or else by its first bytes.
fn is_picture(path: &Path) -> bool {
    if ImageFormat::from_path(path).is_ok() || path.extension().is_some_and(|e| e == "pam") {
        return true;
    }
    let mut start = Vec::new();
    let read = File::open(path).and_then(|file| file.take(input::LONGEST_MAGIC).read_to_end(&mut start));
    // Formats that are not read count as well: their files fail with advice instead of being skipped.
    read.is_ok() && (image::guess_format(&start).is_ok() || sniff(&start).is_some())
}

/// Returns width times height of the picture at `path`, or 0 if they are unknown, as for a pipe, which can be read only
/// once.
fn pixels(path: &Path) -> u64 {
    if !input::is_file(path) {
        return 0;
    }
    let size = Input::open(path).ok().and_then(|mut input| source::size(path, &mut input));
    size.map_or(0, area)
}

/// Width times height.
fn area([width, height]: [u32; 2]) -> u64 {
    u64::from(width) * u64::from(height)
}

/// Returns the number of fits that a target may take, for the progress bar.
fn tries(target: Target) -> u32 {
    match target {
        Target::Psnr(_) => 3,
        _ => 1,
    }
}

/// Returns the rest of a time limit that started at `start`, so that reading the input counts. It is at least a
/// millisecond, so that there is always a file.
fn left(time: Option<Duration>, start: Instant) -> Option<Duration> {
    time.map(|t| t.saturating_sub(start.elapsed()).max(Duration::from_millis(1)))
}

/// Encodes one file.
fn one(args: &args::Encode, task: &Task, show: &Show, report: &Report) -> Result<Done, Failure> {
    let (input, output) = (task.input.as_path(), task.output.as_path());
    let start = Instant::now();
    show(0.0, "reading");
    let is_output = |preview: &Path| {
        preview == output || Identity::of(preview).is_some_and(|one| Identity::of(output) == Some(one))
    };
    if args.preview.as_deref().is_some_and(is_output) {
        return Err(Failure::usage(format!("{}: cannot hold both the file and its preview", output.display())));
    }
    let times = KeptTimes::of(args.keep_times, task)?;
    let mut opened = Input::open(input)?;
    let origin = Origin {
        length: opened.length().map_err(|e| Failure::io(input, &e))?,
        times,
        size: source::size(input, &mut opened),
    };
    let source = match load(args, input, opened, &origin, args.time.and_then(|time| start.checked_add(time)))? {
        Loaded::InParts(picture) => {
            let picture = Parts { picture: *picture, origin, time: left(args.time, start) };
            return in_parts(args, task, (show, report), picture);
        }
        Loaded::Whole(source) => source,
    };
    let Source { pixels, cicp, icc, exif, orientation, mut notes, .. } = source;
    let mut options = args.options();
    carried::carry(&mut options, (cicp, icc), exif, orientation, &mut notes);
    let samples = u64::from(pixels.width()) * u64::from(pixels.height()) * pixels.channels().count() as u64;
    if let Target::Gaussians(asked) = options.target
        && u64::from(asked) > samples
    {
        options.target = Target::Gaussians(samples as u32);
        notes.push(format!("{asked} Gaussians are more than the samples of the picture; {samples} are enough"));
    }
    // Detects an output that cannot be written before the work is done.
    let sink = args.sink(output, &[input])?;
    let preview = args.preview.as_deref().map(|path| Preview::prepare(path, input)).transpose()?;
    show(0.0, "preparing");
    let mut stages = Stages::new(tries(options.target));
    options.time = left(options.time, start);
    let encoded = ssplat::unstable::encode_with_progress(&pixels, &options, &mut |p| {
        show(stages.at(p.stage, p.done), p.stage);
        ControlFlow::Continue(())
    });
    let mut encoded = encoded.map_err(|e| refusal(input, &e))?;
    if encoded.report.quality.is_none() && matches!(options.target, Target::Quality(_)) {
        // The encoder measures no picture of one colour.
        let decoded = source::decode(output, &encoded.bytes)?;
        encoded.report.quality = perceived::measure(&pixels, &decoded.pixels).ssimulacra2;
    }
    notes.extend(carried::dominating(&options, encoded.bytes.len()));
    notes.extend(differing(&options, &encoded.report));
    // Near colours keep lines sharp.
    if !encoded.report.skipped.iter().any(|skipped| skipped.what == SkipReason::NearColors) {
        notes.extend(drawing::note(&pixels, encoded.bytes.len(), encoded.report.psnr));
    }
    let mut done = finished(args, output, &origin, &pixels, &encoded);
    done.notes.splice(0..0, notes);
    if done.fate == Fate::LargerThanInput {
        report(&done)?;
        return Ok(done);
    }
    // Either both files are written, or none.
    sink.write(&encoded.bytes)?;
    let mut finished = None;
    if let Some(preview) = preview {
        let path = preview.path;
        let (found, seconds) = preview.write(&encoded.bytes, &pixels, &mut done.notes)?;
        finished = Some(preview.sink);
        done.text += &format!("{}: {}, decoded in {seconds:.3} s\n", path.display(), compare::as_text(&found));
        done.result["preview"] = compare::as_json(&found);
        done.result["preview"]["seconds"] = seconds.into();
    }
    if args.explain {
        done.text += &explained(output, &encoded)?;
    }
    report(&done)?;
    finished.map_or(Ok(()), Sink::finish)?;
    origin.times.finish(sink)?;
    Ok(done)
}

/// Facts about an input file.
struct Origin {
    /// Bytes of the file.
    length: u64,
    /// Size of the picture, if it is known before decoding.
    size: Option<[u32; 2]>,
    times: KeptTimes,
}

/// A picture that is in memory, or is read from its file part by part.
enum Loaded {
    Whole(Source),
    InParts(Box<Spooled>),
}

/// Reads the picture into memory, or opens it for reading in parts, before `end`; resizes and rotates it as `args` say.
fn load(
    args: &args::Encode,
    path: &Path,
    mut opened: Input,
    origin: &Origin,
    end: Option<Instant>,
) -> Result<Loaded, Failure> {
    // Downscaling in linear light needs the profile.
    let is_profile_used = args.metadata != MetadataPolicy::None || args.max_side.is_some();
    let reading = Reading {
        turn: if args.auto_orient { Turn::Upright } else { Turn::Keep },
        profiles: if is_profile_used { Profiles::Read } else { Profiles::Ignore },
        max_side: args.max_side,
        hidden: args.options().hidden,
    };
    let is_huge = |size: [u32; 2]| area(size) > ssplat::unstable::MAX_WHOLE_PIXELS;
    let fitted = |size| resize::fitted(size, args.max_side);
    let is_resized = origin.size.is_some_and(|size| fitted(size) != size);
    // A preview is compared with the whole picture, and rotation needs it as well.
    let stays_in_parts = !is_resized && args.preview.is_none() && !args.auto_orient;
    let is_tiled = args.tiles.is_some() && stays_in_parts;
    if is_tiled || origin.size.is_some_and(is_huge) && (is_resized || stays_in_parts) {
        match spool::open(path, opened, end, reading.profiles)? {
            Opened::InParts(picture) if is_resized => {
                let size = fitted(picture.size());
                let source = picture.resized(path, size, args.options().hidden)?;
                return Ok(Loaded::Whole(if args.auto_orient { source.upright(path)? } else { source }));
            }
            Opened::InParts(picture) if picture.width().max(picture.height()) > limits::MAX_SIDE => {
                return Err(limits::too_long(path, picture.size()));
            }
            Opened::InParts(picture) => return Ok(Loaded::InParts(picture)),
            Opened::AsWhole(input) => opened = input,
        }
    }
    let mut source = source::read(path, opened, &reading)?;
    if args.partial && source.is_cut_off {
        source.notes.push("the file is cut off, so the encoded picture is incomplete".into());
    } else {
        source = source.whole(path)?;
    }
    let size = source.pixels.size();
    if fitted(size) != size {
        source = source.resized(path, fitted(size), args.options().hidden)?;
    }
    Ok(Loaded::Whole(source))
}

/// Returns the report of an encode, and decides whether its file is written.
fn finished(args: &args::Encode, output: &Path, origin: &Origin, picture: &dyn PixelSource, encoded: &Encoded) -> Done {
    let (bytes, input) = (encoded.bytes.len() as u64, origin.length);
    let fate = if args.skip_larger && bytes > input { Fate::LargerThanInput } else { Fate::Written };
    let mut result = summary(picture, encoded.bytes.len(), &encoded.report);
    result["input_bytes"] = input.into();
    result["written"] = (fate == Fate::Written).into();
    let mut notes = Vec::new();
    let text = match fate {
        Fate::LargerThanInput => {
            notes.push(format!("no file is written: it would have {bytes} bytes, more than the input ({input} bytes)"));
            String::new()
        }
        Fate::Written => {
            if bytes > input {
                notes.push(format!("the file has {bytes} bytes, more than the input ({input} bytes)"));
            }
            result_line(output, picture, encoded)
        }
    };
    Done { text, result, notes, fate }
}

/// A picture that is read from its file part by part.
struct Parts {
    picture: Spooled,
    origin: Origin,
    time: Option<Duration>,
}

/// Encodes a picture that is read from its file part by part.
fn in_parts(
    args: &args::Encode,
    task: &Task,
    (show, report): (&Show, &Report),
    Parts { mut picture, origin, time }: Parts,
) -> Result<Done, Failure> {
    let (input, output) = (task.input.as_path(), task.output.as_path());
    let mut options = args.options();
    options.time = time;
    let (icc, exif, mut notes) = (picture.icc.take(), picture.exif.take(), std::mem::take(&mut picture.notes));
    let orientation = source::orientation_in(exif.as_deref());
    carried::carry(&mut options, (picture.cicp, icc), exif, orientation, &mut notes);
    let sink = args.sink(output, &[input])?;
    let mut stages = Stages::new(1);
    let encoded = Encoder::from(options.clone()).encode_with_progress(&picture, &mut |p| {
        show(stages.at(p.stage, p.done), p.stage);
        ControlFlow::Continue(())
    });
    let encoded = encoded.map_err(|e| refusal(input, &e))?;
    notes.extend(carried::dominating(&options, encoded.bytes.len()));
    notes.extend(differing(&options, &encoded.report));
    let mut done = finished(args, output, &origin, &picture, &encoded);
    done.notes.splice(0..0, notes);
    if done.fate == Fate::LargerThanInput {
        report(&done)?;
        return Ok(done);
    }
    sink.write(&encoded.bytes)?;
    if args.explain {
        done.text += &explained(output, &encoded)?;
    }
    report(&done)?;
    origin.times.finish(sink)?;
    Ok(done)
}

/// Converts an error of the encoder, and adds advice.
fn refusal(input: &Path, error: &Error) -> Failure {
    let mut failure = Failure::library(input, error);
    failure.message += carried::advice(error);
    failure
}

/// Returns a note if the file does not have the requested quality, or has a higher one.
fn differing(options: &EncodeOptions, report: &EncodeReport) -> Option<String> {
    // The encoder meets a quality within half a point if it can.
    const CLOSE: f64 = 0.5;
    let within = options.time.map_or_else(String::new, |time| format!(" within {:.1} s", time.as_secs_f64()));
    let is_lossless = report.skipped.iter().any(|skipped| skipped.what == SkipReason::Loss);
    match (options.target, report.quality) {
        (Target::Quality(asked), Some(_)) if is_lossless => {
            Some(format!("--quality {asked} is met without loss: no smaller file was found{within}"))
        }
        (Target::Quality(asked), Some(found)) if found > asked + CLOSE => {
            Some(format!("--quality {asked} is met: the smallest file that was found{within} has {found:.1}"))
        }
        (Target::Quality(asked), Some(found)) if found < asked - CLOSE => {
            Some(format!("--quality {asked} was not met{within}: the file has {found:.1}"))
        }
        (Target::Psnr(asked), _) if report.psnr < asked => {
            Some(format!("--psnr {asked} was not met{within}: the file has {:.2} dB", report.psnr))
        }
        _ => None,
    }
}

/// Formats a PSNR. The encoder measures before rounding to code values; above a certain PSNR, all code values are
/// equal.
fn psnr(psnr: f64) -> String {
    if psnr < compare::IDENTICAL { format!("PSNR {psnr:.2} dB") } else { "identical samples".into() }
}

/// Returns the result in one line.
fn result_line(output: &Path, picture: &dyn PixelSource, encoded: &Encoded) -> String {
    // The library mirrors small pictures before it measures them.
    let how = if picture.width().min(picture.height()) < 64 { " (mirrored to 64 pixels)" } else { "" };
    let quality = encoded.report.quality.map_or(String::new(), |q| format!(", SSIMULACRA2 {q:.1}{how}"));
    let line = format!(
        "{}: {} bytes, ratio {:.1}, {} Gaussian{}, {}{quality}, encoded in {:.2} s at effort {}\n",
        output.display(),
        encoded.bytes.len(),
        ratio(picture, encoded.bytes.len()),
        encoded.report.gaussians,
        if encoded.report.gaussians == 1 { "" } else { "s" },
        psnr(encoded.report.psnr),
        encoded.report.seconds,
        encoded.report.effort
    );
    // Only a build with GPU support has a choice of devices.
    if cfg!(feature = "gpu") { line + &format!("fitted on {}\n", encoded.report.chosen) } else { line }
}

/// Returns the text of `--explain`: stages with their times, and what was left out.
fn explained(output: &Path, encoded: &Encoded) -> Result<String, Failure> {
    let mut text = explain(&encoded.report);
    let (splats, report) = ssplat::unstable::bitstream::inspect(&encoded.bytes, &Limits::default())
        .map_err(|e| Failure::library(output, &e))?;
    text += "not in the file:\n";
    text += &left_out::as_text(&left_out::of_file(&splats, &report));
    Ok(text)
}

/// Returns the number of samples over the bytes of the file.
fn ratio(pixels: &dyn PixelSource, bytes: usize) -> f64 {
    f64::from(pixels.width()) * f64::from(pixels.height()) * pixels.channels().count() as f64 / bytes as f64
}

/// The output of `--preview`.
struct Preview<'a> {
    path: &'a Path,
    format: Format,
    sink: Sink,
}

impl<'a> Preview<'a> {
    fn prepare(path: &'a Path, input: &Path) -> Result<Self, Failure> {
        Ok(Preview { path, format: Format::of_path(path)?, sink: Sink::create(path, &[input])? })
    }

    /// Decodes `bytes`, writes the pixels, and compares them with `original`. Returns the metrics and the decoding time
    /// in seconds.
    fn write(
        &self,
        bytes: &[u8],
        original: &Pixels,
        notes: &mut Vec<String>,
    ) -> Result<(compare::Found, f64), Failure> {
        let start = Instant::now();
        let decoded = source::decode(self.path, bytes)?;
        let seconds = start.elapsed().as_secs_f64();
        let found = compare::measure(original, &decoded.pixels).map_err(|e| Failure::library(self.path, &e))?;
        notes.extend(write_pixels(decoded, self.format, &self.sink, self.path)?);
        Ok((found, seconds))
    }
}

/// Returns the result as JSON.
fn summary(pixels: &dyn PixelSource, bytes: usize, report: &EncodeReport) -> Value {
    let stages: Vec<Value> = report.stages.iter().map(|s| json!({ "name": s.name, "seconds": s.seconds })).collect();
    let left_out: Vec<Value> = report
        .skipped
        .iter()
        .map(|l| json!({ "what": l.what.to_string(), "bytes_saved": l.bytes, "seconds_saved": l.seconds }))
        .collect();
    json!({
        "width": pixels.width(),
        "height": pixels.height(),
        "bytes": bytes,
        "ratio": ratio(pixels, bytes),
        "gaussians": report.gaussians,
        "float_psnr": report.float_psnr.min(compare::IDENTICAL),
        "psnr": report.psnr.min(compare::IDENTICAL),
        "quality": report.quality,
        "effort": report.effort,
        "seconds": report.seconds,
        "stages": stages,
        "left_out": left_out,
        "device": report.chosen.device,
        "device_reason": report.chosen.reason,
    })
}

/// Returns the stages with their times, and what the encoder left out.
fn explain(report: &EncodeReport) -> String {
    let mut text = String::from("stages:\n");
    for &StageTime { name, seconds, .. } in &report.stages {
        text += &format!("  {name:<24} {seconds:8.2} s\n");
    }
    if !report.skipped.is_empty() {
        text += "left out:\n";
    }
    for l in &report.skipped {
        let bytes = if l.bytes > 0 { format!(" {} bytes", l.bytes) } else { String::new() };
        let seconds = if l.seconds > 0.0 { format!(" {:.2} s", l.seconds) } else { String::new() };
        let saved = [bytes, seconds].concat();
        text += &format!("  {}{}{saved}\n", l.what, if saved.is_empty() { "" } else { ": saves" });
    }
    text
}
