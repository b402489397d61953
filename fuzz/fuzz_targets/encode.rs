//! Encodes tiny pictures with any valid options: the result is a file within the requested size that decodes to the
//! same dimensions, is the same twice, or one of the few typed errors that the options allow.
#![no_main]

use arbitrary::{Arbitrary, Unstructured};
use libfuzzer_sys::fuzz_target;
use ssplat::unstable::bitstream::splats::Layout;
use ssplat::unstable::{EncodeOptions, Needs};
use ssplat::{Blend, Channels, Detail, Error, Limits, Parameter, Pixels, Samples, Target, Thumbnail, Tune};

#[derive(Debug)]
struct Input {
    pixels: Pixels,
    options: EncodeOptions,
}

impl<'a> Arbitrary<'a> for Input {
    fn arbitrary(u: &mut Unstructured<'a>) -> arbitrary::Result<Self> {
        let mut options = EncodeOptions::default();
        options.target = match u.int_in_range(0..=3)? {
            0 => Target::Ratio(f64::from(u.int_in_range(1..=100u8)?)),
            1 => Target::Bytes(u.int_in_range(0..=400)?),
            2 => Target::Gaussians(u.int_in_range(0..=30)?),
            _ => Target::Psnr(f64::from(u.int_in_range(5..=40u8)?)),
        };
        options.effort = 1;
        options.icc = u.arbitrary::<bool>()?.then(|| vec![1; 700]);
        options.seed = u.arbitrary()?;
        options.layout = *u.choose(&[Layout::Packed, Layout::Planes, Layout::Coded])?;
        options.blend = *u.choose(&[None, Some(Blend::Normalized), Some(Blend::Sum)])?;
        options.tune = *u.choose(&[None, Some(Tune::Psnr), Some(Tune::Iq)])?;
        options.backend = ssplat::Backend::Cpu;
        options.needs = *u.choose(&[Needs::Measured, Needs::Everything])?;
        let is_coded = options.layout == Layout::Coded;
        options.levels = if is_coded { u.int_in_range(1..=8)? } else { 1 };
        options.detail = match u.int_in_range(0..=3u8)? {
            0 => Detail::Off,
            1 if is_coded && !matches!(options.target, Target::Gaussians(_)) => {
                Detail::GaussianShare(f64::from(u.int_in_range(1..=254u8)?) / 255.0)
            }
            _ => Detail::Auto,
        };
        options.thumbnail = match u.int_in_range(0..=2u8)? {
            0 => Thumbnail::Auto,
            1 => Thumbnail::Never,
            _ => Thumbnail::Bytes(u.int_in_range(0..=200)?),
        };
        for block in [&mut options.icc, &mut options.exif] {
            if u.ratio(1, 4)? {
                *block = Some(vec![u.arbitrary()?; u.int_in_range(0..=40)?]);
            }
        }
        // Often shorter than the fit.
        options.time =
            if u.ratio(1, 8)? { Some(std::time::Duration::from_micros(u.arbitrary::<u16>()?.into())) } else { None };
        // Seldom wide enough for two tiles, which takes longer.
        let is_tiled = u.ratio(1, 32)?;
        options.tiles = if is_tiled { Some(128) } else { None };
        let channels = *u.choose(&[Channels::Grey, Channels::GreyAlpha, Channels::Rgb, Channels::Rgba])?;
        let (width, height) = (u.int_in_range(1..=24)? + if is_tiled { 128 } else { 0 }, u.int_in_range(1..=24)?);
        let count = (width * height) as usize * channels.count();
        // The picture repeats a few fuzzed bytes.
        let seed: Vec<u16> = (0..u.int_in_range(1..=32)?).map(|_| u.arbitrary()).collect::<Result<_, _>>()?;
        let values = seed.iter().copied().cycle().take(count);
        let samples = if u.arbitrary()? {
            Samples::U8(values.map(|v| v as u8).collect())
        } else {
            Samples::U16(values.collect())
        };
        let pixels = Pixels::new(width, height, channels, samples).expect("sizes agree");
        Ok(Input { pixels, options })
    }
}

fuzz_target!(|input: Input| {
    let Input { pixels, options } = input;
    let encoded = match ssplat::unstable::encode(&pixels, &options) {
        Ok(encoded) => encoded,
        // These options can request too small a file or too high a quality; nothing else is refused.
        Err(Error::TooSmall { .. }) if matches!(options.target, Target::Bytes(_) | Target::Ratio(_)) => return,
        Err(Error::Parameter { parameter: Parameter::Psnr, .. }) if matches!(options.target, Target::Psnr(_)) => return,
        Err(Error::Parameter { parameter: Parameter::Thumbnail, .. })
            if matches!(options.thumbnail, Thumbnail::Bytes(_)) =>
        {
            return;
        }
        Err(e) => panic!("{e}"),
    };
    if let Target::Bytes(most) = options.target {
        assert!(encoded.bytes.len() as u64 <= most, "{} bytes of {most}", encoded.bytes.len());
    }
    // With a time limit, the progress of a fit is not deterministic.
    if options.time.is_none() {
        let again = ssplat::unstable::encode(&pixels, &options).expect("it succeeded before");
        assert!(encoded.bytes == again.bytes, "two runs differ");
    }
    let splats =
        ssplat::unstable::bitstream::read(&encoded.bytes[..], &Limits::default()).expect("what was encoded reads");
    let shape = (splats.width, splats.height, splats.channels, splats.depth);
    assert_eq!(shape, (pixels.width(), pixels.height(), pixels.channels(), pixels.depth()));
    assert_eq!(splats.gaussians.len(), encoded.report.gaussians);
});
