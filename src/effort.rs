//! What each effort does. No other file asks for the effort: it asks for a setting.
//!
//! `cargo run --release -p ssplat-lab --example effort_table -- PICTURES` measures the quality and the time of every
//! effort, and `python lab/benchmarks.py` those of the sets in docs/BENCHMARKS.md.

/// Highest effort.
pub(crate) const MAX_EFFORT: u8 = 9;

/// The settings of an effort.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct EffortSettings {
    pub fit: FitSettings,
    pub allocation: AllocationSettings,
    pub layer: LayerSettings,
    /// Whether near colours are compared with a quick file of Gaussians before one of this effort is made.
    pub compares_quickly: bool,
    pub duration: Duration,
}

/// Settings of the fit of Gaussians and of the sweeps over their integers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct FitSettings {
    /// Iterations for 5500 primitives: in fits of few primitives and of many.
    pub iterations: [f32; 2],
    /// Exponent with which the iterations of fits of many primitives change with their number. In a short fit of a large
    /// picture, a step gains more than the sweep that would take its place.
    pub dense_exponent: f32,
    /// Maximum number of sweeps, for up to 2000, 40 000 and 300 000 primitives and for more.
    pub sweeps: [u32; 4],
    /// The minimum distance of sampled rows, and the fraction of the steps, at which a fit of Gaussians alone with
    /// perceptual tuning begins at half size.
    pub half: HalfSize,
    pub base: BaseFitSettings,
}

/// Settings of the fit of Gaussians under a detail layer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct BaseFitSettings {
    /// Factor on the iterations with perceptual tuning. At effort 5, 0.35 gains 0.1 to 0.4 points of SSIMULACRA2 on
    /// Kodak and CID22 at ratios of 50 and 100, and nothing at 2.8 megapixels. It takes 28 % more time.
    pub iterations: f32,
    /// Factor on the iterations for squared error. From effort 3 on, 1 gains 0.06 dB at ratios of 20 and 50 and takes
    /// 50 % more time.
    pub exact_iterations: f32,
    /// Whether fits for squared error are longer in large files.
    pub is_longer_in_large_files: bool,
    /// Maximum number of sweeps with perceptual tuning, for few primitives and for many, and for squared error. After
    /// longer fits, the third sweep gains another 0.01 dB. At effort 3, more steps gain more than a second sweep over
    /// many primitives; over few, a second sweep gains 0.3 SSIMULACRA2 points on five Kodak pictures.
    pub sweeps: [u32; 3],
    /// The first steps at half size, if there are any.
    pub half: Option<HalfSize>,
    /// Step sizes at the end of the fit, relative to those at the start, and maximum share of the primitives in each
    /// relocation, with perceptual tuning. The sweep over the integers that follows compensates for the larger steps,
    /// and relocations are rarer there. With these values, Kodak at a ratio of 50 gains 0.6 points of SSIMULACRA2 at
    /// effort 2 and 0.3 at effort 6.
    pub last_rate: f32,
    pub relocated_share: f32,
    /// Share of the time budget for the Gaussians. At efforts 1 and 2, whose fits are short, the layer takes a larger
    /// part.
    pub time_share: f64,
    pub reduction: Reduction,
    /// Whether the errors of pixels are weighted by how well they are masked. At effort 1, the weights take an eighth of
    /// the time and gain 0.03 to 0.16 SSIMULACRA2 points on five Kodak pictures at ratios of 20, 50 and 100.
    pub weighs_pixels: bool,
    /// Whether the rounded Gaussians are compared with a single colour, and those removed that are not needed. Both
    /// matter to pictures with hardly any contents, and take a twelfth of the time of effort 1.
    pub is_checked: bool,
}

/// The downscaled picture to which Gaussians under a detail layer are fitted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Reduction {
    /// Minimum number of pixels per primitive in the downscaled picture, for pictures of up to 0.4 megapixels, and for
    /// large ones. The finest detail of large pictures is weaker: on four photographs of 2.8 megapixels at ratios of 100
    /// and 200, 75 instead of 300 gain 0.1 SSIMULACRA2 points and save a fifth of the time at efforts 1 and 5; on five
    /// Kodak pictures they lose 0.1 points at 50 and 1.2 at 100.
    pub min_pixels_each: [f64; 2],
    /// Largest factor by which the picture is downscaled: a power of two.
    pub max_factor: u32,
}

/// The first steps of a fit, which use the picture at half size.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct HalfSize {
    /// Fraction of the steps.
    pub share: f32,
    /// Minimum distance of sampled rows. Gaussians span several pixels from there on.
    pub row_step: u32,
}

/// Settings of the allocation of the bytes to Gaussians and detail layer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct AllocationSettings {
    /// Factor on the bytes of the Gaussians. At efforts 1 and 2, short fits use bytes less efficiently than the layer.
    pub base_factor: f64,
    /// Whether large, busy pictures have a minimum share of Gaussians. At effort 2 it would lose 1.7 SSIMULACRA2 points
    /// on CLIC at a ratio of 100.
    pub has_busy_share: bool,
    /// Fineness at which a layer is worth as much as the same bytes of Gaussians, for small and for large pictures at a
    /// ratio of 100. At effort 3, a layer gains 0.1 to 7.9 SSIMULACRA2 points on all of 14 pictures. At effort 2,
    /// Gaussians alone would gain 0.3 and 0.9 points on Kodak and CID22 at a ratio of 100 and 2.5 and 0.7 at 200, but
    /// take 1.4 to 5 times as long. On a photograph of 2.8 megapixels at a ratio of 200, Gaussians
    /// alone gain 8.5 points at effort 2; the rule is the same as that of the other efforts on five more.
    pub fineness: [f64; 2],
    /// Maximum sharpness of pictures for which a small base is best, at a ratio of 20. With the lower value, one of
    /// twelve pictures gains 0.1 dB at a ratio of 20 and 0.2 dB at 50, and five are fitted again without a gain.
    pub max_sharpness: f64,
    /// Whether fits to drawings under a layer are longer.
    pub is_patient_with_drawings: bool,
    /// Whether the length of fits to photographs under a layer depends on the ratio.
    pub is_patient_by_ratio: bool,
    /// Whether several divisions are tried for mixed pictures. At ratios of 20, 50 and 100, a page with photographs
    /// gains 1.6, 3.9 and 3.8 points, eight similar pages 0.2, 1.3 and 0.5 in the mean, and three pictures of CID22
    /// 0.5, 0.3 and 0.8. They take 2.5 times as long.
    pub tries_divisions: bool,
}

/// Settings of the coding of the detail layer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct LayerSettings {
    /// Maximum shortfall of an accepted layer, and by how much the search aims below the available bytes, as fractions
    /// of these. At effort 2, larger ones save 4 to 10 % of the time and lose 0.04 SSIMULACRA2 points.
    pub max_shortfall: f64,
    pub aims_below: f64,
    /// Whether the blocks of a small picture are chosen by the prices of the entropy coder with any tuning. On Kodak and
    /// CID22 they gain 0.1 and 0.03 points of SSIMULACRA2 at ratios of 20 to 100, and 0.3 at 200 on Kodak, and take 2 to
    /// 6 % more time. At 2.8 megapixels they gain nothing.
    pub has_priced_blocks: bool,
    /// Whether blocks are chosen again where flat ground rings. It takes a sixth of the time of effort 1.
    pub avoids_ringing: bool,
    pub rounds: Rounds,
}

/// Maximum numbers of rounds in which the Gaussians' integers are optimized under the layer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Rounds {
    /// With perceptual tuning.
    pub perceptual: u32,
    /// The same with [`Tune::Iq`](crate::options::Tune::Iq) in large files. At a ratio of 20 a second round gains 0.02
    /// SSIMULACRA2 points on Kodak and 0.05 on CID22, and takes 4 and 7 % more time. In general it gains 0.1 points on
    /// Kodak and 0.01 at 2.8 megapixels, and takes 7 % and 13 % of the time.
    pub in_large_files: u32,
    /// Whether large pictures have any with perceptual tuning. At 2.8 megapixels a round gains 0.05 and 0.14 SSIMULACRA2
    /// points at ratios of 50 and 100, and takes 14 % and 18 % of the time.
    pub includes_large_pictures: bool,
    /// For squared error, and in every try of a search. The second and the third round gain 0.01 dB each, too little to
    /// run them in every try.
    pub exact: [u32; 2],
}

/// Expected duration of an encode: seconds for a photograph of one megapixel at a ratio of 50 on one thread, and the power
/// of the number of pixels with which they grow up to 2.8 megapixels. From the means of Kodak and CLIC in
/// docs/BENCHMARKS.md, on an Intel Xeon (model 167 of family 6); efforts 6, 8 and 9 are estimates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Duration {
    pub seconds: f64,
    pub power: f64,
}

impl EffortSettings {
    /// Returns the settings of an effort.
    ///
    /// # Panics
    /// Panics if `effort` is outside `1..=9`.
    pub(crate) fn from_preset(effort: u8) -> Self {
        let level = usize::from(effort) - 1;
        let (is_fastest, is_hasty) = (effort == 1, effort <= 2);
        let (is_long, is_exhaustive) = (effort >= 6, effort >= 7);
        EffortSettings {
            fit: FitSettings {
                iterations: [
                    [40.0, 66.0, 220.0, 350.0, 590.0, 880.0, 1540.0, 2640.0, 4400.0][level],
                    // With many primitives, two thirds of the steps that few of them would get are as effective,
                    // because the moments decay faster and many primitives are relocated at first.
                    [40.0, 57.0, 280.0, 350.0, 500.0, 750.0, 1310.0, 2250.0, 3750.0][level],
                ],
                dense_exponent: [-0.1, -0.1, -0.1, -0.2, -0.3, -0.3, -0.3, -0.3, -0.3][level],
                // Small pictures can afford more sweeps. The first sweeps gain most.
                sweeps: [
                    [3, 4, 5, 6, 7, 9, 13, 17, 20][level],
                    [1, 1, 2, 3, 5, 7, 10, 14, 20][level],
                    [1, 1, 2, 2, 4, 5, 6, 8, 12][level],
                    [1, 1, 2, 2, 3, 4, 6, 8, 12][level],
                ],
                // On twelve Kodak pictures with perceptual tuning at a ratio of 200, a distance of 3 takes 0.92 of the
                // CPU time, gains 0.2 points of SSIMULACRA2 and loses 0.1 dB; at 500 and 1000 it takes 0.8 of the time
                // and gains 0.5 and 0.3 points. At effort 2 and a ratio of 200 it would lose 0.8 points and save no
                // time.
                half: if effort < 3 { HalfSize::LATE } else { HalfSize { share: 0.5, row_step: 3 } },
                base: BaseFitSettings {
                    iterations: [0.17, 0.2, 0.2, 0.2, 0.2, 0.235, 0.6, 0.6, 0.6][level],
                    exact_iterations: [0.25, 0.25, 0.5, 0.5, 0.5, 0.5, 1.0, 1.0, 1.0][level],
                    is_longer_in_large_files: (3..7).contains(&effort),
                    sweeps: [
                        [0, 0, 2, 2, 2, 2, 3, 3, 3][level],
                        [0, 0, 1, 2, 2, 2, 3, 3, 3][level],
                        [1, 1, 3, 3, 3, 3, 3, 3, 3][level],
                    ],
                    half: is_hasty.then_some(HalfSize { share: 0.7, row_step: 3 }),
                    last_rate: if is_long { 0.1 } else { 0.2 },
                    relocated_share: if is_long { 0.25 } else { 0.35 },
                    time_share: if is_hasty { 0.72 } else { 0.88 },
                    // At effort 1 and a ratio of 50, fits of five Kodak pictures at a quarter or an eighth of their size
                    // lose 1.4 points and save three quarters of the time of the fit.
                    reduction: match is_fastest {
                        true => Reduction { min_pixels_each: [20.0; 2], max_factor: 8 },
                        false => Reduction { min_pixels_each: [300.0, 75.0], max_factor: 4 },
                    },
                    weighs_pixels: !is_fastest,
                    is_checked: !is_fastest,
                },
            },
            allocation: AllocationSettings {
                base_factor: [0.3, 0.4, 1.0][level.min(2)],
                has_busy_share: !is_hasty,
                fineness: [0.42, if is_hasty { 0.71 } else { 0.42 }],
                max_sharpness: if is_exhaustive { 0.085 } else { 0.105 },
                is_patient_with_drawings: effort <= 5,
                is_patient_by_ratio: (4..=6).contains(&effort),
                tries_divisions: effort >= 4,
            },
            layer: LayerSettings {
                max_shortfall: [0.02, 0.01, 0.004][level.min(2)],
                aims_below: [0.008, 0.003, 0.0015][level.min(2)],
                has_priced_blocks: effort >= 4,
                avoids_ringing: !is_fastest,
                rounds: Rounds {
                    perceptual: [0, 0, 1, 1, 1, 1, 4, 4, 4][level],
                    in_large_files: [0, 0, 1, 2, 2, 2, 4, 4, 4][level],
                    includes_large_pictures: is_long,
                    exact: [[0, 1, 1, 3, 3, 3, 4, 4, 4][level], [0, 1, 1, 1, 1, 1, 4, 4, 4][level]],
                },
            },
            compares_quickly: !is_hasty,
            duration: Duration {
                seconds: [0.2, 0.45, 1.75, 2.0, 2.4, 4.0, 11.0, 20.0, 33.0][level],
                power: [0.9, 0.8, 0.58, 0.51, 0.39, 0.5, 0.34, 0.5, 0.5][level],
            },
        }
    }
}

impl HalfSize {
    /// The steps of Gaussians alone for squared error. On eight Kodak pictures it takes 0.7 of the time and loses 0.01 dB
    /// at ratios of 500 and 1000. At 200, where it would lose 0.08 dB, the fit uses full size.
    pub(crate) const LATE: HalfSize = HalfSize { share: 0.5, row_step: 6 };
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn higher_efforts_take_longer_and_never_do_less() {
        let all: Vec<EffortSettings> = (1..=MAX_EFFORT).map(EffortSettings::from_preset).collect();
        for pair in all.windows(2) {
            let [low, high] = [&pair[0], &pair[1]];
            assert!(low.duration.seconds < high.duration.seconds);
            assert!((0..2).all(|k| low.fit.iterations[k] < high.fit.iterations[k]));
            assert!(low.allocation.base_factor <= high.allocation.base_factor);
            assert!((0..4).all(|k| low.fit.sweeps[k] <= high.fit.sweeps[k]));
            assert!((0..3).all(|k| low.fit.base.sweeps[k] <= high.fit.base.sweeps[k]));
            assert!(low.fit.base.iterations <= high.fit.base.iterations);
            assert!(low.fit.base.exact_iterations <= high.fit.base.exact_iterations);
            assert!(low.layer.rounds.perceptual <= high.layer.rounds.perceptual);
            assert!(low.layer.max_shortfall >= high.layer.max_shortfall);
        }
    }
}
