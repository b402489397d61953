//! Work without the interpreter's lock, on threads that live as long as the call.
//!
//! A pool of its own for each call keeps calls apart: a process that was forked while another thread was encoding
//! works like any other, which a pool of the whole process would not. The calling thread only listens, so that a
//! signal is answered at once wherever the work is; the work itself ends at its next step.

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::available_parallelism;
use std::time::Duration;

use pyo3::prelude::*;
use rayon::ThreadPoolBuilder;
use ssplat::{Error, Progress, Result};

use crate::failure::{exception, panicked, parameter};

/// How often the calling thread looks for signals.
const LISTEN: Duration = Duration::from_millis(20);

/// Most threads of a call.
const MOST: i128 = 1024;

/// What the work tells the calling thread.
enum Message<T> {
    Step { stage: &'static str, done: f32 },
    End(Result<T>),
}

/// The work's end of the line.
pub struct Reporter {
    step: Box<dyn Fn(&'static str, f32) + Send>,
    stopped: Arc<AtomicBool>,
}

impl Reporter {
    /// Tells how far the work is, and hears whether anybody still wants it.
    pub fn step(&self, progress: &Progress) -> ControlFlow<()> {
        (self.step)(progress.stage, progress.done);
        if self.stopped.load(Ordering::Relaxed) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }
}

/// How many threads to use: what was asked for, else one for each core but no more than `useful`.
pub fn threads(asked: Option<i128>, useful: usize) -> PyResult<usize> {
    match asked {
        Some(n @ 1..=MOST) => Ok(n as usize),
        Some(n) => Err(parameter("threads", format!("{n} is outside 1..={MOST}"))),
        None => Ok(available_parallelism().map_or(1, usize::from).min(useful.max(1))),
    }
}

/// Runs `work` on `threads` threads; `progress`, if any, is called in the calling thread with a stage and the share of
/// it that is done, and stops the work by raising or by returning `False`.
pub fn run<T: Send + 'static>(
    py: Python<'_>,
    threads: usize,
    progress: Option<&Bound<'_, PyAny>>,
    work: impl FnOnce(&Reporter) -> Result<T> + Send + 'static,
) -> PyResult<T> {
    // A panic drops the sender, which the listener notices.
    let pool = ThreadPoolBuilder::new().num_threads(threads).panic_handler(|_| ()).build();
    let pool = pool.map_err(|e| exception(Error::Io(std::io::Error::other(e))))?;
    let (sender, receiver) = channel();
    let stopped = Arc::new(AtomicBool::new(false));
    let reporter = reporter(sender.clone(), Arc::clone(&stopped));
    pool.spawn(move || {
        let _ = sender.send(Message::End(work(&reporter)));
    });
    let result = listen(py, &Mutex::new(receiver), progress);
    // Whoever leaves early takes the work with him.
    stopped.store(true, Ordering::Relaxed);
    result
}

fn reporter<T: Send + 'static>(sender: Sender<Message<T>>, stopped: Arc<AtomicBool>) -> Reporter {
    let step = Box::new(move |stage, done| {
        let _ = sender.send(Message::Step { stage, done });
    });
    Reporter { step, stopped }
}

fn listen<T: Send>(
    py: Python<'_>,
    receiver: &Mutex<Receiver<Message<T>>>,
    progress: Option<&Bound<'_, PyAny>>,
) -> PyResult<T> {
    loop {
        let message = py.detach(|| {
            let receiver = receiver.lock().unwrap_or_else(PoisonError::into_inner);
            receiver.recv_timeout(LISTEN)
        });
        match message {
            Ok(Message::End(result)) => return result.map_err(exception),
            Ok(Message::Step { stage, done }) => {
                if let Some(progress) = progress {
                    let answer = progress.call1((stage, done))?;
                    if answer.extract::<bool>().is_ok_and(|go_on| !go_on) {
                        return Err(exception(Error::Cancelled));
                    }
                }
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return Err(panicked()),
        }
        py.check_signals()?;
    }
}
