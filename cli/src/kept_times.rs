//! `--keep-times`: the modification and access times of an input, for its output.

use std::fs::FileTimes;
use std::path::Path;

use crate::failure::Failure;
use crate::sink::Sink;

/// The times that an output gets.
#[derive(Debug, Clone, Copy)]
pub struct KeptTimes(Option<FileTimes>);

impl KeptTimes {
    /// Reads the times of `input`, if `--keep-times` asks for them. Call it before the input is opened, because reading a file may change
    /// its access time.
    ///
    /// # Errors
    /// A usage error if `input` or `output` is `-`, which has no times.
    pub fn read(is_asked: bool, input: &Path, output: &Path) -> Result<KeptTimes, Failure> {
        if !is_asked {
            return Ok(KeptTimes(None));
        }
        for (path, name) in [(input, "standard input"), (output, "standard output")] {
            if path == Path::new("-") {
                return Err(Failure::usage(format!("--keep-times: {name} has no times")));
            }
        }
        let io = |e| Failure::io(input, &e);
        let found = std::fs::metadata(input).map_err(io)?;
        let times = FileTimes::new().set_modified(found.modified().map_err(io)?);
        // Some file systems have no access times.
        Ok(KeptTimes(Some(found.accessed().map_or(times, |accessed| times.set_accessed(accessed)))))
    }

    /// Sets the times of the complete file in `sink`, and renames it to its final name.
    pub fn finish(self, sink: Sink) -> Result<(), Failure> {
        if let Some(times) = self.0 {
            sink.set_times(times)?;
        }
        sink.finish()
    }
}
