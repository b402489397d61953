//! Synthetic scenes with the statistics of fitted ones: clustered centres, and neighbours of similar shape and colour.

#![allow(dead_code, reason = "each test crate uses its own part")]

use std::collections::BTreeMap;
use std::sync::Arc;

use ssplat::unstable::bitstream::lattice::Lattice;
use ssplat::unstable::bitstream::splats::{Layout, PackedGaussian, PackedSplats, Steps};
use ssplat::unstable::bitstream::{DetailHead, DetailLayer, Maker};
use ssplat::unstable::quantize::Quantizer;
use ssplat::{Blend, Channels, Depth, Gaussian};

/// Splitmix64.
pub struct Random(pub u64);

impl Random {
    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ z >> 31
    }

    /// Returns a uniformly distributed number in `0..1`.
    pub fn unit(&mut self) -> f32 {
        (self.next() >> 40) as f32 / (1u64 << 24) as f32
    }

    /// Returns an approximately normally distributed number with a standard deviation of 1.
    pub fn normal(&mut self) -> f32 {
        (0..12).map(|_| self.unit()).sum::<f32>() - 6.0
    }

    pub fn below(&mut self, n: u64) -> u64 {
        self.next() % n
    }
}

/// Parameters of a scene.
pub struct Scene {
    pub layout: Layout,
    pub channels: Channels,
    pub size: [u32; 2],
    pub count: usize,
    pub codebook: bool,
    pub seed: u64,
    pub steps: Steps,
}

impl Default for Scene {
    fn default() -> Self {
        Scene {
            layout: Layout::Coded,
            channels: Channels::Rgb,
            size: [384, 256],
            count: 100,
            codebook: false,
            seed: 0,
            steps: Steps { scale: 0, angle: 1, position: 4, coarsest: 2, range: 6, luma: 6, chroma: 2 },
        }
    }
}

/// Returns the scene's integers.
pub fn scene(scene: &Scene) -> PackedSplats {
    let mut random = Random(scene.seed);
    let mut steps = scene.steps;
    if scene.layout == Layout::Packed {
        (steps.range, steps.coarsest) = (0, -1);
    }
    let quantizer = Quantizer::new(&steps, scene.layout, scene.size, scene.channels);
    let [w, h] = scene.size.map(|s| s as f32);
    let clusters: Vec<([f32; 2], f32, f32, [f32; 4])> = (0..8)
        .map(|_| {
            let center = [random.unit() * w, random.unit() * h];
            (center, random.unit() * 3.0, 0.05 + 0.2 * random.unit(), std::array::from_fn(|_| random.unit()))
        })
        .collect();
    let mut gaussians: Vec<PackedGaussian> = (0..scene.count)
        .map(|_| {
            let (center, turn, spread, color) = clusters[random.below(8) as usize];
            let size = (w * h / scene.count as f32).sqrt() * spread * 2.0;
            let g = Gaussian {
                mean: [
                    (center[0] + random.normal() * spread * w).clamp(0.0, w - 0.01),
                    (center[1] + random.normal() * spread * h).clamp(0.0, h - 0.01),
                ],
                scale: [size * (0.5 * random.normal()).exp(), size * (0.5 * random.normal()).exp()],
                rotation: turn + 0.3 * random.normal(),
                color: color.map(|c| c + 0.15 * random.normal()),
            };
            quantizer.quantize(&g)
        })
        .collect();
    let mut codebook = None;
    if scene.codebook {
        let mut book: Vec<[i16; 4]> = gaussians.iter().take(16).map(|p| p.color).collect();
        book.push([0; 4]);
        for (i, p) in gaussians.iter_mut().enumerate() {
            p.color = book[i % book.len()];
        }
        book.sort_unstable();
        book.dedup();
        codebook = Some(book);
    }
    let background = quantizer.quantize_color([0.5, 0.4, 0.3, 1.0]);
    PackedSplats {
        width: scene.size[0],
        height: scene.size[1],
        channels: scene.channels,
        depth: Depth::Eight,
        blend: Blend::Normalized,
        layout: scene.layout,
        steps,
        background,
        codebook,
        gaussians,
        levels: Vec::new(),
        detail: None,
        exact: None,
        metadata: Default::default(),
    }
}

/// Returns any valid primitive: uniform over its integers.
pub fn any_primitive(splats: &PackedSplats, random: &mut Random) -> PackedGaussian {
    let lattice = Lattice::new(&splats.steps, splats.layout);
    let top = (22.0 * 32.0 / (f64::from(splats.steps.scale) + 4.0)).floor().min(255.0) as u64;
    let major = random.below(top + 1) as u8;
    let minor = random.below(u64::from(major) + 1) as u8;
    let angle = random.below(lattice.angles(major, minor).into()) as u16;
    let [ex, ey] = lattice.exponents(major, minor, angle);
    let mut color = [0i16; 4];
    let most = splats.quantizer().most_color();
    for (c, most) in color[..splats.channels.count()].iter_mut().zip(most) {
        *c = random.below(2 * most as u64 + 1) as i16 - most;
    }
    PackedGaussian {
        x: random.below(Lattice::positions(splats.width, ex).into()) as u32,
        y: random.below(Lattice::positions(splats.height, ey).into()) as u32,
        major,
        minor,
        angle,
        color,
    }
}

/// Random levels of a detail layer: many at low frequencies, few at high ones.
pub struct Levels {
    pub random: Random,
    /// Number of step classes to choose from.
    pub classes: u8,
    /// One of this many blocks has levels; 0: none has.
    pub filled: u64,
    /// Maximum number of levels of a filled block.
    pub most: u64,
    /// Maximum level.
    pub largest: i16,
    /// Index of a tile without levels.
    pub empty: Option<usize>,
}

impl Levels {
    pub fn new(seed: u64) -> Self {
        Levels { random: Random(seed), classes: 1, filled: 2, most: 12, largest: 6, empty: None }
    }
}

impl Maker for Levels {
    fn class(&mut self, _tile: usize, _superblock: [usize; 2]) -> u8 {
        self.random.below(self.classes.into()) as u8
    }

    fn is_divided(&mut self, _tile: usize, _kind: usize, _cell: [usize; 2], _size: usize) -> bool {
        self.random.below(2) == 0
    }

    fn levels(&mut self, tile: usize, _plane: usize, _cell: [usize; 2], size: usize) -> Vec<(u8, u8, i16)> {
        let random = &mut self.random;
        if self.empty == Some(tile) || self.filled == 0 || random.below(self.filled) > 0 {
            return Vec::new();
        }
        let mut levels = BTreeMap::new();
        for _ in 0..1 + random.below(self.most) {
            // The minimum of two, which prefers low frequencies.
            let mut frequency = || random.below(4 << size).min(random.below(4 << size)) as u8;
            let place = (frequency(), frequency());
            let size = 1 + random.below(self.largest as u64).min(random.below(self.largest as u64)) as i16;
            levels.insert(place, if random.below(2) == 0 { size } else { -size });
        }
        levels.into_iter().map(|((u, v), level)| (u, v, level)).collect()
    }
}

/// Returns `splats` with a layer of random levels.
pub fn with_layer(mut splats: PackedSplats, head: DetailHead, mut levels: Levels) -> PackedSplats {
    levels.classes = head.classes;
    let size = [splats.width, splats.height];
    let layer = DetailLayer::made(head, splats.channels, size, &mut levels).unwrap();
    splats.detail = Some(Arc::new(layer));
    splats
}
