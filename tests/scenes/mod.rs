//! Synthetic pictures with the statistics of fitted ones, and their rendered code values.

use ssplat::{Blend, Channels, Depth, Gaussian, Gaussians, Samples};

/// xorshift64*: sufficient for scenes, and the same on every machine.
pub struct Random(pub u64);

impl Random {
    pub fn within(&mut self, low: f32, high: f32) -> f32 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        low + (high - low) * ((self.0.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 40) as f32 / (1u64 << 24) as f32)
    }
}

/// Log-normal scales, aspects around 2.5, colours beyond 0..=1.
pub fn scene(width: u32, height: u32, count: usize, channels: Channels, blend: Blend, seed: u64) -> Gaussians {
    let mut r = Random(seed * 7919 + 12345);
    let spacing = (width as f32 * height as f32 / count as f32).sqrt();
    let gaussians = (0..count)
        .map(|_| {
            let size = spacing * 0.4 * r.within(-1.0, 1.0).exp();
            let aspect = r.within(0.0, 1.8).exp();
            Gaussian {
                mean: [r.within(0.0, width as f32), r.within(0.0, height as f32)],
                scale: [(size * aspect.sqrt()).max(0.25), (size / aspect.sqrt()).max(0.25)],
                rotation: r.within(0.0, std::f32::consts::PI),
                color: std::array::from_fn(|_| r.within(-0.3, 1.3)),
            }
        })
        .collect();
    Gaussians { width, height, channels, depth: Depth::Eight, blend, background: [0.4, 0.7, 0.2, 0.9], list: gaussians }
}

pub fn codes(samples: Samples) -> Vec<u16> {
    match samples {
        Samples::U8(v) => v.into_iter().map(u16::from).collect(),
        Samples::U16(v) => v,
    }
}
