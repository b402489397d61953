//! Prepares pictures for SSIMULACRA2, which needs several scales of a size and visible contrasts.

use crate::pixels::{Pixels, Samples};
use crate::used_range::UsedRange;

/// Side below which a picture is mirrored before it is measured, pixels. At smaller sides the coarse scales of the
/// measure have a few pixels or none, and a picture that is hardly recognizable can score 70 points: with sides of 12,
/// 24 and 31 pixels, the file of a photograph that scores 70 takes 60, 444 and 4580 bytes.
const MEASURED_SIDE: u32 = 64;

/// Returns `reference` and `test` as they are measured, or `None` if they are measured as they are. Sides below
/// [`MEASURED_SIDE`] are extended by reflections of the whole picture. If `reference` has 16 bits and uses a small part
/// of their range, that part is stretched to all of it in both.
pub(super) fn measurable(reference: &Pixels, test: &Pixels) -> Option<[Pixels; 2]> {
    let range = UsedRange::narrow(reference);
    let is_small = reference.width().min(reference.height()) < MEASURED_SIDE;
    if range.is_none() && !is_small {
        return None;
    }
    Some([reference, test].map(|pixels| {
        let stretched = range.map(|range| range.stretched(pixels));
        let pixels = stretched.as_ref().unwrap_or(pixels);
        if is_small { mirrored(pixels) } else { pixels.clone() }
    }))
}

/// Returns `pixels` with reflections beyond its right and lower edges, so that its sides are at least
/// [`MEASURED_SIDE`].
fn mirrored(pixels: &Pixels) -> Pixels {
    let from = [pixels.width(), pixels.height()];
    let to = from.map(|side| side * MEASURED_SIDE.div_ceil(side));
    let samples = match pixels.samples() {
        Samples::U8(v) => Samples::U8(reflected(v, pixels.channels().count(), from, to)),
        Samples::U16(v) => Samples::U16(reflected(v, pixels.channels().count(), from, to)),
    };
    Pixels::new(to[0], to[1], pixels.channels(), samples).expect("as many samples as the size says")
}

fn reflected<T: Copy>(samples: &[T], count: usize, from: [u32; 2], to: [u32; 2]) -> Vec<T> {
    // Every other copy is reversed.
    let inside = |i: u32, side: u32| if (i / side).is_multiple_of(2) { i % side } else { side - 1 - i % side };
    let pixel = |x: u32, y: u32| {
        let at = (inside(y, from[1]) as usize * from[0] as usize + inside(x, from[0]) as usize) * count;
        &samples[at..at + count]
    };
    (0..to[1]).flat_map(|y| (0..to[0]).flat_map(move |x| pixel(x, y)).copied()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gaussian::Channels;

    #[test]
    fn small_pictures_are_mirrored_to_measurable_sides() {
        let pixels = Pixels::new(3, 1, Channels::Grey, Samples::U8(vec![1, 2, 3])).unwrap();
        let [a, _] = measurable(&pixels, &pixels).unwrap();
        assert_eq!([a.width(), a.height()], [66, 64]);
        let Samples::U8(samples) = a.samples() else { panic!() };
        assert_eq!(samples[..9], [1, 2, 3, 3, 2, 1, 1, 2, 3]);
        assert_eq!(samples[66..75], samples[..9]);
        let large = Pixels::new(64, 64, Channels::Grey, Samples::U8(vec![0; 4096])).unwrap();
        assert!(measurable(&large, &large).is_none());
    }
}
