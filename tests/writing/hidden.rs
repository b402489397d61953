//! Colours under alpha 0 cost no bytes and leave no fringes, unless the caller keeps them.

use ssplat::report::SkipReason;
use ssplat::{Channels, Decoder, Encoder, HiddenColors, Pixels, Samples};

/// A red disc with a white bar and soft edges on a transparent background, with the hidden colours `hidden`.
fn logo(side: u32, hidden: impl Fn(u32, u32) -> [u8; 3]) -> Pixels {
    let scale = side as f32 / 256.0;
    let sample = |i: u32| {
        let (x, y) = (i % side, i / side);
        let [u, v] = [x, y].map(|v| (v as f32 + 0.5) / scale);
        let far = (u - 128.0).hypot(v - 128.0);
        let alpha = ((108.0 - far) * scale + 0.5).clamp(0.0, 1.0);
        let is_bar = (100.0..156.0).contains(&u) && (60.0..196.0).contains(&v);
        let [r, g, b] = match alpha > 0.0 {
            true if is_bar => [255; 3],
            true => [230, 40, 30],
            false => hidden(x, y),
        };
        [r, g, b, (alpha * 255.0 + 0.5) as u8]
    };
    Pixels::new(side, side, Channels::Rgba, Samples::U8((0..side * side).flat_map(sample).collect())).unwrap()
}

fn noise(x: u32, y: u32) -> [u8; 3] {
    [1, 2, 3].map(|k| ((x * 7919 + y * 104_729 + k * 13).wrapping_mul(2_654_435_761) >> 24) as u8)
}

/// PSNR in dB of two pictures composited onto a grey of the value `ground`.
fn psnr_over(a: &Pixels, b: &Pixels, ground: f64) -> f64 {
    let (Samples::U8(a), Samples::U8(b)) = (a.samples(), b.samples()) else { panic!("8 bits") };
    let over = |p: &[u8], k: usize| ground + f64::from(p[3]) / 255.0 * (f64::from(p[k]) - ground);
    let pairs = a.chunks_exact(4).zip(b.chunks_exact(4));
    let error: f64 = pairs.map(|(p, q)| (0..3).map(|k| (over(p, k) - over(q, k)).powi(2)).sum::<f64>()).sum();
    10.0 * (255.0 * 255.0 * 3.0 * (a.len() / 4) as f64 / error).log10()
}

#[test]
fn hidden_colors_change_no_byte_and_leave_no_fringes() {
    let logos = [logo(256, |_, _| [0; 3]), logo(256, |_, _| [255; 3]), logo(256, noise)];
    let encoder = Encoder::new().bytes(5243);
    let encoded = encoder.encode(&logos[0]).unwrap();
    for other in &logos[1..] {
        assert!(encoder.encode(other).unwrap().bytes == encoded.bytes);
    }
    assert!(encoded.report.skipped.iter().any(|l| l.what == SkipReason::HiddenColors));
    let decoded = Decoder::new().decode(&encoded.bytes).unwrap().pixels;
    // 52 dB when this was written; with hidden colours in the fit 38 to 42.
    for ground in [0.0, 255.0] {
        let psnr = psnr_over(&logos[0], &decoded, ground);
        assert!(psnr > 50.0, "{psnr} over {ground}");
    }
}

#[test]
fn hidden_colors_change_no_byte_in_tiles() {
    let encoder = Encoder::new().bytes(3000).effort(1).tiles(256);
    let [black, other] = [logo(400, |_, _| [0; 3]), logo(400, noise)];
    let [a, b] = [&black, &other].map(|pixels| encoder.encode(pixels).unwrap());
    assert!(a.bytes == b.bytes);
    let decoded = Decoder::new().decode(&a.bytes).unwrap().pixels;
    let psnr = psnr_over(&black, &decoded, 255.0);
    // 45 to 48 dB when this was written; with hidden colours in the fit 37 to 39.
    assert!(psnr > 42.0, "{psnr}");
}

#[test]
fn kept_hidden_colors_are_decoded() {
    // A gradient is hidden where the logo is transparent.
    let ramp = |x: u32, y: u32| [x, y, 128].map(|v| (v / 2 + 40) as u8);
    for (side, tiles) in [(256, None), (400, Some(256))] {
        let pixels = logo(side, ramp);
        let hidden_error = |hidden| {
            let encoder = Encoder::new().ratio(30.0).effort(1).hidden_colors(hidden);
            let encoder = if let Some(side) = tiles { encoder.tiles(side) } else { encoder };
            let decoded = Decoder::new().decode(&encoder.encode(&pixels).unwrap().bytes).unwrap().pixels;
            let (Samples::U8(a), Samples::U8(b)) = (pixels.samples(), decoded.samples()) else { panic!("8 bits") };
            let clear = a.chunks_exact(4).zip(b.chunks_exact(4)).filter(|(p, _)| p[3] == 0);
            let errors = clear.flat_map(|(p, q)| (0..3).map(|k| f64::from(p[k].abs_diff(q[k])).powi(2)));
            let (count, sum) = errors.fold((0.0, 0.0), |(count, sum), e| (count + 1.0, sum + e));
            10.0 * (255.0 * 255.0 * count / sum).log10()
        };
        let [kept, lost] = [HiddenColors::Keep, HiddenColors::Continue].map(hidden_error);
        assert!(kept > 30.0 && lost < 15.0, "{side}: kept {kept} dB, continued {lost} dB");
    }
}
