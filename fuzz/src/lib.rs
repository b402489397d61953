//! Shared code of the fuzz targets: readers that split their input, pictures from fuzzed bytes, tight limits, and
//! format-aware mutations.

#[path = "../../tests/seal/layer.rs"]
mod layer;
pub mod mutate;

use std::io::Read;
use std::sync::Arc;

use arbitrary::{Arbitrary, Unstructured};
use ssplat::unstable::bitstream::lattice::Lattice;
use ssplat::unstable::bitstream::rules::most_color;
use ssplat::unstable::bitstream::splats::{Layout, PackedGaussian, PackedSplats, Steps};
use ssplat::unstable::bitstream::{DetailHead, DetailLayer, Maker};
use ssplat::{Blend, Channels, Cicp, Depth, Limits};

/// Returns the limits for fuzzed files.
pub fn tight_limits() -> Limits {
    let mut limits = Limits::default();
    limits.width = 1 << 12;
    limits.height = 1 << 12;
    limits.gaussians = 1 << 16;
    limits.tile_pairs = 1 << 20;
    limits.work = 1 << 31;
    limits.alloc = 32 << 20;
    limits.metadata = 1 << 16;
    limits
}

/// The first bytes of a task for workers of the present version.
pub fn task_head() -> Vec<u8> {
    let manifest = include_str!("../../Cargo.toml");
    let version = manifest.lines().find_map(|line| line.strip_prefix("version = \"")?.strip_suffix('"'));
    format!("ssplat task 1, {}\n", version.expect("the package has a version")).into_bytes()
}

/// Allocator overhead, error values and memory of the target itself, bytes.
pub const SLACK: u64 = 1 << 20;

/// A reader that returns its bytes in pieces of 1, 2, 3, … bytes.
pub struct Sliced<'a> {
    bytes: &'a [u8],
    piece: usize,
}

impl<'a> Sliced<'a> {
    pub fn new(bytes: &'a [u8]) -> Self {
        Sliced { bytes, piece: 0 }
    }
}

impl Read for Sliced<'_> {
    fn read(&mut self, buf: &mut [u8]) -> std::io::Result<usize> {
        self.piece = self.piece % 7 + 1;
        let n = self.piece.min(buf.len()).min(self.bytes.len());
        buf[..n].copy_from_slice(&self.bytes[..n]);
        self.bytes = &self.bytes[n..];
        Ok(n)
    }
}

/// A valid picture without Gaussians.
#[derive(Debug, Clone)]
pub struct Head(pub PackedSplats);

impl<'a> Arbitrary<'a> for Head {
    fn arbitrary(u: &mut Unstructured<'a>) -> arbitrary::Result<Self> {
        let layout = *u.choose(&[Layout::Packed, Layout::Planes, Layout::Coded])?;
        let channels = *u.choose(&[Channels::Grey, Channels::GreyAlpha, Channels::Rgb, Channels::Rgba])?;
        let (width, height) = (u.int_in_range(1..=300)?, u.int_in_range(1..=300)?);
        let coarsest = u.int_in_range(-6..=9)?;
        let most = if layout == Layout::Packed { 0 } else { 15.min(coarsest + 10) };
        let steps = Steps {
            scale: u.int_in_range(0..=15)?,
            angle: u.int_in_range(0..=3)?,
            position: u.int_in_range(0..=15)?,
            coarsest,
            range: u.int_in_range(0..=most)? as u8,
            luma: u.int_in_range(0..=15)?,
            chroma: u.int_in_range(0..=3)?,
        };
        let wide = wide_colors(u, &steps, channels)?;
        let colors = if u.arbitrary()? {
            Some((0..=u.int_in_range(0..=20)?).map(|_| color(u, channels, wide)).collect::<Result<Vec<_>, _>>()?)
        } else {
            None
        };
        Ok(Head(PackedSplats {
            width,
            height,
            channels,
            depth: if u.arbitrary()? { Depth::Eight } else { Depth::Sixteen },
            blend: if u.arbitrary()? { Blend::Normalized } else { Blend::Sum },
            layout,
            steps,
            background: color(u, channels, wide)?,
            codebook: colors,
            gaussians: Vec::new(),
            levels: Vec::new(),
            detail: None,
            exact: None,
            metadata: Default::default(),
        }))
    }
}

/// A picture with valid integers.
#[derive(Debug, Clone)]
pub struct Legal(pub PackedSplats);

impl<'a> Arbitrary<'a> for Legal {
    fn arbitrary(u: &mut Unstructured<'a>) -> arbitrary::Result<Self> {
        let mut splats = Head::arbitrary(u)?.0;
        let PackedSplats { steps, width, height, channels, .. } = splats;
        let lattice = Lattice::new(&steps, splats.layout);
        let wide = wide_colors(u, &steps, channels)?;
        if u.arbitrary()? {
            splats.metadata.icc = Some(u.arbitrary()?);
        }
        if u.arbitrary()? {
            splats.metadata.exif = Some(u.arbitrary()?);
        }
        // Of bytes that the seeds have already.
        if let Some(&[primaries, transfer, flag, ..]) = splats.metadata.exif.as_deref() {
            splats.metadata.cicp = Cicp::from_bytes(&[primaries, transfer, 0, flag & 1]).ok();
        }
        if u.arbitrary()? {
            splats.metadata.thumbnail = Some(u.arbitrary()?);
        }
        if splats.layout == Layout::Coded && u.arbitrary()? {
            splats.detail = Levels::layer(u.arbitrary()?, [width, height], channels);
        }
        let top = (22 * 32 / (u32::from(steps.scale) + 4)).min(255) as u8;
        while !u.is_empty() && splats.gaussians.len() < 300 {
            let major = u.int_in_range(0..=top)?;
            let minor = u.int_in_range(0..=major)?;
            let angle = u.int_in_range(0..=lattice.angles(major, minor) - 1)?;
            let [ex, ey] = lattice.exponents(major, minor, angle);
            splats.gaussians.push(PackedGaussian {
                x: u.int_in_range(0..=Lattice::positions(width, ex) - 1)?,
                y: u.int_in_range(0..=Lattice::positions(height, ey) - 1)?,
                major,
                minor,
                angle,
                color: match &splats.codebook {
                    Some(book) => *u.choose(book)?,
                    None => color(u, channels, wide)?,
                },
            });
        }
        Ok(Legal(splats))
    }
}

/// Returns the maximum magnitudes of colour integers: those that the format allows, or moderate ones as in real
/// pictures.
fn wide_colors(u: &mut Unstructured<'_>, steps: &Steps, channels: Channels) -> arbitrary::Result<[i16; 4]> {
    let most = most_color(steps, channels);
    Ok(if u.arbitrary()? { most } else { most.map(|m| m / 8 + 1) })
}

/// Returns a colour with magnitudes up to `most`.
fn color(u: &mut Unstructured<'_>, channels: Channels, most: [i16; 4]) -> arbitrary::Result<[i16; 4]> {
    let mut color = [0; 4];
    for (c, most) in color[..channels.count()].iter_mut().zip(most) {
        *c = u.int_in_range(-most..=most)?;
    }
    Ok(color)
}

/// Random levels of a detail layer.
pub struct Levels {
    random: mutate::Random,
    /// One of this many blocks has levels.
    filled: usize,
    classes: u8,
    largest: i16,
}

impl Levels {
    /// Returns a layer for a picture of this size with these channels; `None` for invalid kinds of heads.
    pub fn layer(seed: u64, size: [u32; 2], channels: Channels) -> Option<Arc<DetailLayer>> {
        let mut random = mutate::Random::new(seed);
        let mut head = if random.below(2) == 0 { DetailHead::PLAIN } else { DetailHead::SEEN };
        head.step = random.next() as u16;
        match random.below(8) {
            0 => head.chroma = [random.next() as u8, random.next() as u8],
            1 => head.slopes = [random.next() as u8, random.next() as u8],
            2 => head.sizes = [[random.below(4) as u8, 3], [0, random.below(4) as u8]],
            3 => head.biases = [random.below(16) as u8, random.below(16) as u8],
            4 => head.classes = 1 + random.below(8) as u8,
            5 => head.alpha = channels.alpha().is_some(),
            _ => {}
        }
        let filled = 1 + random.below(40);
        let largest = [1, 3, 20, 32_767][random.below(4)];
        let mut levels = Levels { random, filled, classes: head.classes, largest };
        DetailLayer::made(head, channels, size, &mut levels).ok().map(Arc::new)
    }
}

impl Maker for Levels {
    fn class(&mut self, _tile: usize, _superblock: [usize; 2]) -> u8 {
        self.random.below(self.classes.into()) as u8
    }

    fn is_divided(&mut self, _tile: usize, _kind: usize, _cell: [usize; 2], _size: usize) -> bool {
        self.random.below(3) == 0
    }

    fn levels(&mut self, _tile: usize, _plane: usize, _cell: [usize; 2], size: usize) -> Vec<(u8, u8, i16)> {
        let random = &mut self.random;
        if random.below(self.filled) > 0 {
            return Vec::new();
        }
        let mut levels = std::collections::BTreeMap::new();
        for _ in 0..1 + random.below(6) {
            let place = (random.below(4 << size) as u8, random.below(4 << size) as u8);
            let magnitude = 1 + random.below(self.largest as usize) as i16;
            levels.insert(place, if random.below(2) == 0 { magnitude } else { -magnitude });
        }
        levels.into_iter().map(|((u, v), level)| (u, v, level)).collect()
    }
}
