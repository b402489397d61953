//! The order in which the positions of a block are coded, from low frequencies to high ones (spec §11.4).

use std::sync::OnceLock;

/// Side of the largest block.
pub(crate) const LARGEST: usize = 32;
/// Sizes of blocks: 4, 8, 16 and 32 a side.
pub(crate) const SIZES: usize = 4;
/// Number of zones into which frequencies are divided.
pub(crate) const ZONES: usize = 15;

/// Length of a block's row in memory: contexts extend two positions beyond a level.
pub(crate) const STRIDE: usize = LARGEST + 2;
/// Length of a block in memory: a power of two, so that indices need a mask instead of a check.
pub(crate) const ROOM: usize = (STRIDE * STRIDE).next_power_of_two();

/// Returns the position in memory of the level at column `u` and row `v`.
#[inline(always)]
pub(crate) fn at(u: usize, v: usize) -> usize {
    v * STRIDE + u
}

/// A position in coding order.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Place {
    /// Position in memory as returned by [`at`].
    pub at: u16,
    pub zone: u8,
}

/// Returns the positions of blocks of side `4 << size` in coding order.
pub(crate) fn scan(size: usize) -> &'static [Place] {
    static SCANS: OnceLock<[Vec<Place>; SIZES]> = OnceLock::new();
    &SCANS.get_or_init(|| std::array::from_fn(places))[size]
}

/// Returns the position of each level of such a block in coding order, by its position in memory; 0 outside of the block.
#[cfg(feature = "encode")]
pub(crate) fn order(size: usize) -> &'static [u16; ROOM] {
    static ORDERS: OnceLock<[Box<[u16; ROOM]>; SIZES]> = OnceLock::new();
    &ORDERS.get_or_init(|| {
        std::array::from_fn(|size| {
            let mut order = Box::new([0; ROOM]);
            scan(size).iter().enumerate().for_each(|(k, place)| order[usize::from(place.at)] = k as u16);
            order
        })
    })[size]
}

fn places(size: usize) -> Vec<Place> {
    let side = 4usize << size;
    let mut places = Vec::with_capacity(side * side);
    // Diagonals in alternating directions.
    for sum in 0..2 * side - 1 {
        for i in (sum + 1).saturating_sub(side)..=sum.min(side - 1) {
            let [u, v] = if sum % 2 == 1 { [i, sum - i] } else { [sum - i, i] };
            let zone = half_octave(places.len() >> [0, 0, 1, 2][size]) as u8;
            places.push(Place { at: at(u, v) as u16, zone });
        }
    }
    places
}

fn half_octave(k: usize) -> usize {
    match k {
        0..4 => [0, 1, 2, 2][k],
        _ => {
            let octave = k.ilog2() as usize;
            3 + (octave - 2) * 2 + (k >> (octave - 1) & 1)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_position_is_visited_once_and_zones_ascend() {
        for size in 0..SIZES {
            let places = scan(size);
            let mut seen: Vec<u16> = places.iter().map(|p| p.at).collect();
            seen.sort_unstable();
            seen.dedup();
            assert_eq!(seen.len(), 16 << (2 * size));
            assert!(places.windows(2).all(|p| p[0].zone <= p[1].zone));
            assert!(usize::from(places.last().unwrap().zone) < ZONES);
        }
    }
}
