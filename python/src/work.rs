//! Runs work without the GIL, on threads that live as long as the call.
//!
//! Each call has its own thread pool. Therefore a process works even if it was forked while another thread was
//! encoding, which a global pool would not survive. The calling thread only waits for messages, so it reacts to signals
//! at once; the work itself ends at its next step.

use std::collections::VecDeque;
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::available_parallelism;
use std::time::Duration;

use pyo3::prelude::*;
use pyo3::pybacked::PyBackedBytes;
use pyo3::types::PyBytes;
use rayon::ThreadPoolBuilder;
use ssplat::{Error, Progress, Result};

use crate::failure::{exception, panicked, parameter};

/// Interval at which the calling thread checks for signals.
const LISTEN: Duration = Duration::from_millis(20);

/// Maximum number of threads of a call.
const MOST: i128 = 1024;

/// Messages from the work to the calling thread, and its requests.
enum Message<T> {
    Step { stage: &'static str, done: f32 },
    Start { task: Vec<u8> },
    Wait { answer: Sender<Vec<u8>> },
    End(Result<T>),
}

/// The end of the channel that the work holds.
pub struct Reporter {
    step: Box<dyn Fn(&'static str, f32) + Send>,
    start: Box<dyn Fn(Vec<u8>) + Send>,
    wait: Box<dyn Fn(Sender<Vec<u8>>) + Send>,
    stopped: Arc<AtomicBool>,
}

impl Reporter {
    /// Reports the progress, and returns an error if the caller has cancelled.
    pub fn step(&self, progress: &Progress) -> ControlFlow<()> {
        (self.step)(progress.stage, progress.done);
        if self.stopped.load(Ordering::Relaxed) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }

    /// Starts a task elsewhere.
    pub fn start(&self, task: Vec<u8>) {
        (self.start)(task);
    }

    /// Waits for the result of the oldest unfinished task.
    pub fn wait(&self) -> Result<Vec<u8>> {
        let (sender, receiver) = channel();
        (self.wait)(sender);
        // The calling thread has returned.
        receiver.recv().map_err(|_| Error::Cancelled)
    }
}

/// Callbacks that run in the calling thread.
#[derive(Default)]
pub struct Calls<'a, 'py> {
    /// Receives a stage and the fraction of it that is done.
    pub progress: Option<&'a Bound<'py, PyAny>>,
    /// Starts a task, and returns a function that waits for its result.
    pub start: Option<&'a Bound<'py, PyAny>>,
}

/// Returns the number of threads: the requested one, or one per core, at most `useful`.
pub fn threads(asked: Option<i128>, useful: usize) -> PyResult<usize> {
    match asked {
        Some(n @ 1..=MOST) => Ok(n as usize),
        Some(n) => Err(parameter("threads", format!("{n} is outside 1..={MOST}"))),
        None => Ok(available_parallelism().map_or(1, usize::from).min(useful.max(1))),
    }
}

/// Runs `work` on `threads` threads. The `calls` run in the calling thread. They stop the work by raising an exception,
/// `progress` also by returning `False`.
pub fn run<T: Send + 'static>(
    py: Python<'_>,
    threads: usize,
    calls: &Calls<'_, '_>,
    work: impl FnOnce(&Reporter) -> Result<T> + Send + 'static,
) -> PyResult<T> {
    // A panic drops the sender, which closes the channel.
    let pool = ThreadPoolBuilder::new().num_threads(threads).panic_handler(|_| ()).build();
    let pool = pool.map_err(|e| exception(Error::Io(std::io::Error::other(e))))?;
    let (sender, receiver) = channel();
    let stopped = Arc::new(AtomicBool::new(false));
    let reporter = reporter(sender.clone(), Arc::clone(&stopped));
    pool.spawn(move || {
        let _ = sender.send(Message::End(work(&reporter)));
    });
    let result = listen(py, &Mutex::new(receiver), calls);
    // If this thread returns early, the work is cancelled.
    stopped.store(true, Ordering::Relaxed);
    result
}

fn reporter<T: Send + 'static>(sender: Sender<Message<T>>, stopped: Arc<AtomicBool>) -> Reporter {
    let [to_start, to_wait] = [sender.clone(), sender.clone()];
    let step = Box::new(move |stage, done| {
        let _ = sender.send(Message::Step { stage, done });
    });
    let start = Box::new(move |task| {
        let _ = to_start.send(Message::Start { task });
    });
    let wait = Box::new(move |answer| {
        let _ = to_wait.send(Message::Wait { answer });
    });
    Reporter { step, start, wait, stopped }
}

fn listen<T: Send>(py: Python<'_>, receiver: &Mutex<Receiver<Message<T>>>, calls: &Calls<'_, '_>) -> PyResult<T> {
    let mut started = VecDeque::new();
    loop {
        let message = py.detach(|| {
            let receiver = receiver.lock().unwrap_or_else(PoisonError::into_inner);
            receiver.recv_timeout(LISTEN)
        });
        match message {
            Ok(Message::End(result)) => return result.map_err(exception),
            Ok(Message::Step { stage, done }) => {
                if let Some(progress) = calls.progress {
                    let answer = progress.call1((stage, done))?;
                    if answer.extract::<bool>().is_ok_and(|go_on| !go_on) {
                        return Err(exception(Error::Cancelled));
                    }
                }
            }
            Ok(Message::Start { task }) => {
                if let Some(start) = calls.start {
                    started.push_back(start.call1((PyBytes::new(py, &task),))?);
                }
            }
            Ok(Message::Wait { answer }) => {
                if let Some(task) = started.pop_front() {
                    let found = task.call0()?;
                    let found = found.extract::<PyBackedBytes>().map_err(|_| {
                        let kind = found.get_type();
                        parameter("start", format!("the function that start returned must return bytes, not {kind}"))
                    })?;
                    let _ = answer.send(found.to_vec());
                }
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return Err(panicked()),
        }
        py.check_signals()?;
    }
}
