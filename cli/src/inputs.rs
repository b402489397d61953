//! Maps inputs to outputs: files and folders become tasks, each with its own output.

use std::collections::{HashMap, HashSet};
use std::ffi::OsString;
use std::fs::{File, FileTimes};
use std::io::Read;
use std::path::{Path, PathBuf};

use crate::failure::Failure;
use crate::sniff::APPLE_DOUBLE;

/// An input and its output.
#[derive(Debug)]
pub struct Task {
    pub input: PathBuf,
    pub output: PathBuf,
    /// The times of the input before it is read; reading may change its access time.
    pub times: Option<FileTimes>,
}

impl Task {
    pub fn new(input: PathBuf, output: PathBuf) -> Task {
        let times = std::fs::metadata(&input).ok().and_then(|found| {
            let times = FileTimes::new().set_modified(found.modified().ok()?);
            // Some file systems have no access times.
            Some(found.accessed().map_or(times, |accessed| times.set_accessed(accessed)))
        });
        Task { input, output, times }
    }
}

/// Tasks found in the inputs.
#[derive(Debug, Default)]
pub struct Found {
    pub tasks: Vec<Task>,
    /// Notes about files and folders that are skipped.
    pub notes: Vec<String>,
}

/// Selects the files of folders, and names outputs.
pub struct Rules<'a> {
    pub takes: &'a (dyn Fn(&Path) -> bool + Sync),
    /// The extension of the outputs.
    pub extension: &'a str,
    /// Whether subfolders are included.
    pub is_recursive: bool,
}

/// How the file system of the outputs compares names.
#[derive(Debug, Clone, Copy)]
enum Names {
    Exactly,
    /// `A.ssplat` and `a.ssplat` are the same file, as usual on Windows and macOS.
    IgnoringCase,
}

impl Names {
    fn of_this_system() -> Names {
        if cfg!(any(windows, target_vendor = "apple")) { Names::IgnoringCase } else { Names::Exactly }
    }

    /// Returns a key that is equal for two outputs that are the same file.
    fn key(self, output: &Path) -> OsString {
        match self {
            Names::Exactly => output.as_os_str().to_owned(),
            Names::IgnoringCase => output.to_string_lossy().to_lowercase().into(),
        }
    }
}

/// Number of problems or names that are listed; of further ones only the number is reported.
const MAX_LISTED: usize = 10;

/// Returns a task for each file of `inputs`, with its output in `folder`. An output has the name of its input with
/// another extension. If several outputs would have the same name, each keeps the extension of its input before the new
/// one.
pub fn find(inputs: &[PathBuf], folder: &Path, rules: &Rules) -> Result<Found, Failure> {
    find_on(Names::of_this_system(), inputs, folder, rules)
}

/// [`find`] for a file system that compares names in this way.
fn find_on(names: Names, inputs: &[PathBuf], folder: &Path, rules: &Rules) -> Result<Found, Failure> {
    let mut named = Vec::new();
    let mut skipped = Skipped::default();
    let mut problems = Vec::new();
    for input in inputs {
        let mut files = Vec::new();
        if input == Path::new("-") {
            problems.push("standard input cannot be one of several inputs".to_owned());
        } else if input.is_dir() {
            list(input, Path::new(""), rules, &mut files, &mut skipped)?;
            files.sort();
        } else {
            files.push((input.clone(), PathBuf::from(input.file_name().unwrap_or(input.as_os_str()))));
        }
        named.extend(files);
    }
    let outputs = outputs(&named, rules.extension, names);
    let mut taken: HashMap<OsString, &Path> = HashMap::new();
    let mut seen = HashSet::new();
    for ((input, _), output) in named.iter().zip(&outputs) {
        if !seen.insert(input) {
            problems.push(format!("{}: is named twice", input.display()));
            continue;
        }
        if let Some(other) = taken.insert(names.key(output), input) {
            problems.push(format!(
                "{} and {} would both be written to {}; encode them to separate folders",
                other.display(),
                input.display(),
                folder.join(output).display()
            ));
        }
    }
    if !problems.is_empty() {
        let more = problems.len().saturating_sub(MAX_LISTED);
        problems.truncate(MAX_LISTED);
        if more > 0 {
            problems.push(format!("and {more} more problems of this kind"));
        }
        return Err(Failure::usage(problems.join("\nssplat: ")));
    }
    let tasks = named.into_iter().zip(outputs);
    let tasks = tasks.map(|((input, _), output)| Task::new(input, folder.join(output))).collect();
    Ok(Found { tasks, notes: skipped.notes() })
}

/// Returns the output of each named file: with the extension replaced, or appended if the replaced name is shared.
fn outputs(named: &[(PathBuf, PathBuf)], extension: &str, names: Names) -> Vec<PathBuf> {
    let short = |name: &Path| name.with_extension(extension);
    let long = |name: &Path| {
        let mut whole = OsString::from(name.as_os_str());
        whole.push(".");
        whole.push(extension);
        PathBuf::from(whole)
    };
    let mut outputs: Vec<PathBuf> = named.iter().map(|(_, name)| short(name)).collect();
    // A long name may equal another file's short one: `a.gif` and `a.gif.png` may both become `a.gif.ssplat`.
    loop {
        let keys: Vec<OsString> = outputs.iter().map(|output| names.key(output)).collect();
        let mut times: HashMap<&OsString, usize> = HashMap::new();
        keys.iter().for_each(|key| *times.entry(key).or_default() += 1);
        let is_shared: Vec<bool> = keys.iter().map(|key| times[key] > 1).collect();
        let mut has_changed = false;
        for ((output, (_, name)), is_shared) in outputs.iter_mut().zip(named).zip(is_shared) {
            if is_shared && *output != long(name) {
                *output = long(name);
                has_changed = true;
            }
        }
        if !has_changed {
            return outputs;
        }
    }
}

/// Files and folders that are skipped in folders.
#[derive(Default)]
struct Skipped {
    files: Vec<PathBuf>,
    folders: Vec<PathBuf>,
}

impl Skipped {
    fn notes(&self) -> Vec<String> {
        let of = |paths: &[PathBuf], what: &str, why: &str| {
            (!paths.is_empty()).then(|| format!("{} {what} passed over{why}: {}", paths.len(), first_of(paths)))
        };
        let files = if self.files.len() == 1 { "file is" } else { "files are" };
        let folders = if self.folders.len() == 1 { "folder is" } else { "folders are" };
        let files = of(&self.files, files, "");
        files.into_iter().chain(of(&self.folders, folders, ", which --recursive takes")).collect()
    }
}

/// Returns a list of the first paths.
fn first_of(paths: &[PathBuf]) -> String {
    let mut names: Vec<String> = paths.iter().take(MAX_LISTED).map(|path| path.display().to_string()).collect();
    if paths.len() > MAX_LISTED {
        names.push("…".into());
    }
    names.join(", ")
}

/// Adds the selected files of `folder`, each with its path relative to the input folder.
fn list(
    folder: &Path,
    below: &Path,
    rules: &Rules,
    files: &mut Vec<(PathBuf, PathBuf)>,
    skipped: &mut Skipped,
) -> Result<(), Failure> {
    let io = |e| Failure::io(folder, &e);
    let mut entries = std::fs::read_dir(folder).map_err(io)?.collect::<Result<Vec<_>, _>>().map_err(io)?;
    entries.sort_by_key(std::fs::DirEntry::file_name);
    for entry in entries {
        let (path, name) = (entry.path(), below.join(entry.file_name()));
        // Links to folders are not followed, because they may form a cycle.
        if entry.file_type().map_err(io)?.is_dir() {
            match rules.is_recursive {
                true => list(&path, &name, rules, files, skipped)?,
                false => skipped.folders.push(path),
            }
        } else if std::fs::metadata(&path).is_ok_and(|found| !found.is_file()) {
            // Pipes and devices may be endless, and links to folders are not followed.
            skipped.files.push(path);
        } else if is_apple_double(&path) {
            if !entry.file_name().as_encoded_bytes().starts_with(b".") {
                skipped.files.push(path);
            }
        } else if (rules.takes)(&path) {
            files.push((path, name));
        } else if !entry.file_name().as_encoded_bytes().starts_with(b".") {
            skipped.files.push(path);
        }
    }
    Ok(())
}

/// Whether a file holds the attributes of another file, as macOS writes them beside it on foreign file systems: by its
/// name or its first bytes.
fn is_apple_double(path: &Path) -> bool {
    let is_named = path.file_name().is_some_and(|name| name.as_encoded_bytes().starts_with(b"._"));
    let starts = || {
        let mut start = [0; 4];
        File::open(path).and_then(|mut file| file.read_exact(&mut start)).is_ok_and(|()| start == *APPLE_DOUBLE)
    };
    is_named || starts()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(inputs: &[&str]) -> Vec<String> {
        on(Names::Exactly, inputs)
    }

    fn on(names: Names, inputs: &[&str]) -> Vec<String> {
        let named: Vec<_> = inputs.iter().map(|n| (Path::new("in").join(n), PathBuf::from(n))).collect();
        outputs(&named, "ssplat", names).iter().map(|o| o.display().to_string()).collect()
    }

    #[test]
    fn files_of_one_stem_keep_their_extension_and_others_do_not() {
        assert_eq!(of(&["a.png", "b.v2.png", "c"]), ["a.ssplat", "b.v2.ssplat", "c.ssplat"]);
        assert_eq!(
            of(&["anim.gif", "anim.webp", "x/anim.gif"]),
            ["anim.gif.ssplat", "anim.webp.ssplat", "x/anim.ssplat"]
        );
        assert_eq!(of(&["IMG_1.JPG", "IMG_1.png", "IMG_1"]), ["IMG_1.JPG.ssplat", "IMG_1.png.ssplat", "IMG_1.ssplat"]);
    }

    #[test]
    fn a_longer_name_that_is_taken_gets_longer_too() {
        assert_eq!(of(&["a.gif", "a.png", "a.gif.png"]), ["a.gif.ssplat", "a.png.ssplat", "a.gif.png.ssplat"]);
    }

    #[test]
    fn outputs_that_differ_in_case_alone_are_one_file_where_the_system_says_so() {
        assert_eq!(of(&["A.png", "a.jpg"]), ["A.ssplat", "a.ssplat"]);
        assert_eq!(on(Names::IgnoringCase, &["A.png", "a.jpg", "É.png"]), ["A.png.ssplat", "a.jpg.ssplat", "É.ssplat"]);
        let rules = Rules { takes: &|_| true, extension: "ssplat", is_recursive: false };
        let inputs = ["x/A.png", "y/a.png"].map(PathBuf::from);
        let found = |names| find_on(names, &inputs, Path::new("out"), &rules);
        assert_eq!(found(Names::Exactly).unwrap().tasks.len(), 2);
        let refused = found(Names::IgnoringCase).unwrap_err().message;
        assert!(refused.contains("x/A.png and y/a.png would both be written to"), "{refused}");
    }
}
