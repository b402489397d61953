//! The progress bar on standard error, if that is a terminal: how much of the work is done, and the remaining time.

use std::borrow::Cow;
use std::io::IsTerminal;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

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

/// Steps of the bar.
const STEPS: u64 = 1000;
/// The bar is redrawn at least this often, so that a long step does not look like a hang.
const TICK: Duration = Duration::from_millis(200);

/// A progress bar; hidden if standard error is not a terminal.
pub struct Bar {
    bar: ProgressBar,
    start: Instant,
}

impl Bar {
    #[expect(clippy::new_without_default, reason = "a bar that appears is not a default")]
    pub fn new() -> Bar {
        if !std::io::stderr().is_terminal() {
            return Bar::hidden();
        }
        let bar = Bar::on(ProgressDrawTarget::stderr_with_hz(10));
        bar.bar.enable_steady_tick(TICK);
        bar
    }

    /// Returns the bar for an output mode: a hidden one for [`OutputMode::Quiet`].
    pub fn of(output_mode: OutputMode) -> Bar {
        if output_mode == OutputMode::Quiet { Bar::hidden() } else { Bar::new() }
    }

    /// Returns a hidden bar.
    fn hidden() -> Bar {
        Bar::on(ProgressDrawTarget::hidden())
    }

    fn on(target: ProgressDrawTarget) -> Bar {
        let style = ProgressStyle::with_template("{prefix:<28} {wide_bar} {percent:>3} % {elapsed} {msg}");
        let style = style.expect("valid template");
        Bar { bar: ProgressBar::with_draw_target(Some(STEPS), target).with_style(style), start: Instant::now() }
    }

    /// Shows the current stage and the share of the whole work that is done, in `0..=1`.
    pub fn show(&self, done: f32, what: impl Into<Cow<'static, str>>) {
        self.bar.set_prefix(what);
        self.bar.set_position((f64::from(done) * STEPS as f64) as u64);
        self.bar.set_message(left(self.start.elapsed(), done).map_or(String::new(), |text| format!("({text})")));
    }

    /// Calls `print` with the bar hidden.
    pub fn aside(&self, print: impl FnOnce()) {
        self.bar.suspend(print);
    }
}

impl Drop for Bar {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}

/// Returns the remaining time as text if the share `done` took `elapsed`; `None` while too little is done for an
/// estimate.
fn left(elapsed: Duration, done: f32) -> Option<String> {
    const TOLD_FROM: f32 = 0.03;
    if done < TOLD_FROM {
        return None;
    }
    let seconds = elapsed.as_secs_f64() * f64::from((1.0 - done) / done);
    Some(match seconds {
        ..60.0 => format!("{:.0} s to go", seconds.ceil()),
        ..3600.0 => format!("{:.0} min to go", (seconds / 60.0).ceil()),
        _ => format!("{:.1} h to go", seconds / 3600.0),
    })
}

/// The stages of an encode, in order, with their shares of the time, measured with `--explain` on photographs of 0.4 to
/// 14 megapixels.
const WHOLE: [(&str, f32); 3] = [("fit", 0.6), ("finish", 0.36), ("thumbnail", 0.04)];
/// The stages of an encode in tiles, with their shares of the time.
const TILED: [(&str, f32); 6] =
    [("survey", 0.04), ("fit", 0.4), ("join", 0.2), ("finish", 0.3), ("thumbnail", 0.02), ("measure", 0.04)];

/// Maps the progress of the stages of an encode to the progress of the whole encode.
#[derive(Debug)]
pub struct Stages {
    stages: &'static [(&'static str, f32)],
    /// The largest number of fits for the target.
    tries: u32,
    tried: u32,
    last: (&'static str, f32),
    most: f32,
}

impl Stages {
    /// An encode that takes at most `tries` fits.
    pub fn new(tries: u32) -> Self {
        Stages { stages: &WHOLE, tries, tried: 0, last: ("", 0.0), most: 0.0 }
    }

    /// Returns the share of the whole encode that is done when the share `done` of `stage` is. It never decreases.
    pub fn at(&mut self, stage: &'static str, done: f32) -> f32 {
        // Only an encode in tiles begins with a survey.
        if stage == TILED[0].0 {
            self.stages = &TILED;
        }
        let first = self.stages[0].0;
        // Another try begins with the first stage again.
        if stage == first && (self.last.0 != first || done < self.last.1) && !self.last.0.is_empty() {
            self.tried = (self.tried + 1).min(self.tries - 1);
        }
        self.last = (stage, done);
        let mut share = 0.0;
        for &(name, part) in self.stages {
            if name == stage {
                share += part * done;
                break;
            }
            share += part;
        }
        self.most = self.most.max((self.tried as f32 + share.min(1.0)) / self.tries as f32);
        self.most
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_remaining_time_is_estimated_from_the_share_that_is_done() {
        assert_eq!(left(Duration::from_secs(10), 0.01), None);
        assert_eq!(left(Duration::from_secs(10), 0.5).as_deref(), Some("10 s to go"));
        assert_eq!(left(Duration::from_secs(100), 0.25).as_deref(), Some("5 min to go"));
        assert_eq!(left(Duration::from_secs(3600), 0.2).as_deref(), Some("4.0 h to go"));
    }

    #[test]
    fn progress_never_decreases_across_stages_and_tries() {
        for shares in [&WHOLE[..], &TILED[..]] {
            assert!((shares.iter().map(|s| s.1).sum::<f32>() - 1.0).abs() < 1e-5);
        }
        let mut stages = Stages::new(1);
        let shares = [("fit", 0.0), ("fit", 0.5), ("finish", 0.0), ("finish", 0.5), ("finish", 1.0)];
        let shares = shares.map(|(stage, done)| stages.at(stage, done));
        assert!(shares.is_sorted() && (shares[2] - 0.6).abs() < 1e-5 && shares[4] <= 1.0, "{shares:?}");
        let mut stages = Stages::new(3);
        let tries =
            [("fit", 1.0), ("finish", 1.0), ("fit", 0.0), ("fit", 0.5), ("finish", 1.0), ("fit", 0.1), ("fit", 0.0)];
        let shares = tries.map(|(stage, done)| stages.at(stage, done));
        assert!(shares.is_sorted() && shares[2] >= 1.0 / 3.0 && shares[6] < 1.0, "{shares:?}");
    }
}
