//! Parallel maps over indices and chunks, on rayon if the feature is enabled. They return results in order, so that
//! sums over the results do not depend on the number of threads.

#[cfg(feature = "rayon")]
use crate::error::Error;
use crate::error::Result;
#[cfg(feature = "rayon")]
use rayon::prelude::*;
#[cfg(feature = "rayon")]
use std::sync::atomic::{AtomicBool, Ordering};
#[cfg(feature = "rayon")]
use std::sync::{Mutex, PoisonError, mpsc};

/// Returns the number of threads that run in parallel.
pub fn threads() -> usize {
    #[cfg(feature = "rayon")]
    return rayon::current_num_threads();
    #[cfg(not(feature = "rayon"))]
    1
}

/// Returns `f(0), …, f(count − 1)`.
pub fn map<T: Send>(count: usize, f: impl Fn(usize) -> T + Sync + Send) -> Vec<T> {
    map_each((0..count).map(|_| ()), |i, ()| f(i))
}

/// Returns `f(i, chunk i)` for the chunks of `size` elements; the last chunk may be shorter.
pub fn map_chunks<A: Send, T: Send>(
    data: &mut [A],
    size: usize,
    f: impl Fn(usize, &mut [A]) -> T + Sync + Send,
) -> Vec<T> {
    map_each(data.chunks_mut(size), f)
}

/// Returns `f(i, chunk i of a, chunk i of b)` for the chunks of `size_a` and `size_b` elements.
pub fn map_chunk_pairs<A: Send, B: Send, T: Send>(
    (a, size_a): (&mut [A], usize),
    (b, size_b): (&mut [B], usize),
    f: impl Fn(usize, &mut [A], &mut [B]) -> T + Sync + Send,
) -> Vec<T> {
    map_each(a.chunks_mut(size_a).zip(b.chunks_mut(size_b)), |i, (a, b)| f(i, a, b))
}

/// Returns `f(i, input i)` for all inputs.
#[cfg(feature = "rayon")]
pub fn map_each<I: Send, T: Send>(inputs: impl Iterator<Item = I>, f: impl Fn(usize, I) -> T + Sync) -> Vec<T> {
    // No lock is held while `f` runs, and none is waited for, because only the call for an index takes that of its slot.
    let slots: Vec<Mutex<(Option<I>, Option<T>)>> = inputs.map(|input| Mutex::new((Some(input), None))).collect();
    for_each(slots.len(), &|i| {
        let input = lock(&slots[i]).0.take();
        let result = input.map(|input| f(i, input));
        lock(&slots[i]).1 = result;
    });
    let results = slots.into_iter().map(|slot| slot.into_inner().unwrap_or_else(PoisonError::into_inner).1);
    results.map(|result| result.expect("every index was worked on")).collect()
}

/// Returns `f(i, input i)` for all inputs.
#[cfg(not(feature = "rayon"))]
pub fn map_each<I, T>(inputs: impl Iterator<Item = I>, f: impl Fn(usize, I) -> T) -> Vec<T> {
    inputs.enumerate().map(|(i, input)| f(i, input)).collect()
}

/// Runs `work(0), …, work(count − 1)`. The work is not a type parameter, because the compiler would generate rayon's
/// code, and several copies of the work, for each of the crate's sixty kinds of work: a quarter of its time.
#[cfg(feature = "rayon")]
fn for_each(count: usize, work: &(dyn Fn(usize) + Sync)) {
    // Handing a single piece of work to another thread costs more than doing it here.
    if count > 1 && threads() > 1 {
        (0..count).into_par_iter().for_each(work);
    } else {
        (0..count).for_each(work);
    }
}

/// Runs `work` on a thread of the pool and returns its result. `work` asks questions, and `answer` answers them on the
/// calling thread.
///
/// From a thread of the pool, a parallel map starts at once and the other threads join in. From any other thread it
/// would have to wake one of them and wait, which takes longer than most maps of a fit.
///
/// Only one call at a time uses the pool. A thread of the pool that waits for a part of one work could otherwise begin
/// another and keep the first waiting until that ends. Further calls do their work on the calling thread.
pub fn on_pool<Q: Send, A: Send, T: Send>(
    work: impl FnOnce(&mut dyn FnMut(Q) -> A) -> T + Send,
    answer: &mut dyn FnMut(Q) -> A,
) -> T {
    #[cfg(feature = "rayon")]
    if threads() > 1
        && rayon::current_thread_index().is_none()
        && let Some(_turn) = Turn::take()
    {
        let (ask, questions) = mpsc::channel();
        let (reply, answers) = mpsc::channel();
        let mut result = None;
        rayon::in_place_scope(|scope| {
            let result = &mut result;
            // If an answer panics, both ends are dropped here, so that the work ends too.
            let (questions, reply) = (questions, reply);
            scope.spawn(move |_| {
                let mut ask = |question| {
                    ask.send(question).expect("the caller listens until the work ends");
                    answers.recv().expect("the caller answers every question unless it panics")
                };
                *result = Some(work(&mut ask));
            });
            for question in questions {
                // Nobody listens only after a panic.
                let _ = reply.send(answer(question));
            }
        });
        return result.expect("a panic of the work is passed on by the scope");
    }
    work(answer)
}

/// The right to do work on the pool.
#[cfg(feature = "rayon")]
struct Turn;

#[cfg(feature = "rayon")]
impl Turn {
    /// Returns the right if nobody has it.
    fn take() -> Option<Turn> {
        (!IS_TAKEN.swap(true, Ordering::Acquire)).then_some(Turn)
    }
}

#[cfg(feature = "rayon")]
impl Drop for Turn {
    fn drop(&mut self) {
        IS_TAKEN.store(false, Ordering::Release);
    }
}

#[cfg(feature = "rayon")]
static IS_TAKEN: AtomicBool = AtomicBool::new(false);

/// Runs `work(i, input i, report)` for all `inputs`, up to `most` at a time. Each job reports the fraction that it has
/// done, and `watch` is called with the sum of all fractions on the calling thread. If `watch` or a job fails, the
/// other jobs are cancelled when they next report.
pub fn map_watched<I: Send, T: Send>(
    most: usize,
    inputs: Vec<I>,
    work: impl Fn(usize, I, &mut dyn FnMut(f32) -> Result<()>) -> Result<T> + Sync,
    watch: &mut dyn FnMut(f32) -> Result<()>,
) -> Result<Vec<T>> {
    // A pool thread that waits here could not run any of the jobs.
    #[cfg(feature = "rayon")]
    if most.min(inputs.len()).min(threads()) > 1 && rayon::current_thread_index().is_none() {
        return map_side_by_side(most.min(inputs.len()).min(threads()), inputs, work, watch);
    }
    let _ = most;
    let one = |(i, input)| work(i, input, &mut |done| watch(i as f32 + done));
    inputs.into_iter().enumerate().map(one).collect()
}

#[cfg(feature = "rayon")]
fn map_side_by_side<I: Send, T: Send>(
    at_once: usize,
    inputs: Vec<I>,
    work: impl Fn(usize, I, &mut dyn FnMut(f32) -> Result<()>) -> Result<T> + Sync,
    watch: &mut dyn FnMut(f32) -> Result<()>,
) -> Result<Vec<T>> {
    let count = inputs.len();
    let left = Mutex::new(inputs.into_iter().enumerate());
    let results = Mutex::new((0..count).map(|_| None).collect::<Vec<Option<Result<T>>>>());
    let is_ended = AtomicBool::new(false);
    let (sender, receiver) = mpsc::channel();
    let watched = rayon::in_place_scope(|scope| {
        for _ in 0..at_once {
            let sender = sender.clone();
            let (left, results, is_ended, work) = (&left, &results, &is_ended, &work);
            scope.spawn(move |_| {
                while !is_ended.load(Ordering::Relaxed) {
                    let Some((i, input)) = lock(left).next() else { break };
                    let result = work(i, input, &mut |done| {
                        if is_ended.load(Ordering::Relaxed) {
                            return Err(Error::Cancelled);
                        }
                        // The receiver is gone only after a panic.
                        let _ = sender.send((i, done));
                        Ok(())
                    });
                    if result.is_err() {
                        is_ended.store(true, Ordering::Relaxed);
                    }
                    lock(results)[i] = Some(result);
                }
            });
        }
        drop(sender);
        let mut shares = vec![0.0f32; count];
        for (i, done) in receiver {
            shares[i] = done;
            if !is_ended.load(Ordering::Relaxed)
                && let Err(error) = watch(shares.iter().sum())
            {
                is_ended.store(true, Ordering::Relaxed);
                return Err(error);
            }
        }
        Ok(())
    });
    watched?;
    let results = results.into_inner().unwrap_or_else(PoisonError::into_inner);
    let mut all = Vec::with_capacity(count);
    let mut cancelled = Ok(());
    for result in results.into_iter().flatten() {
        match result {
            Ok(value) => all.push(value),
            // Cancelled jobs return no other error.
            Err(Error::Cancelled) => cancelled = Err(Error::Cancelled),
            Err(error) => return Err(error),
        }
    }
    cancelled.map(|()| all)
}

#[cfg(feature = "rayon")]
fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::Error;
    use crate::parameter::Parameter;

    /// Returns an error that names the job.
    fn failure(i: usize) -> Error {
        Error::Parameter { parameter: Parameter::Task, problem: i.to_string() }
    }

    #[test]
    fn results_are_in_order_and_work_may_start_further_work() {
        let inner = |i| map(30, |j| i * j).into_iter().sum::<usize>();
        assert_eq!(map(40, inner), (0..40).map(|i| i * 435).collect::<Vec<_>>());
        let mut values = [1; 10];
        assert_eq!(
            map_chunks(&mut values, 4, |i, chunk| {
                chunk.fill(i);
                chunk.len()
            }),
            [4, 4, 2]
        );
        assert_eq!(values, [0, 0, 0, 0, 1, 1, 1, 1, 2, 2]);
        let lengths = map_chunk_pairs((&mut values, 4), (&mut [0; 5], 2), |i, a, b| (i, a.len(), b.len()));
        assert_eq!(lengths, [(0, 4, 2), (1, 4, 2), (2, 2, 1)]);
        assert!(map(0, |i| i).is_empty());
    }

    #[test]
    fn questions_are_answered_on_the_calling_thread_and_in_order() {
        let caller = std::thread::current().id();
        let mut asked = Vec::new();
        let answer = &mut |question: u32| {
            assert_eq!(std::thread::current().id(), caller);
            asked.push(question);
            question * question
        };
        let sum =
            on_pool(|ask| (0..100).map(|i| on_pool(|nested| nested(i), &mut |i: u32| i) + ask(i)).sum::<u32>(), answer);
        assert_eq!(sum, (0..100).map(|i| i + i * i).sum::<u32>());
        assert!(asked.is_sorted() && asked.len() == 100);
    }

    #[test]
    fn a_panic_of_the_work_or_of_an_answer_reaches_the_caller_and_leaves_the_pool_usable() {
        for fails_in_answer in [false, true] {
            let panicked = std::panic::catch_unwind(|| {
                let work = |ask: &mut dyn FnMut(u32) -> u32| {
                    assert!(fails_in_answer, "the work fails");
                    ask(1)
                };
                on_pool(work, &mut |_| panic!("the answer fails"))
            });
            assert!(panicked.is_err());
            assert_eq!(on_pool(|ask: &mut dyn FnMut(u32) -> u32| ask(3), &mut |n| 2 * n), 6);
        }
    }

    #[test]
    fn watched_results_are_in_order_and_progress_adds_up() {
        for most in [1, 2, 7] {
            let mut told = Vec::new();
            let inputs: Vec<usize> = (0..20).map(|i| 3 * i).collect();
            let work = |i: usize, input, tell: &mut dyn FnMut(f32) -> Result<()>| {
                tell(0.5)?;
                tell(1.0)?;
                Ok((i, input))
            };
            let watch = &mut |done| {
                told.push(done);
                Ok(())
            };
            let results = map_watched(most, inputs, work, watch).unwrap();
            assert_eq!(results, (0..20).map(|i| (i, 3 * i)).collect::<Vec<_>>());
            assert!(told.is_sorted() && told.len() == 40 && told[39] == 20.0, "{told:?}");
        }
    }

    #[test]
    fn a_failure_of_watched_work_is_returned_and_cancels_the_rest() {
        for most in [1, 4] {
            let work = |i: usize, (), tell: &mut dyn FnMut(f32) -> Result<()>| {
                if i == 5 {
                    return Err(failure(i));
                }
                // The later jobs do not end by themselves.
                if i > 5 {
                    loop {
                        tell(0.5)?;
                    }
                }
                Ok(())
            };
            let result = map_watched(most, vec![(); 12], work, &mut |_| Ok(()));
            assert!(matches!(&result, Err(Error::Parameter { problem, .. }) if problem == "5"), "{result:?}");
        }
    }

    #[test]
    fn the_watcher_can_cancel_the_work() {
        for most in [1, 4] {
            let work = |_: usize, (), tell: &mut dyn FnMut(f32) -> Result<()>| -> Result<()> {
                loop {
                    tell(0.0)?;
                }
            };
            let mut left = 9;
            let watch = &mut |_| {
                left -= 1;
                if left == 0 { Err(failure(77)) } else { Ok(()) }
            };
            let result = map_watched(most, vec![(); 6], work, watch);
            assert!(matches!(&result, Err(Error::Parameter { problem, .. }) if problem == "77"), "{result:?}");
        }
    }
}
