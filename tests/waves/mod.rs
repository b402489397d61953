//! A picture for fits in tiles: waves and discs, with all channels.

use ssplat::{Channels, Pixels, Samples};

/// Waves and edges of many sizes everywhere.
pub fn picture(width: u32, height: u32, channels: Channels) -> Pixels {
    let count = channels.count();
    let samples = (0..width as usize * height as usize * count).map(|i| {
        let (k, x, y) = (i % count, (i / count % width as usize) as f32, (i / count / width as usize) as f32);
        let waves = 40.0 * (x / 9.0 + (y / 31.0).sin()).sin() + 30.0 * (y / 7.0 + (x / 23.0).cos()).sin();
        let discs = if ((x * 0.061).sin() + (y * 0.049).cos()).abs() < 0.3 { 50.0 } else { 0.0 };
        if channels.alpha() == Some(k) { 200 } else { (110.0 + waves + discs + 9.0 * k as f32).clamp(0.0, 255.0) as u8 }
    });
    Pixels::new(width, height, channels, Samples::U8(samples.collect())).unwrap()
}
