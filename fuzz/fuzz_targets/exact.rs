//! Decodes any bytes as the stream of a tile of the exact layer: the result is an error, or samples that are written as
//! the same bytes. Samples made of any bytes are written and read back.
#![no_main]

use arbitrary::Arbitrary;
use libfuzzer_sys::fuzz_target;
use ssplat::unstable::bitstream::ExactLayer;
use ssplat::{Channels, Depth, Pixels, Samples};

#[derive(Debug, Arbitrary)]
struct Input<'a> {
    size: [u8; 2],
    channels: u8,
    is_sixteen: bool,
    /// Which cells are covered, if the bytes are samples.
    cells: u64,
    /// The number of colours of the samples; 0 if the bytes are a stream.
    colors: u8,
    bytes: &'a [u8],
}

/// Work of a picture of 64 x 64 pixels whose samples are all literals.
const WORK: u64 = 1 << 24;

fuzz_target!(|input: Input| {
    let size = input.size.map(|length| u32::from(length) % 64 + 1);
    let channels =
        [Channels::Grey, Channels::GreyAlpha, Channels::Rgb, Channels::Rgba][usize::from(input.channels) % 4];
    let depth = if input.is_sixteen { Depth::Sixteen } else { Depth::Eight };
    let read = |stream: &[u8]| ExactLayer::from_stream(stream, size, channels, depth, WORK);
    if input.colors == 0 {
        if let Ok(layer) = read(input.bytes) {
            assert!(layer.to_stream(size, channels, depth) == input.bytes, "bytes are not canonical");
        }
        return;
    }
    let count = (size[0] * size[1]) as usize * channels.count();
    let sample = |k: usize| match input.bytes.get(k % input.bytes.len().max(1)) {
        // The product spreads few colours over all values.
        Some(&v) => u16::from(v % input.colors).wrapping_mul(0x9e37),
        None => 0,
    };
    let samples = match depth {
        Depth::Eight => Samples::U8((0..count).map(|k| (sample(k) >> 8) as u8).collect()),
        Depth::Sixteen => Samples::U16((0..count).map(sample).collect()),
    };
    let pixels = Pixels::new(size[0], size[1], channels, samples).expect("samples for all pixels");
    let layer = ExactLayer::of(&pixels, if size[0].max(size[1]) > 32 { 6 } else { 5 }, |x, y| {
        input.cells >> (y / 8 * 8 + x / 8) & 1 == 1
    });
    if layer.covered(size) == 0 {
        return;
    }
    let again = read(&layer.to_stream(size, channels, depth)).expect("what was written reads back");
    assert!(again == layer, "what was written reads differently");
});
