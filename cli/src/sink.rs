//! Writes output files: under a temporary name in the same folder, renamed when complete, so that incomplete files are
//! never visible, and an interrupted run leaves nothing behind.

use std::borrow::Cow;
use std::fs::{File, FileTimes};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
#[cfg(unix)]
use std::sync::Arc;
use std::sync::Mutex;

use tempfile::NamedTempFile;

use crate::failure::{Failure, Kind};

/// Temporary files that an interrupt must remove.
static UNFINISHED: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

/// What is told after an interrupt: what was done before.
static DONE: Mutex<String> = Mutex::new(String::new());

/// Sets what is told after an interrupt.
pub fn on_interrupt(done: String) {
    *DONE.lock().unwrap_or_else(|e| e.into_inner()) = done;
}

/// Exit status after an interrupt: that of shells for SIGINT.
const INTERRUPTED: i32 = 130;

/// Removes unfinished files and exits.
fn interrupted() -> ! {
    // The lock is held until the exit, so that no file is renamed or created meanwhile.
    let unfinished = UNFINISHED.lock().unwrap_or_else(|e| e.into_inner());
    for path in unfinished.iter() {
        let _ = std::fs::remove_file(path);
    }
    match DONE.lock().unwrap_or_else(|e| e.into_inner()).as_str() {
        "" => tell("interrupted"),
        done => tell(&format!("interrupted: {done}")),
    }
    std::process::exit(INTERRUPTED);
}

/// Installs a handler for the signals that end a program (Ctrl-C and Ctrl-\\, SIGTERM, SIGHUP) that removes unfinished
/// files and exits. A file that exceeds the limit of its size becomes an error of writing instead of a signal.
#[cfg(unix)]
pub fn remove_on_interrupt() -> Result<(), Failure> {
    use signal_hook::consts::{SIGHUP, SIGINT, SIGQUIT, SIGTERM, SIGXFSZ};
    let failed = |e: io::Error| Failure { kind: Kind::Other, message: format!("signal handler: {e}") };
    // A signal that is handled no longer ends the program, and writing returns EFBIG.
    signal_hook::flag::register(SIGXFSZ, Arc::default()).map_err(failed)?;
    let mut signals = signal_hook::iterator::Signals::new([SIGHUP, SIGINT, SIGQUIT, SIGTERM]).map_err(failed)?;
    let wait = move || {
        if signals.forever().next().is_some() {
            interrupted();
        }
    };
    std::thread::Builder::new().name("signals".into()).spawn(wait).map_err(failed)?;
    Ok(())
}

/// Installs a handler for Ctrl-C that removes unfinished files and exits.
#[cfg(not(unix))]
pub fn remove_on_interrupt() -> Result<(), Failure> {
    ctrlc::set_handler(|| interrupted())
        .map_err(|e| Failure { kind: Kind::Other, message: format!("signal handler: {e}") })
}

/// Prints a message on standard error, with the name of the program.
pub fn tell(message: &str) {
    aside(&format!("ssplat: {}\n", printable(message)));
}

/// Prints `text` on standard error, if that is possible.
pub fn aside(text: &str) {
    let _ = io::stderr().lock().write_all(text.as_bytes());
}

/// What happens to an output that exists and is read-only.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ReadOnly {
    Keep,
    Replace,
}

/// What identifies a file, whatever its paths and links.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Identity(#[cfg(unix)] (u64, u64), #[cfg(not(unix))] PathBuf);

impl Identity {
    /// Returns the identity of the file at `path`, or of standard input for `-`; `None` if there is none.
    pub fn of(path: &Path) -> Option<Identity> {
        if path == Path::new("-") { Identity::of_standard_input() } else { Identity::of_file(path) }
    }

    #[cfg(unix)]
    fn of_file(path: &Path) -> Option<Identity> {
        std::fs::metadata(path).ok().and_then(|found| Identity::from_metadata(&found))
    }

    /// Devices and pipes have no identity, because writing to them replaces nothing.
    #[cfg(unix)]
    fn from_metadata(found: &std::fs::Metadata) -> Option<Identity> {
        use std::os::unix::fs::MetadataExt;
        found.is_file().then(|| Identity((found.dev(), found.ino())))
    }

    #[cfg(unix)]
    fn of_standard_input() -> Option<Identity> {
        use std::os::fd::AsFd;
        let file = File::from(io::stdin().as_fd().try_clone_to_owned().ok()?);
        Identity::from_metadata(&file.metadata().ok()?)
    }

    #[cfg(not(unix))]
    fn of_file(path: &Path) -> Option<Identity> {
        std::fs::canonicalize(path).ok().map(Identity)
    }

    #[cfg(not(unix))]
    fn of_standard_input() -> Option<Identity> {
        None
    }
}

/// Escapes control characters for a terminal, because file names, profiles and errors of decoders contain untrusted
/// text.
pub fn printable(text: &str) -> Cow<'_, str> {
    let is_control = |c: char| c.is_control() && !matches!(c, '\n' | '\t');
    if !text.contains(is_control) {
        return text.into();
    }
    text.chars().map(|c| if is_control(c) { c.escape_default().to_string() } else { c.to_string() }).collect()
}

/// Prints `text` on standard output. A closed pipe is not a failure.
pub fn say(text: &str) -> Result<(), Failure> {
    let mut out = io::stdout().lock();
    match out.write_all(printable(text).as_bytes()).and_then(|()| out.flush()) {
        Err(e) if e.kind() != io::ErrorKind::BrokenPipe => Err(Failure::io(&named(Path::new("-")), &e)),
        _ => Ok(()),
    }
}

/// A file being written.
pub struct Sink {
    path: PathBuf,
    out: Out,
}

enum Out {
    /// Becomes `target` when finished.
    Temporary {
        file: NamedTempFile,
        target: PathBuf,
    },
    /// A device or a pipe, which cannot be renamed over.
    Special(File),
    Stdout,
}

impl Sink {
    /// Creates the output for `path`, or for standard output if that is `-`. It must not replace any of `inputs`, nor a
    /// read-only file.
    pub fn create(path: &Path, inputs: &[&Path]) -> Result<Sink, Failure> {
        Sink::replacing(path, inputs, ReadOnly::Keep)
    }

    /// As [`create`](Sink::create), with a choice for read-only files.
    pub fn replacing(path: &Path, inputs: &[&Path], read_only: ReadOnly) -> Result<Sink, Failure> {
        let path_buf = named(path);
        if path == Path::new("-") {
            return Ok(Sink { path: path_buf, out: Out::Stdout });
        }
        if cfg!(windows) && is_device_with_extension(path) {
            return Err(Failure::usage(format!("{}: Windows reserves this name for a device", path.display())));
        }
        let io = |e: io::Error| Failure::io(path, &e);
        let target = match std::fs::metadata(path) {
            Ok(m) if m.is_dir() => {
                return Err(Failure::usage(format!("{}: is a folder; name it with --out-dir", path.display())));
            }
            Ok(m) if !m.is_file() => {
                let file = File::options().write(true).open(path).map_err(io)?;
                return Ok(Sink { path: path_buf, out: Out::Special(file) });
            }
            // The target of a link is replaced, not the link.
            Ok(_) => std::fs::canonicalize(path).map_err(io)?,
            Err(e) if e.kind() == io::ErrorKind::NotFound => followed(path).map_err(io)?,
            Err(e) => return Err(io(e)),
        };
        let there = std::fs::metadata(&target).ok();
        let identity = Identity::of(&target);
        if identity.is_some() && inputs.iter().any(|input| Identity::of(input) == identity) {
            return Err(Failure::usage(format!("{}: is the input; it is not overwritten", path.display())));
        }
        if read_only == ReadOnly::Keep && there.as_ref().is_some_and(|there| there.permissions().readonly()) {
            let message = format!("{}: is read-only; make it writable, or use --overwrite", path.display());
            return Err(Failure { kind: Kind::Io, message });
        }
        let folder = match target.parent() {
            Some(folder) if !folder.as_os_str().is_empty() => folder,
            _ => Path::new("."),
        };
        let mut unfinished = UNFINISHED.lock().unwrap_or_else(|e| e.into_inner());
        let file = temporary().tempfile_in(folder).map_err(|e| io(plain(&e, folder)))?;
        // The new file gets the permissions of the old one.
        if let Some(there) = there {
            file.as_file().set_permissions(there.permissions()).map_err(io)?;
        }
        unfinished.push(file.path().to_path_buf());
        Ok(Sink { path: path_buf, out: Out::Temporary { file, target } })
    }

    /// The path for messages.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns a writer. All writers of a sink continue where the last one stopped.
    pub fn writer(&self) -> io::Result<Box<dyn Write>> {
        Ok(match &self.out {
            Out::Temporary { file, .. } => Box::new(file.as_file().try_clone()?),
            Out::Special(file) => Box::new(file.try_clone()?),
            Out::Stdout => Box::new(io::stdout()),
        })
    }

    /// Writes `bytes`.
    pub fn write(&self, bytes: &[u8]) -> Result<(), Failure> {
        let written = self.writer().and_then(|mut w| w.write_all(bytes).and_then(|()| w.flush()));
        written.map_err(|e| Failure::io(&self.path, &e))
    }

    /// Gives the file these times. Call it after the last write; devices and pipes keep their own times.
    pub fn set_times(&self, times: FileTimes) -> Result<(), Failure> {
        match &self.out {
            Out::Temporary { file, .. } => file.as_file().set_times(times).map_err(|e| Failure::io(&self.path, &e)),
            Out::Special(_) | Out::Stdout => Ok(()),
        }
    }

    /// Writes `bytes` as the whole file and renames it to its final name.
    pub fn finish_with(self, bytes: &[u8]) -> Result<(), Failure> {
        self.write(bytes)?;
        self.finish()
    }

    /// Renames the complete file to its final name.
    pub fn finish(self) -> Result<(), Failure> {
        let Out::Temporary { file, target } = self.out else { return Ok(()) };
        let mut unfinished = UNFINISHED.lock().unwrap_or_else(|e| e.into_inner());
        unfinished.retain(|p| p != file.path());
        put(file, &target).map_err(|e| Failure::io(&self.path, &e))
    }
}

/// Closes `file` and renames it to `target`; removes it if that fails. Unlike `NamedTempFile::persist`, the standard
/// library's rename also replaces a file on Windows that another program has open.
fn put(file: NamedTempFile, target: &Path) -> io::Result<()> {
    let path = file.into_temp_path().keep().map_err(|e| e.error)?;
    std::fs::rename(&path, target).inspect_err(|_| drop(std::fs::remove_file(&path)))
}

/// Whether `path` has an extension, and Windows still treats it as a device: `aux.png`, `con.ssplat`. Output written to
/// it would be lost. `NUL` and `CON` without an extension are intentional.
fn is_device_with_extension(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let Some((stem, _)) = name.split_once('.') else { return false };
    let stem = stem.trim_end().to_ascii_uppercase();
    let numbered =
        |port| stem.strip_prefix(port).is_some_and(|n| n.chars().count() == 1 && "0123456789¹²³".contains(n));
    ["CON", "PRN", "AUX", "NUL", "CONIN$", "CONOUT$"].contains(&&*stem) || numbered("COM") || numbered("LPT")
}

/// Returns the path of an output for messages.
pub fn named(path: &Path) -> PathBuf {
    if path == Path::new("-") { "standard output".into() } else { path.to_path_buf() }
}

/// Largest number of links that are followed one after another, as on Linux.
const MAX_LINKS: usize = 40;

/// Resolves links at `path`, where no file exists: a link may point to a file that does not exist yet.
fn followed(path: &Path) -> io::Result<PathBuf> {
    let mut target = path.to_path_buf();
    for _ in 0..MAX_LINKS {
        match std::fs::read_link(&target) {
            Ok(next) => target = target.parent().unwrap_or(Path::new("")).join(next),
            Err(_) => return Ok(target),
        }
    }
    Err(io::Error::other("too many links"))
}

/// Returns the reason why no file can be created in `folder`, without the name of the temporary file.
fn plain(e: &io::Error, folder: &Path) -> io::Error {
    std::fs::metadata(folder).err().unwrap_or_else(|| e.kind().into())
}

/// Returns a builder of temporary files with the permissions of an ordinary new file.
#[cfg(unix)]
fn temporary() -> tempfile::Builder<'static, 'static> {
    use std::os::unix::fs::PermissionsExt;
    let mut builder = tempfile::Builder::new();
    builder.prefix(".ssplat-").permissions(std::fs::Permissions::from_mode(0o666));
    builder
}

/// Returns a builder of temporary files.
#[cfg(not(unix))]
fn temporary() -> tempfile::Builder<'static, 'static> {
    let mut builder = tempfile::Builder::new();
    builder.prefix(".ssplat-");
    builder
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_that_windows_reserves_are_detected() {
        for name in ["aux.png", "AUX.tar.png", "x/con.ssplat", "nul .png", "Com1.png", "lpt\u{b9}.png", "CONOUT$.ppm"] {
            assert!(is_device_with_extension(Path::new(name)), "{name}");
        }
        for name in
            ["NUL", "con", "auxiliary.png", "x.aux", "com.png", "com10.png", "nul/x.png", "coma.png", ".aux", "-"]
        {
            assert!(!is_device_with_extension(Path::new(name)), "{name}");
        }
    }

    #[test]
    fn a_file_that_is_open_elsewhere_is_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        std::fs::write(&path, "old").unwrap();
        let mut open = File::open(&path).unwrap();
        Sink::create(&path, &[]).unwrap().finish_with(b"new").unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"new");
        let mut old = String::new();
        io::Read::read_to_string(&mut open, &mut old).unwrap();
        assert_eq!(old, "old", "a reader of the old file is not disturbed");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn a_temporary_file_that_cannot_be_renamed_is_removed() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        let sink = Sink::create(&path, &[]).unwrap();
        // Meanwhile, a folder of that name appears.
        std::fs::create_dir(&path).unwrap();
        std::fs::write(path.join("inside"), "").unwrap();
        assert_eq!(sink.finish_with(b"new").unwrap_err().kind, Kind::Io);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}
