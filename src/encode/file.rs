//! Writes the smallest file for given integers, with progressive levels and, if it saves bytes, a codebook of colours.

use crate::bitstream;
use crate::bitstream::coder::expect::PredictedCost;
use crate::bitstream::rules::MAX_CODEBOOK;
use crate::bitstream::splats::PackedSplats;
use crate::error::Result;

/// Writes the file in `levels` levels, with a codebook of colours if that makes it smaller. Sorts the primitives into
/// the order of the file.
pub(crate) fn smallest(splats: &mut PackedSplats, levels: u8) -> Result<Vec<u8>> {
    if levels > 1 {
        divide(splats, levels);
    }
    splats.codebook = None;
    let direct = bitstream::to_bytes(splats)?;
    let mut colors: Vec<[i16; 4]> = splats.gaussians.iter().map(|g| g.color).collect();
    colors.sort_unstable();
    colors.dedup();
    // A codebook cannot save bytes if most colours occur only once. The format allows neither an empty codebook nor one
    // of more than `MAX_CODEBOOK` colours.
    if colors.is_empty() || colors.len() > MAX_CODEBOOK || colors.len() * 3 > splats.gaussians.len() {
        return Ok(direct);
    }
    splats.codebook = Some(colors);
    let indexed = bitstream::to_bytes(splats)?;
    if indexed.len() < direct.len() {
        return Ok(indexed);
    }
    splats.codebook = None;
    Ok(direct)
}

/// Returns the coder's prediction for each primitive of that file. Sorts the primitives into the order of the file.
pub(super) fn expected(splats: &mut PackedSplats, levels: u8) -> Result<Vec<PredictedCost>> {
    if levels > 1 {
        divide(splats, levels);
    }
    bitstream::coder::expect::expected(splats)
}

/// Sorts the primitives into at most `levels` progressive levels, large ones first. Each level roughly triples the
/// total number of primitives. [`Encoder::levels`](crate::Encoder::levels) writes these levels.
pub fn divide(splats: &mut PackedSplats, levels: u8) {
    splats.gaussians.sort_by_key(|g| std::cmp::Reverse(u16::from(g.major) + u16::from(g.minor)));
    let count = splats.gaussians.len() as u32;
    let ends: Vec<u32> = (1..=u32::from(levels)).map(|k| count / 3u32.pow(u32::from(levels) - k)).collect();
    splats.levels = ends.iter().enumerate().map(|(k, end)| end - if k > 0 { ends[k - 1] } else { 0 }).collect();
    splats.levels.retain(|&n| n > 0);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bitstream::splats::{Layout, Metadata, PackedGaussian, Steps};
    use crate::gaussian::{Blend, Channels};
    use crate::pixels::Depth;

    fn of_colors(colors: usize, times: usize) -> PackedSplats {
        let color = |i: usize| [(i % colors % 256) as i16, (i % colors / 256) as i16, 0, 0];
        let gaussians = (0..colors * times).map(|i| PackedGaussian { color: color(i), ..PackedGaussian::default() });
        PackedSplats {
            width: 8,
            height: 8,
            channels: Channels::Rgb,
            depth: Depth::Eight,
            blend: Blend::Normalized,
            layout: Layout::Packed,
            steps: Steps { scale: 2, angle: 1, position: 5, coarsest: 0, range: 0, luma: 0, chroma: 0 },
            background: [0; 4],
            codebook: None,
            gaussians: gaussians.collect(),
            levels: Vec::new(),
            detail: None,
            exact: None,
            metadata: Metadata::default(),
        }
    }

    #[test]
    fn too_many_colours_for_a_codebook_are_stored_per_primitive() {
        let mut splats = of_colors(MAX_CODEBOOK + 1, 3);
        smallest(&mut splats, 1).unwrap();
        assert_eq!(splats.codebook, None);
    }

    #[test]
    fn each_level_triples_the_number_of_primitives() {
        let mut splats = of_colors(90, 1);
        for (i, g) in splats.gaussians.iter_mut().enumerate() {
            (g.major, g.minor) = ((i % 7) as u8, 0);
        }
        divide(&mut splats, 3);
        assert_eq!(splats.levels, [10, 20, 60]);
        assert!(splats.gaussians.windows(2).all(|g| g[0].major >= g[1].major));
        divide(&mut splats, 8);
        assert_eq!(splats.levels.iter().sum::<u32>(), 90);
        assert!(!splats.levels.contains(&0));
    }
}
