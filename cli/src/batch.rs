//! Batches: many files in one run, several small ones at a time, with one progress bar and a manifest.

use std::collections::HashMap;
use std::fs::File;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use image::ImageFormat;
use serde_json::{Value, json};

use crate::args::{Existing, Many};
use crate::failure::{Failure, Kind};
use crate::inputs::{self, Found, Rules, Task};
use crate::progress::{Bar, OutputMode};
use crate::sink::{say, tell};
use crate::{carried, guard, sink};

/// Pictures of up to this many pixels are small: each is processed on one thread, in parallel with others.
const MAX_SMALL_PIXELS: u64 = 1 << 22;

/// Whether an output was written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fate {
    Written,
    /// Not written, because of `--skip-larger`.
    LargerThanInput,
}

/// Result of the work on one file.
pub struct Done {
    /// Text output; empty, or whole lines.
    pub text: String,
    /// JSON output.
    pub result: Value,
    /// Notes about losses and other remarkable facts.
    pub notes: Vec<String>,
    pub fate: Fate,
}

/// Receives the progress of a file: the share that is done, and the stage.
pub type Show<'a> = dyn Fn(f32, &'static str) + 'a;

/// Prints the result of a file just before its output gets its name, so that a failure leaves no output.
pub type Report<'a> = dyn Fn(&Done) -> Result<(), Failure> + 'a;

/// Processes an input into an output.
pub type Work<'a> = dyn Fn(&Task, &Show) -> Result<Done, Failure> + Sync + 'a;

/// What a command does with each file.
pub struct Command<'a> {
    /// Whether a file of a folder is an input.
    pub takes: &'a (dyn Fn(&Path) -> bool + Sync),
    /// The extension of the outputs.
    pub extension: &'a str,
    /// Width times height, or 0 if it is unknown.
    pub pixels: &'a (dyn Fn(&Path) -> u64 + Sync),
    /// Processes one file and reports progress.
    pub run: &'a Work<'a>,
}

/// Processes all inputs. A failure is reported and does not stop the other files.
pub fn run(
    inputs: &[PathBuf],
    folder: &Path,
    many: &Many,
    output_mode: OutputMode,
    command: &Command,
) -> Result<(), Failure> {
    check_folder(inputs, folder)?;
    let rules = Rules { takes: command.takes, extension: command.extension, is_recursive: many.recursive };
    let Found { tasks, notes } = inputs::find(inputs, folder, &rules)?;
    check_outputs(&tasks, many)?;
    if output_mode != OutputMode::Quiet {
        notes.iter().for_each(|note| tell(note));
    }
    let manifest = many.manifest.as_deref().map(Manifest::check).transpose()?;
    // A folder that cannot be created is reported once, not for every file.
    std::fs::create_dir_all(folder).map_err(|e| Failure::io(folder, &e))?;
    let manifest = manifest.map(Manifest::open).transpose()?;
    let all = tasks.len();
    let is_waiting = |task: &Task| match many.existing() {
        Existing::Skip => !task.output.exists(),
        Existing::Update => !is_up_to_date(task),
        Existing::Refuse | Existing::Replace => true,
    };
    let waiting = tasks.into_iter().filter(is_waiting);
    let (small, large): (Vec<Task>, Vec<Task>) = waiting.partition(|t| (command.pixels)(&t.input) <= MAX_SMALL_PIXELS);
    let threads = rayon::current_num_threads();
    let jobs = many.jobs.map_or(threads, |n| n.get().min(crate::most_threads())).min(small.len()).max(1);
    let total = small.len() + large.len();
    let bar = Bar::of(output_mode);
    let start = Instant::now();
    let run_state = BatchRun { command, many, output_mode, manifest, total, start, state: Mutex::default(), bar };
    run_state.tell_on_interrupt(&BatchState::default());
    let next = AtomicUsize::new(0);
    let of_small = || {
        let work = || {
            while let Some(task) = small.get(next.fetch_add(1, Ordering::Relaxed)) {
                run_state.work(task);
            }
        };
        match rayon::ThreadPoolBuilder::new().num_threads((threads / jobs).max(1)).build() {
            Ok(pool) => pool.install(work),
            Err(_) => work(),
        }
    };
    std::thread::scope(|scope| (0..jobs).for_each(|_| drop(scope.spawn(of_small))));
    large.iter().for_each(|task| run_state.work(task));
    drop(run_state.bar);
    sink::on_interrupt(String::new());
    let state = run_state.state.into_inner().unwrap_or_else(|e| e.into_inner());
    if state.exif_left_out > 0 {
        tell(&carried::exif_of_files(state.exif_left_out));
    }
    if output_mode == OutputMode::Text {
        let (larger, failed) = (state.larger, state.failed.len());
        let (done, skipped) = (state.finished - larger - failed, all - total + larger);
        let of_them = if larger > 0 { format!(" ({larger} larger than the input)") } else { String::new() };
        let totals = totals(state.bytes, start.elapsed());
        say(&format!("{done} files done, {skipped} skipped{of_them}, {failed} failed{totals}\n"))?;
    }
    match state.failed[..] {
        [] => Ok(()),
        [first, ..] => {
            // There is no exit status for failures of several kinds.
            let kind = if state.failed.iter().all(|&k| k == first) { first } else { Kind::Other };
            Err(Failure { kind, message: format!("{} of {all} files failed", state.failed.len()) })
        }
    }
}

/// Whether the output of a task exists and is no older than the input.
fn is_up_to_date(task: &Task) -> bool {
    let time = |path: &Path| std::fs::metadata(path).and_then(|found| found.modified()).ok();
    match (time(&task.input), time(&task.output)) {
        (Some(input), Some(output)) => output >= input,
        _ => false,
    }
}

/// Returns the end of a line about `read` bytes of inputs, `written` bytes of outputs, and the time that they took.
fn totals([read, written]: [u64; 2], time: Duration) -> String {
    if written == 0 {
        return String::new();
    }
    let seconds = time.as_secs();
    let time = match (seconds / 3600, seconds / 60) {
        (0, 0) => format!("{:.1} s", time.as_secs_f64()),
        (0, minutes) => format!("{minutes} min {} s", seconds % 60),
        (hours, minutes) => format!("{hours} h {} min", minutes % 60),
    };
    let share = 100.0 * written as f64 / read.max(1) as f64;
    format!("; {} became {} ({share:.1} %) in {time}", size(read), size(written))
}

/// Returns a number of bytes with a unit.
fn size(bytes: u64) -> String {
    match bytes as f64 {
        b if b < 1e4 => format!("{bytes} bytes"),
        b if b < 1e6 => format!("{:.0} kB", b / 1e3),
        b if b < 1e9 => format!("{:.1} MB", b / 1e6),
        b => format!("{:.1} GB", b / 1e9),
    }
}

/// Checks that `folder` is meant as the folder of the outputs, before it is created.
fn check_folder(inputs: &[PathBuf], folder: &Path) -> Result<(), Failure> {
    // `-dash.png` is a name that looks like the option -d and its value.
    let is_picture =
        ImageFormat::from_path(folder).is_ok() || folder.extension().is_some_and(|e| e == ssplat::EXTENSION);
    let glued = format!("-d{}", folder.display());
    if is_picture && !folder.is_dir() && std::env::args_os().any(|arg| arg == *glued) {
        return Err(Failure::usage(format!(
            "{glued}: is taken for the option -d; write ./{glued} for a file of this name"
        )));
    }
    let missing = |path: &PathBuf| path != Path::new("-") && path.symlink_metadata().is_err();
    match inputs {
        [first, ..] if inputs.iter().all(missing) => {
            let e = std::fs::metadata(first).err().unwrap_or_else(|| std::io::ErrorKind::NotFound.into());
            Err(Failure::io(first, &e))
        }
        _ => Ok(()),
    }
}

/// Checks that no output is the input of another task, or the output of another task under another name, and that the
/// manifest is none of them.
fn check_outputs(tasks: &[Task], many: &Many) -> Result<(), Failure> {
    let identity = |path: &Path| sink::Identity::of(path);
    let inputs: HashMap<_, &Path> =
        tasks.iter().filter_map(|task| Some((identity(&task.input)?, task.input.as_path()))).collect();
    let mut outputs: HashMap<_, &Path> = HashMap::new();
    for Task { input, output, .. } in tasks {
        let Some(found) = identity(output) else { continue };
        if let Some(other) = inputs.get(&found).filter(|&other| other != input) {
            let (output, other) = (output.display(), other.display());
            return Err(Failure::usage(format!("{output}: is the input {other}; it is not overwritten")));
        }
        if let Some(other) = outputs.insert(found, output) {
            let (output, other) = (output.display(), other.display());
            return Err(Failure::usage(format!("{output} and {other}: are the same file, through a link")));
        }
    }
    let Some(manifest) = &many.manifest else { return Ok(()) };
    let refused =
        |what: &str| Err(Failure::usage(format!("{}: is {what}, and cannot be the manifest", manifest.display())));
    let found = identity(manifest);
    let is_same = |path: &Path| path == manifest || found.is_some() && identity(path) == found;
    if tasks.iter().any(|task| is_same(&task.input)) {
        return refused("an input");
    }
    // An output that does not exist yet has no identity.
    let place = |path: &Path| Some(std::fs::canonicalize(path.parent()?).ok()?.join(path.file_name()?));
    let own = place(&std::path::absolute(manifest).unwrap_or_else(|_| manifest.clone()));
    let is_there =
        |path: &Path| own.is_some() && place(&std::path::absolute(path).unwrap_or_else(|_| path.to_path_buf())) == own;
    if tasks.iter().any(|task| is_same(&task.output) || is_there(&task.output)) {
        return refused("an output");
    }
    Ok(())
}

/// State shared by all threads of a batch.
struct BatchRun<'a> {
    command: &'a Command<'a>,
    many: &'a Many,
    output_mode: OutputMode,
    manifest: Option<Manifest>,
    total: usize,
    start: Instant,
    state: Mutex<BatchState>,
    bar: Bar,
}

/// State of the files of a batch.
#[derive(Default)]
struct BatchState {
    finished: usize,
    failed: Vec<Kind>,
    /// Bytes of the inputs and of the outputs of files that were written.
    bytes: [u64; 2],
    /// Files that were not written because they would have been larger than their inputs.
    larger: usize,
    /// Files whose EXIF blocks are left out.
    exif_left_out: usize,
    /// Start time and progress of each file that is being processed.
    busy: HashMap<PathBuf, (Option<Instant>, f32)>,
}

impl BatchRun<'_> {
    fn work(&self, task: &Task) {
        let start = Instant::now();
        self.post(&task.input, start, 0.0);
        let run = || (self.command.run)(task, &|share, _| self.post(&task.input, start, share));
        // A bug that one file triggers must not stop the other files.
        let guarded = || guard::aloud(run).unwrap_or_else(|panic| Err(Failure::bug(&task.input, &panic)));
        let outcome = self.prepare(task).and_then(|()| guarded());
        let (input, output) = (task.input.display().to_string(), task.output.display().to_string());
        let entry = match &outcome {
            Ok(done) => json!({ "input": input, "output": output, "result": done.result }),
            Err(failure) => json!({ "input": input, "output": output, "error": failure.message }),
        };
        let written = self.manifest.as_ref().map_or(Ok(()), |m| m.add(&entry));
        let mut state = self.state.lock().unwrap_or_else(|e| e.into_inner());
        state.busy.remove(&task.input);
        state.finished += 1;
        let outcome = outcome.and_then(|done| written.map(|()| done));
        if outcome.as_ref().is_ok_and(|done| done.fate == Fate::Written) {
            let length = |path: &Path| std::fs::metadata(path).map_or(0, |found| found.len());
            state.bytes = [state.bytes[0] + length(&task.input), state.bytes[1] + length(&task.output)];
        }
        self.bar.aside(|| match &outcome {
            Ok(done) => {
                state.larger += usize::from(done.fate == Fate::LargerThanInput);
                if self.output_mode != OutputMode::Quiet {
                    let (common, own): (Vec<&String>, _) =
                        done.notes.iter().partition(|note| carried::is_of_exif(note));
                    state.exif_left_out += common.len();
                    own.iter().for_each(|note| tell(&format!("{input}: {note}")));
                }
                // A closed standard output does not stop the batch.
                let _ = match self.output_mode {
                    OutputMode::Text => say(&done.text),
                    OutputMode::Json => say(&format!("{entry}\n")),
                    OutputMode::Quiet => Ok(()),
                };
            }
            Err(failure) => tell(&failure.message),
        });
        state.failed.extend(outcome.err().map(|f| f.kind));
        self.tell_on_interrupt(&state);
    }

    /// Sets what is told if the batch is interrupted.
    fn tell_on_interrupt(&self, state: &BatchState) {
        let done = state.finished - state.failed.len();
        let failed = if state.failed.is_empty() { String::new() } else { format!(", {} failed", state.failed.len()) };
        let totals = totals(state.bytes, self.start.elapsed());
        let total = self.total;
        sink::on_interrupt(format!("{done} of {total} files done{failed}{totals}; --skip-existing goes on from here"));
    }

    /// Checks that the output may be written, and creates its folder.
    fn prepare(&self, task: &Task) -> Result<(), Failure> {
        if self.many.existing() == Existing::Refuse && task.output.exists() {
            let path = task.output.display();
            return Err(Failure::usage(format!(
                "{path}: exists; --overwrite replaces it, --skip-existing keeps it, --update replaces it if it is older"
            )));
        }
        let folder = task.output.parent().unwrap_or(Path::new("."));
        std::fs::create_dir_all(folder).map_err(|e| Failure::io(folder, &e))
    }

    /// Shows the progress of the batch and the name of the file that has been in progress for longest.
    fn post(&self, path: &Path, start: Instant, share: f32) {
        let mut state = self.state.lock().unwrap_or_else(|e| e.into_inner());
        state.busy.insert(path.to_path_buf(), (Some(start), share));
        let sum: f32 = state.busy.values().map(|b| b.1).sum();
        let slowest = state.busy.iter().min_by_key(|(_, b)| b.0).map(|(path, _)| path.as_path()).unwrap_or(path);
        let name = slowest.file_name().unwrap_or_default().to_string_lossy();
        let message = format!("{}/{} {name}", state.finished, self.total);
        self.bar.show((state.finished as f32 + sum) / self.total as f32, message);
    }
}

/// A file with one JSON object per line. Entries are appended to an existing file.
struct Manifest {
    path: PathBuf,
    file: Mutex<File>,
}

impl Manifest {
    /// Returns `path` if it is no file, an empty one, or a manifest.
    fn check(path: &Path) -> Result<&Path, Failure> {
        let io = |e| Failure::io(path, &e);
        let mut first = Vec::new();
        if std::fs::metadata(path).is_ok_and(|found| found.is_file()) {
            File::open(path).map_err(io)?.take(1).read_to_end(&mut first).map_err(io)?;
        }
        if !matches!(first[..], [] | [b'{']) {
            let message = "has other contents than lines of JSON, and cannot be the manifest";
            return Err(Failure::usage(format!("{}: {message}", path.display())));
        }
        Ok(path)
    }

    fn open(path: &Path) -> Result<Manifest, Failure> {
        let file = File::options().create(true).append(true).open(path).map_err(|e| Failure::io(path, &e))?;
        Ok(Manifest { path: path.into(), file: Mutex::new(file) })
    }

    /// Appends a line with a single write.
    fn add(&self, entry: &Value) -> Result<(), Failure> {
        let mut file = self.file.lock().unwrap_or_else(|e| e.into_inner());
        file.write_all(format!("{entry}\n").as_bytes()).map_err(|e| Failure::io(&self.path, &e))
    }
}
