//! The progress bar: on a terminal only, on standard error.

use std::borrow::Cow;
use std::io::IsTerminal;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

/// Steps of the bar.
const STEPS: u64 = 1000;

/// A bar; hidden where standard error is not a terminal.
pub struct Bar(ProgressBar);

impl Bar {
    pub fn new() -> Bar {
        if std::io::stderr().is_terminal() { Bar::on(ProgressDrawTarget::stderr_with_hz(10)) } else { Bar::hidden() }
    }

    /// A bar that nobody sees.
    pub fn hidden() -> Bar {
        Bar::on(ProgressDrawTarget::hidden())
    }

    fn on(target: ProgressDrawTarget) -> Bar {
        let style =
            ProgressStyle::with_template("{msg:<28} {wide_bar} {percent:>3} % {elapsed}").expect("valid template");
        Bar(ProgressBar::with_draw_target(Some(STEPS), target).with_style(style))
    }

    /// Shows what is being done, and how much of it is, in `0..=1`.
    pub fn show(&self, done: f32, message: impl Into<Cow<'static, str>>) {
        self.0.set_message(message);
        self.0.set_position((f64::from(done) * STEPS as f64) as u64);
    }

    /// Prints without the bar in between.
    pub fn aside(&self, print: impl FnOnce()) {
        self.0.suspend(print);
    }
}

impl Drop for Bar {
    fn drop(&mut self) {
        self.0.finish_and_clear();
    }
}
