//! Twin of `sort.wgsl`.

pub(in crate::gpu) fn sort(starts: &[u32], lists: &[u32], sorted: &mut [u32]) {
    for tile in starts.windows(2) {
        let (first, end) = (tile[0] as usize, tile[1] as usize);
        for own in &lists[first..end] {
            let mut rank = 0;
            for other in &lists[first..end] {
                rank += usize::from(other < own);
            }
            sorted[first + rank] = *own;
        }
    }
}
