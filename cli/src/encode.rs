//! `ssplat encode`: a picture to a file, with progress, and what it measured.

use std::fs::File;
use std::io::Read;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use image::ImageFormat;
use serde_json::{Value, json};
use ssplat::SamplesMut;
use ssplat::report::StageTime;
use ssplat::unstable::EncodeOptions;
use ssplat::unstable::bitstream::splats::Metadata;
use ssplat::{EncodeReport, Encoded, Encoder, Error, Limits, PixelSource, Pixels, Samples, Target};

use crate::batch::{self, Command, Done, OutputMode, Show};
use crate::failure::Failure;
use crate::input::{self, Input};
use crate::progress::{Bar, Stages};
use crate::rows::{Format, RowWriter, Shape};
use crate::sink::{Sink, printable, say, tell};
use crate::source::{self, Source, Turn};
use crate::spool::{self, Opened, Spooled};
use crate::{args, carried, compare, left_out};

/// Extensions of picture formats that `image` does not know or that are not read.
const OTHERS: [&str; 5] = ["heic", "heif", "jxl", "jp2", "svg"];

pub fn run(args: &args::Encode) -> Result<(), Failure> {
    let output_mode = OutputMode::new(args.json, args.quiet);
    if let Some(folder) = &args.many.out_dir {
        let command = Command {
            takes: &is_picture,
            extension: ssplat::EXTENSION,
            pixels: &pixels,
            run: &|input, output, show| one(args, input, output, show),
        };
        return batch::run(&args.paths, folder, &args.many, output_mode, &command);
    }
    // --tiles may stand alone: what follows it without = is taken for a path.
    let is_number = |path: &&PathBuf| {
        args.tiles.is_some() && !path.exists() && path.to_str().is_some_and(|p| p.parse::<u32>().is_ok())
    };
    if let Some(side) = args.paths.iter().find(is_number).map(|path| path.display()) {
        return Err(Failure::usage(format!(
            "{side}: taken for a path; the side of tiles follows =, as in --tiles={side}"
        )));
    }
    let (input, output) = args::pair(&args.paths, args.output.as_deref())?;
    if args.json && output == Path::new("-") {
        return Err(Failure::usage("--json and the file cannot both go to standard output"));
    }
    if !args.force && is_of_another_format(output) {
        let path = output.display();
        return Err(Failure::usage(format!(
            "{path}: has the extension of another format; --force writes it all the same"
        )));
    }
    let bar = Bar::of(output_mode);
    let done = one(args, input, output, &|share, stage| bar.show(share, stage))?;
    drop(bar);
    if output_mode != OutputMode::Quiet {
        done.notes.iter().for_each(|note| tell(&format!("{}: {note}", Failure::input(input))));
    }
    match output_mode {
        OutputMode::Text if output == Path::new("-") => eprint!("{}", printable(&done.text)),
        OutputMode::Text => say(&done.text)?,
        OutputMode::Json => say(&format!("{:#}\n", done.result))?,
        OutputMode::Quiet => {}
    }
    Ok(())
}

/// Whether a file of that name would be taken for a picture of another format.
fn is_of_another_format(path: &Path) -> bool {
    let extension = path.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase);
    extension.is_some_and(|e| ImageFormat::from_extension(&e).is_some() || OTHERS.contains(&e.as_str()))
}

/// Whether a file of a folder is taken for a picture: by its extension, or else by how it begins.
fn is_picture(path: &Path) -> bool {
    if ImageFormat::from_path(path).is_ok() || path.extension().is_some_and(|e| e == "pam") {
        return true;
    }
    let mut start = Vec::new();
    let read = File::open(path).and_then(|file| file.take(input::LONGEST_MAGIC).read_to_end(&mut start));
    read.is_ok() && image::guess_format(&start).is_ok()
}

/// Width times height of the picture at `path`; 0 where it cannot be told, as of a pipe, which can be read but once.
fn pixels(path: &Path) -> u64 {
    if !input::is_file(path) {
        return 0;
    }
    Input::open(path).map_or(0, |mut input| source::pixels(path, &mut input))
}

/// Fits that a target takes at most.
fn tries(target: Target) -> u32 {
    match target {
        Target::Psnr(_) | Target::Quality(_) => 3,
        _ => 1,
    }
}

/// Returns the rest of a time budget that began at `start`, so that reading counts as work. It is at least a
/// millisecond, so that a file is always made.
fn left(time: Option<Duration>, start: Instant) -> Option<Duration> {
    time.map(|t| t.saturating_sub(start.elapsed()).max(Duration::from_millis(1)))
}

/// Encodes one file.
fn one(args: &args::Encode, input: &Path, output: &Path, show: &Show) -> Result<Done, Failure> {
    let start = Instant::now();
    show(0.0, "reading");
    if args.preview.as_deref() == Some(output) {
        return Err(Failure::usage(format!("{}: cannot hold both the file and its preview", output.display())));
    }
    let mut opened = Input::open(input)?;
    let length = opened.length().map_err(|e| Failure::io(input, &e))?;
    // A preview is compared with the whole picture, and turning needs it, too.
    let is_huge = source::pixels(input, &mut opened) > ssplat::unstable::MAX_WHOLE_PIXELS;
    let is_tiled = args.tiles.is_some() || is_huge;
    if is_tiled && args.preview.is_none() && !args.auto_orient {
        match spool::open(input, opened, args.time.and_then(|time| start.checked_add(time)))? {
            Opened::InParts(picture) => {
                let picture = Parts { picture: *picture, length, time: left(args.time, start) };
                return in_parts(args, input, output, show, picture);
            }
            Opened::AsWhole(input) => opened = input,
        }
    }
    let mut source = source::read(input, opened, if args.auto_orient { Turn::Upright } else { Turn::Keep })?;
    if args.partial && source.is_cut_off {
        source.notes.push("the file is cut off, and so is what is encoded".into());
    } else {
        source = source.whole(input)?;
    }
    let Source { pixels, icc, exif, orientation, mut notes, .. } = source;
    let mut options = args.options();
    carried::carry(&mut options, (icc, exif), orientation, &mut notes);
    let samples = u64::from(pixels.width()) * u64::from(pixels.height()) * pixels.channels().count() as u64;
    if let Target::Primitives(asked) = options.target
        && u64::from(asked) > samples
    {
        options.target = Target::Primitives(samples as u32);
        notes.push(format!("{asked} primitives are more than the picture has samples: {samples} are enough"));
    }
    // That a file cannot be written is found out before the work is done, not after.
    let sink = Sink::create(output, &[input])?;
    let preview = args.preview.as_deref().map(|path| Preview::prepare(path, input)).transpose()?;
    show(0.0, "preparing");
    let mut course = Stages::new(tries(options.target));
    options.time = left(options.time, start);
    let encoded = ssplat::unstable::encode_with_progress(&pixels, &options, &mut |p| {
        show(course.at(p.stage, p.done), p.stage);
        ControlFlow::Continue(())
    });
    let encoded = encoded.map_err(|e| refusal(input, &e))?;
    notes.extend(carried::dominating(&options, encoded.bytes.len()));
    notes.extend(missed(&options, &encoded.report));
    notes.extend(grown(encoded.bytes.len(), length));
    // Both files are there, or none is.
    sink.write(&encoded.bytes)?;
    let mut result = summary(&pixels, encoded.bytes.len(), &encoded.report);
    let mut text = told(output, &pixels, &encoded);
    if let Some(preview) = preview {
        let path = preview.path;
        let (found, seconds) = preview.finish(&encoded.bytes, &pixels)?;
        text += &format!("{}: {}, decoded in {seconds:.3} s\n", path.display(), compare::as_text(&found));
        result["preview"] = compare::as_json(&found);
        result["preview"]["seconds"] = seconds.into();
    }
    sink.finish()?;
    if args.explain {
        text += &explained(output, &encoded)?;
    }
    Ok(Done { text, result, notes })
}

/// A picture that stays in its file.
struct Parts {
    picture: Spooled,
    /// Bytes of the file.
    length: u64,
    time: Option<Duration>,
}

/// Encodes a picture that stays in its file.
fn in_parts(
    args: &args::Encode,
    input: &Path,
    output: &Path,
    show: &Show,
    Parts { mut picture, length, time }: Parts,
) -> Result<Done, Failure> {
    let mut options = args.options();
    options.time = time;
    let (icc, exif, mut notes) = (picture.icc.take(), picture.exif.take(), std::mem::take(&mut picture.notes));
    let orientation = source::orientation_in(exif.as_deref());
    carried::carry(&mut options, (icc, exif), orientation, &mut notes);
    let sink = Sink::create(output, &[input])?;
    let mut course = Stages::new(1);
    let encoded = Encoder::from(options.clone()).encode_with_progress(&picture, &mut |p| {
        show(course.at(p.stage, p.done), p.stage);
        ControlFlow::Continue(())
    });
    let encoded = encoded.map_err(|e| refusal(input, &e))?;
    notes.extend(carried::dominating(&options, encoded.bytes.len()));
    notes.extend(missed(&options, &encoded.report));
    notes.extend(grown(encoded.bytes.len(), length));
    sink.finish_with(&encoded.bytes)?;
    let mut text = told(output, &picture, &encoded);
    if args.explain {
        text += &explained(output, &encoded)?;
    }
    let result = summary(&picture, encoded.bytes.len(), &encoded.report);
    Ok(Done { text, result, notes })
}

/// Returns the failure of a picture that was not encoded, with advice.
fn refusal(input: &Path, error: &Error) -> Failure {
    let mut failure = Failure::library(input, error);
    failure.message += carried::advice(error);
    failure
}

/// Returns a note about a file that is larger than the input it was made of.
fn grown(bytes: usize, input: u64) -> Option<String> {
    let is_larger = bytes as u64 > input;
    is_larger.then(|| format!("the file has {bytes} bytes, more than the {input} of the picture that it was made of"))
}

/// Returns a note about a file that does not have the quality asked for.
fn missed(options: &EncodeOptions, report: &EncodeReport) -> Option<String> {
    // Files are within half a point where they can be.
    const CLOSE: f64 = 0.5;
    let within = options.time.map_or_else(String::new, |time| format!(" within {:.1} s", time.as_secs_f64()));
    match (options.target, report.quality) {
        (Target::Quality(asked), Some(found)) if (found - asked).abs() > CLOSE => {
            Some(format!("--quality {asked} was not met{within}: the file has {found:.1}"))
        }
        (Target::Psnr(asked), _) if report.psnr < asked => {
            Some(format!("--psnr {asked} was not met{within}: the file has {:.2} dB", report.psnr))
        }
        _ => None,
    }
}

/// A PSNR in words. That of the encoder is before rounding to code values: above some value all of these are equal.
fn psnr(psnr: f64) -> String {
    if psnr < compare::IDENTICAL { format!("PSNR {psnr:.2} dB") } else { "identical samples".into() }
}

/// The result in a line.
fn told(output: &Path, picture: &dyn PixelSource, encoded: &Encoded) -> String {
    let quality = encoded.report.quality.map_or(String::new(), |q| format!(", SSIMULACRA2 {q:.1}"));
    let line = format!(
        "{}: {} bytes, ratio {:.1}, {} primitive{}, {}{quality}, encoded in {:.2} s\n",
        output.display(),
        encoded.bytes.len(),
        ratio(picture, encoded.bytes.len()),
        encoded.report.primitives,
        if encoded.report.primitives == 1 { "" } else { "s" },
        psnr(encoded.report.psnr),
        encoded.report.seconds
    );
    // Where there is a choice, it is told.
    if cfg!(feature = "gpu") { line + &format!("fitted on {}\n", encoded.report.chosen) } else { line }
}

/// Where time and bytes went, and what the file does without.
fn explained(output: &Path, encoded: &Encoded) -> Result<String, Failure> {
    let mut text = explain(&encoded.report);
    let (splats, report) = ssplat::unstable::bitstream::inspect(&encoded.bytes, &Limits::default())
        .map_err(|e| Failure::library(output, &e))?;
    text += "not in the file:\n";
    text += &left_out::as_text(&left_out::of_file(&splats, &report));
    Ok(text)
}

/// Bytes of the samples with 8 bits each over bytes of the file.
fn ratio(pixels: &dyn PixelSource, bytes: usize) -> f64 {
    f64::from(pixels.width()) * f64::from(pixels.height()) * pixels.channels().count() as f64 / bytes as f64
}

/// The picture that `--preview` asks for.
struct Preview<'a> {
    path: &'a Path,
    format: Format,
    sink: Sink,
}

impl<'a> Preview<'a> {
    fn prepare(path: &'a Path, input: &Path) -> Result<Self, Failure> {
        Ok(Preview { path, format: Format::of_path(path)?, sink: Sink::create(path, &[input])? })
    }

    /// Decodes `bytes`, writes the pixels and compares them with `original`; also the seconds that decoding took.
    fn finish(self, bytes: &[u8], original: &Pixels) -> Result<(compare::Found, f64), Failure> {
        let start = Instant::now();
        let decoded = source::decode(self.path, bytes)?;
        let seconds = start.elapsed().as_secs_f64();
        let found = compare::measure(original, &decoded.pixels).map_err(|e| Failure::library(self.path, &e))?;
        write_pixels(decoded, self.format, &self.sink, self.path)?;
        self.sink.finish()?;
        Ok((found, seconds))
    }
}

/// Writes a whole picture.
pub fn write_pixels(source: Source, format: Format, sink: &Sink, path: &Path) -> Result<(), Failure> {
    let Source { pixels, icc, exif, .. } = source;
    let shape =
        Shape { width: pixels.width(), height: pixels.height(), channels: pixels.channels(), depth: pixels.depth() };
    let mut metadata = Metadata::default();
    (metadata.icc, metadata.exif) = (icc, exif);
    let io = |e| Failure::io(path, &e);
    let mut rows = RowWriter::new(sink, format, shape, &metadata).map_err(io)?;
    match &mut pixels.into_samples() {
        Samples::U8(samples) => rows.write(SamplesMut::U8(samples)).map_err(io)?,
        Samples::U16(samples) => rows.write(SamplesMut::U16(samples)).map_err(io)?,
    }
    rows.finish(path)
}

/// The result for programs.
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
        "primitives": report.primitives,
        "float_psnr": report.float_psnr.min(compare::IDENTICAL),
        "psnr": report.psnr.min(compare::IDENTICAL),
        "quality": report.quality,
        "seconds": report.seconds,
        "stages": stages,
        "left_out": left_out,
        "device": report.chosen.device,
        "device_reason": report.chosen.reason,
    })
}

/// Where the time and the bytes went.
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
