//! The trace of an encode: its contents, and that requesting it changes nothing else.

use ssplat::unstable::Trace;
use ssplat::unstable::{EncodeOptions, encode};
use ssplat::{Channels, Pixels, Samples, Target};

fn disc(side: u32) -> Pixels {
    let inside = |x: u32, y: u32| (x * 2).abs_diff(side).pow(2) + (y * 2).abs_diff(side).pow(2) < (side * side) / 2;
    let samples = (0..side * side).map(|i| if inside(i % side, i / side) { 230 } else { 40 }).collect();
    Pixels::new(side, side, Channels::Grey, Samples::U8(samples)).unwrap()
}

#[test]
fn a_trace_ends_with_the_written_picture_and_changes_no_byte() {
    let pixels = disc(48);
    let mut options = EncodeOptions::default();
    options.target = Target::Primitives(20);
    options.effort = 2;
    let plain = encode(&pixels, &options).unwrap();
    assert!(plain.report.trace.is_empty());
    options.trace = Trace::On;
    let traced = encode(&pixels, &options).unwrap();
    assert_eq!(plain.bytes, traced.bytes);
    let points = &traced.report.trace;
    assert!(points.windows(2).all(|p| p[0].seconds <= p[1].seconds));
    assert_eq!(points[0].stage, "fit");
    let last = points.last().unwrap();
    assert_eq!(last.stage, "written");
    // The trace is computed from rounded code values, the report is not.
    assert!((last.psnr - traced.report.psnr).abs() < 0.1, "{} {}", last.psnr, traced.report.psnr);
    // Measured: 28.3 dB and an SSIM of 0.935, from 11.3 dB and 0.42 at the first point. The margins are 1 dB and 0.02.
    assert!(points[0].psnr < 20.0 && last.psnr > 27.3, "{points:?}");
    assert!(last.ssim.is_some_and(|ssim| ssim > 0.915) && last.ms_ssim.is_none(), "{last:?}");
}
