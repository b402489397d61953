//! Many files in one run: several small ones at a time, one bar, and a manifest.

use std::collections::HashMap;
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

use serde_json::{Value, json};

use crate::args::{Existing, Many};
use crate::failure::{Failure, Kind};
use crate::inputs::{self, Found, Rules, Task};
use crate::progress::Bar;
use crate::sink::{say, tell};
use crate::{carried, guard};

/// Pixels up to which a picture is small: it is worked on with one thread, beside others.
const MAX_SMALL_PIXELS: u64 = 1 << 22;

/// Result of the work on one file.
pub struct Done {
    /// For people; empty, or whole lines.
    pub text: String,
    /// For programs.
    pub result: Value,
    /// Losses and the like, in words.
    pub notes: Vec<String>,
}

/// Hears of the share of a file that is done, and by which stage.
pub type Show<'a> = dyn Fn(f32, &'static str) + 'a;

/// From an input to an output.
pub type Work<'a> = dyn Fn(&Path, &Path, &Show) -> Result<Done, Failure> + Sync + 'a;

/// How a command treats one file.
pub struct Command<'a> {
    /// Which files of a folder are taken.
    pub takes: &'a (dyn Fn(&Path) -> bool + Sync),
    /// The extension of an output.
    pub extension: &'a str,
    /// Width times height, 0 where it is not known.
    pub pixels: &'a (dyn Fn(&Path) -> u64 + Sync),
    /// Does the work; hears of the share that is done.
    pub run: &'a Work<'a>,
}

/// Kind of output that is printed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OutputMode {
    Text,
    Json,
    Quiet,
}

impl OutputMode {
    pub fn new(json: bool, quiet: bool) -> OutputMode {
        match (json, quiet) {
            (true, _) => OutputMode::Json,
            (_, true) => OutputMode::Quiet,
            _ => OutputMode::Text,
        }
    }
}

/// Works on all inputs. What fails is told, and does not stop the others.
pub fn run(
    inputs: &[PathBuf],
    folder: &Path,
    many: &Many,
    output_mode: OutputMode,
    command: &Command,
) -> Result<(), Failure> {
    let rules = Rules { takes: command.takes, extension: command.extension, is_recursive: many.recursive };
    let Found { tasks, notes } = inputs::find(inputs, folder, &rules)?;
    if output_mode != OutputMode::Quiet {
        notes.iter().for_each(|note| tell(note));
    }
    // That there can be no outputs at all is told once.
    std::fs::create_dir_all(folder).map_err(|e| Failure::io(folder, &e))?;
    let manifest = many.manifest.as_deref().map(Manifest::open).transpose()?;
    let all = tasks.len();
    let waiting = tasks.into_iter().filter(|t| many.existing() != Existing::Skip || !t.output.exists());
    let (small, large): (Vec<Task>, Vec<Task>) = waiting.partition(|t| (command.pixels)(&t.input) <= MAX_SMALL_PIXELS);
    let threads = rayon::current_num_threads();
    let jobs = many.jobs.map_or(threads, |n| n.get().min(crate::most_threads())).min(small.len()).max(1);
    let total = small.len() + large.len();
    let bar = Bar::of(output_mode);
    let run_state = BatchRun { command, many, output_mode, manifest, total, state: Mutex::default(), bar };
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
    let state = run_state.state.into_inner().unwrap_or_else(|e| e.into_inner());
    if state.exif_left_out > 0 {
        tell(&carried::exif_of_files(state.exif_left_out));
    }
    if output_mode == OutputMode::Text {
        let (done, failed) = (state.finished - state.failed.len(), state.failed.len());
        say(&format!("{done} files done, {} skipped, {failed} failed\n", all - total))?;
    }
    match state.failed[..] {
        [] => Ok(()),
        [first, ..] => {
            // Failures of several kinds have no status of their own.
            let kind = if state.failed.iter().all(|&k| k == first) { first } else { Kind::Other };
            Err(Failure { kind, message: format!("{} of {all} files failed", state.failed.len()) })
        }
    }
}

/// State shared by all threads of a batch.
struct BatchRun<'a> {
    command: &'a Command<'a>,
    many: &'a Many,
    output_mode: OutputMode,
    manifest: Option<Manifest>,
    total: usize,
    state: Mutex<BatchState>,
    bar: Bar,
}

/// State of the files of a batch.
#[derive(Default)]
struct BatchState {
    finished: usize,
    failed: Vec<Kind>,
    /// Files whose EXIF blocks are left out.
    exif_left_out: usize,
    /// When each began, and its share that is done.
    busy: HashMap<PathBuf, (Option<Instant>, f32)>,
}

impl BatchRun<'_> {
    fn work(&self, task: &Task) {
        let start = Instant::now();
        self.post(&task.input, start, 0.0);
        let run = || (self.command.run)(&task.input, &task.output, &|share, _| self.post(&task.input, start, share));
        // A bug that one file brings to light is no reason to leave the others.
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
        self.bar.aside(|| match &outcome {
            Ok(done) => {
                if self.output_mode != OutputMode::Quiet {
                    let (common, own): (Vec<&String>, _) =
                        done.notes.iter().partition(|note| carried::is_of_exif(note));
                    state.exif_left_out += common.len();
                    own.iter().for_each(|note| tell(&format!("{input}: {note}")));
                }
                // A reader who has gone away does not stop the work.
                let _ = match self.output_mode {
                    OutputMode::Text => say(&done.text),
                    OutputMode::Json => say(&format!("{entry}\n")),
                    OutputMode::Quiet => Ok(()),
                };
            }
            Err(failure) => tell(&failure.message),
        });
        state.failed.extend(outcome.err().map(|f| f.kind));
    }

    /// Checks that the output may be written, and makes its folder.
    fn prepare(&self, task: &Task) -> Result<(), Failure> {
        if self.many.existing() == Existing::Refuse && task.output.exists() {
            let path = task.output.display();
            return Err(Failure::usage(format!("{path}: exists; --overwrite replaces it, --skip-existing keeps it")));
        }
        let folder = task.output.parent().unwrap_or(Path::new("."));
        std::fs::create_dir_all(folder).map_err(|e| Failure::io(folder, &e))
    }

    /// Shows how far all are, and what has been worked on for longest.
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

/// A file of one JSON object a line; what is in it already stays.
struct Manifest {
    path: PathBuf,
    file: Mutex<File>,
}

impl Manifest {
    fn open(path: &Path) -> Result<Manifest, Failure> {
        let file = File::options().create(true).append(true).open(path).map_err(|e| Failure::io(path, &e))?;
        Ok(Manifest { path: path.into(), file: Mutex::new(file) })
    }

    /// Adds a line in one piece.
    fn add(&self, entry: &Value) -> Result<(), Failure> {
        let mut file = self.file.lock().unwrap_or_else(|e| e.into_inner());
        file.write_all(format!("{entry}\n").as_bytes()).map_err(|e| Failure::io(&self.path, &e))
    }
}
