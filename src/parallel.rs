//! Work over indices and chunks, on rayon where the feature is on. Results come back in order, so that sums over
//! them do not depend on the thread count.

#[cfg(feature = "rayon")]
use crate::error::Error;
use crate::error::Result;
#[cfg(feature = "rayon")]
use rayon::prelude::*;
#[cfg(feature = "rayon")]
use std::sync::atomic::{AtomicBool, Ordering};
#[cfg(feature = "rayon")]
use std::sync::{Mutex, PoisonError, mpsc};

/// Threads that work at once.
pub fn threads() -> usize {
    #[cfg(feature = "rayon")]
    return rayon::current_num_threads();
    #[cfg(not(feature = "rayon"))]
    1
}

/// `f(0), …, f(count − 1)`.
pub fn map<T: Send>(count: usize, f: impl Fn(usize) -> T + Sync + Send) -> Vec<T> {
    // Handing over a single piece of work costs more than a small one itself.
    #[cfg(feature = "rayon")]
    if count > 1 && threads() > 1 {
        return (0..count).into_par_iter().map(f).collect();
    }
    (0..count).map(f).collect()
}

/// `f(i, chunk i)` over chunks of `size` elements, the last one possibly shorter.
pub fn map_chunks<A: Send, T: Send>(
    data: &mut [A],
    size: usize,
    f: impl Fn(usize, &mut [A]) -> T + Sync + Send,
) -> Vec<T> {
    #[cfg(feature = "rayon")]
    if threads() > 1 {
        return data.par_chunks_mut(size).enumerate().map(|(i, c)| f(i, c)).collect();
    }
    data.chunks_mut(size).enumerate().map(|(i, c)| f(i, c)).collect()
}

/// `f(i, chunk i of a, chunk i of b)` over chunks of `size_a` and `size_b` elements.
pub fn map_chunk_pairs<A: Send, B: Send, T: Send>(
    (a, size_a): (&mut [A], usize),
    (b, size_b): (&mut [B], usize),
    f: impl Fn(usize, &mut [A], &mut [B]) -> T + Sync + Send,
) -> Vec<T> {
    #[cfg(feature = "rayon")]
    if threads() > 1 {
        let pairs = a.par_chunks_mut(size_a).zip(b.par_chunks_mut(size_b));
        return pairs.enumerate().map(|(i, (a, b))| f(i, a, b)).collect();
    }
    a.chunks_mut(size_a).zip(b.chunks_mut(size_b)).enumerate().map(|(i, (a, b))| f(i, a, b)).collect()
}

/// Does `work(i, input i, tell)` for all `inputs`, up to `most` at a time. Each tells the share of it that is done, and `watch` is told the
/// sum of all shares on the calling thread. What `watch` or any work fails with ends the others when they tell next.
pub fn map_watched<I: Send, T: Send>(
    most: usize,
    inputs: Vec<I>,
    work: impl Fn(usize, I, &mut dyn FnMut(f32) -> Result<()>) -> Result<T> + Sync,
    watch: &mut dyn FnMut(f32) -> Result<()>,
) -> Result<Vec<T>> {
    // A thread of the pool that waited here would be missing there.
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
                        // Nobody listens only after a panic.
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
            // Those that were ended say no more than that.
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

    /// An error that says which work it came from.
    fn failure(i: usize) -> Error {
        Error::Parameter { name: "work", problem: i.to_string() }
    }

    #[test]
    fn watched_work_comes_back_in_order_and_its_shares_add_up() {
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
    fn what_watched_work_fails_with_comes_back_and_ends_the_rest() {
        for most in [1, 4] {
            let work = |i: usize, (), tell: &mut dyn FnMut(f32) -> Result<()>| {
                if i == 5 {
                    return Err(failure(i));
                }
                // None of the later ones comes to an end by itself.
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
    fn whoever_watches_can_end_the_work() {
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
