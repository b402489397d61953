//! `--keep-times`: gives an output the modification and access times of its input.

use std::fs::FileTimes;
use std::path::Path;

use crate::failure::{Failure, Kind};
use crate::inputs::Task;
use crate::sink::Sink;

/// The times that an output gets, if any.
#[derive(Debug, Clone, Copy)]
pub struct KeptTimes(Option<FileTimes>);

impl KeptTimes {
    /// Returns the times of the input if `--keep-times` is given.
    ///
    /// # Errors
    /// A usage error if the input or the output is `-`, which has no times.
    pub fn of(is_asked: bool, task: &Task) -> Result<KeptTimes, Failure> {
        if !is_asked {
            return Ok(KeptTimes(None));
        }
        for (path, name) in [(&task.input, "standard input"), (&task.output, "standard output")] {
            if path == Path::new("-") {
                return Err(Failure::usage(format!("--keep-times: {name} has no times")));
            }
        }
        if task.times.is_none() {
            // Reports a missing file as such.
            std::fs::metadata(&task.input).map_err(|e| Failure::io(&task.input, &e))?;
            return Err(Failure {
                kind: Kind::Io,
                message: format!("{}: has no modification time", task.input.display()),
            });
        }
        Ok(KeptTimes(task.times))
    }

    /// Sets the times of the complete file in `sink`, and renames it to its final name.
    pub fn finish(self, sink: Sink) -> Result<(), Failure> {
        if let Some(times) = self.0 {
            sink.set_times(times)?;
        }
        sink.finish()
    }
}
