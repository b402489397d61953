//! What a caller can ask of the encoder and the decoder.

use std::time::Duration;

use crate::bitstream::splats::Layout;
use crate::gaussian::Blend;
use crate::limits::Limits;
use crate::target::Target;

/// Where the fit starts and how it goes on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
#[non_exhaustive]
pub enum Recipe {
    /// Our own, as `spec/` and the README describe it.
    #[default]
    Ssplat,
    /// The pipeline of SmartSplat (AAAI 2026), with the parts of [`Ablation`].
    SmartSplat(Ablation),
}

/// Which parts of SmartSplat's initialization are used, in the order of the paper's ablation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default, Hash)]
pub enum Ablation {
    /// Random means, uniform scales, random colours.
    Random,
    /// Means by feature-guided and exclusion-based sampling.
    Means,
    /// Scales by the paper's rule as well.
    Scales,
    /// Gaussian-weighted median colours as well: the whole initialization.
    #[default]
    Colors,
}

/// How far an encode goes from SmartSplat's pipeline to ours: each rung has what those below it have. The first two belong to
/// [`Recipe::SmartSplat`], the others to [`Recipe::Ssplat`]; what is no ablation stands on the last one.
#[doc(hidden)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default, Hash)]
pub enum Rung {
    /// A fit that is rounded to the nearest integers.
    Fit,
    /// Descent over the integers.
    Descent,
    /// Squared error, step sizes in each Gaussian's own frame, and moments that forget sooner.
    Optimizer,
    /// Steps that see some of the rows.
    Sampling,
    /// A start by detail, along edges.
    Start,
    /// Relocation of the least useful primitives.
    Relocation,
    /// A price for size.
    #[default]
    Price,
}

/// Which measure the fit favours.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Tune {
    /// Squared error.
    Psnr,
    /// Structural similarity, for at most half a decibel of PSNR.
    Ssim,
    /// What eyes see from some way off, for at most .5 dB of PSNR, .1 to .3 dB in the mean: errors count by how busy the luma
    /// and its surroundings are at several sizes. The names are those that AV1's encoder has for the same choice.
    Iq,
}

/// Which device fits the picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
#[non_exhaustive]
pub enum Backend {
    /// The GPU where a hardware adapter is found and the picture is worth it, else the CPU.
    #[default]
    Auto,
    /// The CPU.
    Cpu,
    /// The GPU; an error when there is none.
    Gpu,
}

/// Which parts of a picture the encoder takes to be needed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
#[non_exhaustive]
pub enum Needs {
    /// Those that a look at the samples finds to say something; the rest is left out of the fit. The decoded picture
    /// has the caller's channels all the same.
    #[default]
    Measured,
    /// All.
    Everything,
}

/// Whether an encode measures its own progress.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
#[non_exhaustive]
pub enum Trace {
    /// Nothing is measured on the way.
    #[default]
    Off,
    /// PSNR, SSIM and MS-SSIM are measured at growing intervals and reported; the times are those without measuring,
    /// but a time budget is not extended for it.
    On,
}

/// Whether a file carries a small version of its picture, which is drawn in a hundredth of the time (spec §3).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
#[non_exhaustive]
pub enum Thumbnail {
    /// Files of 100 000 bytes and more, of pictures that are larger than it: a hundredth of the file, at most 4000 bytes.
    #[default]
    Auto,
    /// None.
    Never,
    /// Of at most so many bytes, in any file.
    Bytes(u32),
}

/// Whether a file has a detail layer, a coded transform of what the Gaussians leave (spec §11).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[non_exhaustive]
pub enum Detail {
    /// Where it pays; the encoder finds how the bytes are best divided.
    #[default]
    Auto,
    /// No layer: Gaussians alone.
    Off,
    /// The Gaussians get this share of the bytes, above 0 and below 1, and the layer the rest.
    Share(f64),
}

/// What a file carries of its source's metadata. ICC profile and EXIF block count as the file's bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
#[non_exhaustive]
pub enum Carry {
    /// What the picture needs to look as it should: the ICC profile, and of the EXIF block the orientation alone, in 26
    /// bytes, where the picture is to be turned.
    #[default]
    Needed,
    /// ICC profile and EXIF block, with all that a camera writes: its place, its time, its name.
    All,
    /// The ICC profile; a picture that is to be turned lies on its side.
    Icc,
    /// Neither.
    None,
}

/// Options of [`Encoder`](crate::Encoder).
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct EncodeOptions {
    /// What to aim at; [`Target::Auto`] is the default.
    pub target: Target,
    /// `1..=9`: how much work to spend; 5 is the default.
    pub effort: u8,
    /// Wall-clock budget of the whole encode, however many fits the target takes; the best state reached is written.
    pub time: Option<Duration>,
    /// Seed of everything random; equal seeds give equal bytes from one version of this crate, and in the planes layout from
    /// one version of zstd.
    pub seed: u64,
    /// How the integers become bytes.
    pub layout: Layout,
    /// How primitives blend; `None`: as the recipe has it.
    pub blend: Option<Blend>,
    /// The fitting recipe.
    pub recipe: Recipe,
    /// Which measure to favour; `None`: [`Tune::Iq`], but [`Tune::Psnr`] where the target is a PSNR and for the recipes of
    /// others, which count all errors alike.
    pub tune: Option<Tune>,
    /// Which device fits.
    pub backend: Backend,
    /// What to look for that can be left out.
    pub needs: Needs,
    /// Whether the file has a detail layer. Files of an asked size, ratio or quality have one, in the coded layout; files of a
    /// number of primitives have none.
    pub detail: Detail,
    /// `1..=8`: progressive levels, large primitives first, so that a file cut after a level is a whole, coarser
    /// picture. Each costs 1 to 2 % of the bytes. Only the coded layout has more than one.
    pub levels: u8,
    /// Whether the file carries a thumbnail; its bytes count as the file's.
    pub thumbnail: Thumbnail,
    /// The side of tiles that the picture is fitted in, pixels: a multiple of 128 up to 16384. `None`: pictures of more than
    /// 2²⁸ pixels are fitted in tiles of 2048, others as a whole. A picture no larger than a tile is fitted as a whole.
    ///
    /// Tiles bound the memory that a fit takes. They are fitted on the CPU, in the coded layout, for a size or a number of
    /// primitives.
    pub tiles: Option<u32>,
    /// Whether to measure quality along the way.
    pub trace: Trace,
    /// Where an ablation stops.
    #[doc(hidden)]
    pub rung: Rung,
    /// What of a source's metadata `transcode` and `encode_decoder` carry along;
    /// pixels alone have none.
    pub carry: Carry,
    /// ICC profile to carry, whatever `carry` says.
    pub icc: Option<Vec<u8>>,
    /// EXIF block to carry, from its TIFF header on, whatever `carry` says.
    pub exif: Option<Vec<u8>>,
}

impl EncodeOptions {
    /// The measure that the fit favours with these options.
    #[must_use]
    pub fn favoured(&self) -> Tune {
        let is_alike = matches!(self.target, Target::Psnr(_)) || self.recipe != Recipe::Ssplat;
        self.tune.unwrap_or(if is_alike { Tune::Psnr } else { Tune::Iq })
    }
}

impl Default for EncodeOptions {
    fn default() -> Self {
        EncodeOptions {
            target: Target::Auto,
            effort: 5,
            time: None,
            seed: 0,
            layout: Layout::Coded,
            blend: None,
            recipe: Recipe::Ssplat,
            tune: None,
            backend: Backend::Auto,
            needs: Needs::Measured,
            detail: Detail::default(),
            levels: 1,
            thumbnail: Thumbnail::Auto,
            tiles: None,
            trace: Trace::Off,
            rung: Rung::default(),
            carry: Carry::Needed,
            icc: None,
            exif: None,
        }
    }
}

/// What to do with a truncated or damaged file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
#[non_exhaustive]
pub enum Damage {
    /// Fail.
    #[default]
    Refuse,
    /// Draw the groups that are intact, if the file has any, and say what is missing.
    Accept,
}

/// Which layers of a file are drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
#[non_exhaustive]
pub enum Layers {
    /// The Gaussians and the detail layer, if there is one: the picture.
    #[default]
    Both,
    /// The Gaussians alone: the detail layer is not read.
    Gaussians,
    /// What the detail layer adds, on grey; nothing but grey where a file has none.
    Detail,
}

/// Options of [`Decoder`](crate::Decoder).
#[derive(Debug, Clone, PartialEq, Eq, Default)]
#[non_exhaustive]
pub struct DecodeOptions {
    /// What the file may ask for.
    pub limits: Limits,
    /// The part to draw: left, top, width and height, pixels of the picture; `None`: all of it.
    pub region: Option<[u32; 4]>,
    /// Width and height of the output, pixels; `None`: those of the region. Larger ones sample the continuous picture,
    /// smaller ones are low-passed as [`View::resized`](crate::raster::View::resized) says.
    pub size: Option<[u32; 2]>,
    /// What to do with a truncated or damaged file.
    pub damage: Damage,
    /// Which layers to draw.
    pub layers: Layers,
}
