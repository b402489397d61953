//! The Hilbert curve: an order of grid points that keeps neighbours close (spec §6.3).

/// Returns the distance of `(x, y)` along the curve that fills a square of `2^order` points a side.
pub(crate) fn hilbert(order: u32, mut x: u32, mut y: u32) -> u64 {
    let mut distance = 0u64;
    for bit in (0..order).rev() {
        let (right, down) = (x >> bit & 1, y >> bit & 1);
        distance = distance << 2 | u64::from((3 * right) ^ down);
        if down == 0 {
            if right == 1 {
                (x, y) = (!x, !y);
            }
            (x, y) = (y, x);
        }
    }
    distance
}

/// Returns the point at a distance along the curve; the inverse of [`hilbert`].
pub(crate) fn hilbert_point(order: u32, distance: u64) -> (u32, u32) {
    let (mut x, mut y) = (0u32, 0u32);
    for bit in 0..order {
        let digit = (distance >> (2 * bit)) as u32 & 3;
        let (right, down) = (digit >> 1, (digit ^ digit >> 1) & 1);
        if down == 0 {
            if right == 1 {
                let last = (1u32 << bit) - 1;
                (x, y) = (last - x, last - y);
            }
            (x, y) = (y, x);
        }
        x |= right << bit;
        y |= down << bit;
    }
    (x, y)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curve_visits_every_point_once_in_unit_steps() {
        for order in 0..6 {
            let mut last = None;
            for distance in 0..1u64 << (2 * order) {
                let (x, y) = hilbert_point(order, distance);
                assert_eq!(hilbert(order, x, y), distance);
                if let Some((px, py)) = last {
                    assert_eq!(x.abs_diff(px) + y.abs_diff(py), 1);
                }
                last = Some((x, y));
            }
        }
        let (x, y) = (0x2345_6789 & 0x3fff_ffff, 0x1abc_def0);
        assert_eq!(hilbert_point(30, hilbert(30, x, y)), (x, y));
    }
}
