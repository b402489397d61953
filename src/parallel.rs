//! Work over indices and chunks, on rayon where the feature is on. Results come back in order, so that sums over
//! them do not depend on the thread count.

#[cfg(feature = "rayon")]
use rayon::prelude::*;

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
