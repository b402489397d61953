//! Uses the stable public names as a program that embeds the codec would, without `ssplat::unstable`.

use std::io::Read;
use std::ops::ControlFlow;

use ssplat::{
    Blend, Channels, Damage, Decoder, Depth, Detail, Encoder, Error, Gaussian, Gaussians, Layers, Layout, Limits,
    Parameter, Pixels, Reader, Rect, Renderer, Samples, SamplesMut, SsplatImage, Target, Thumbnail, Tune, View,
};

fn picture() -> Pixels {
    let samples = (0..96 * 64 * 3).map(|i| (i / 3 % 96 * 2 + i / 288 + i % 3 * 20) as u8).collect();
    Pixels::new(96, 64, Channels::Rgb, Samples::U8(samples)).unwrap()
}

#[test]
fn an_encoder_is_set_once_and_encodes_many_pictures() {
    let encoder = Encoder::new().bytes(400).effort(1).tune(Tune::Psnr).detail(Detail::Off);
    let first = encoder.encode(&picture()).unwrap();
    assert!(first.bytes.len() <= 400 && first.report.psnr > 25.0, "{:?}", first.report);
    assert_eq!(encoder.encode(&picture()).unwrap().bytes, first.bytes);
    let mut stages = 0;
    let watched = encoder.encode_with_progress(&picture(), &mut |_| {
        stages += 1;
        ControlFlow::Continue(())
    });
    assert!(watched.unwrap().bytes == first.bytes && stages > 10);
    let stopped = encoder.encode_with_progress(&picture(), &mut |_| ControlFlow::Break(()));
    assert!(matches!(stopped, Err(Error::Cancelled)));
}

#[test]
fn a_file_has_the_requested_number_of_gaussians() {
    let bytes = Encoder::new().gaussians(40).effort(1).encode(&picture()).unwrap().bytes;
    assert_eq!(Reader::new(&bytes, &Limits::default()).unwrap().gaussian_count(), 40);
}

#[test]
fn values_out_of_range_are_named_in_the_error() {
    for (encoder, wanted) in [
        (Encoder::new().effort(0), "effort"),
        (Encoder::new().ratio(f64::NAN), "ratio"),
        (Encoder::new().psnr(-1.0), "psnr"),
        (Encoder::new().levels(9), "levels"),
        (Encoder::new().detail(Detail::GaussianShare(1.0)), "detail"),
    ] {
        let Err(Error::Parameter { parameter, .. }) = encoder.encode(&picture()) else { panic!("{wanted}") };
        assert_eq!(parameter.name(), wanted);
    }
    let too_small = Encoder::new().bytes(10).encode(&picture());
    assert!(matches!(too_small, Err(Error::TooSmall { allowed: 10, .. })), "{too_small:?}");
}

#[test]
fn a_file_is_opened_once_and_drawn_many_times() {
    let bytes = Encoder::new().bytes(600).effort(1).encode(&picture()).unwrap().bytes;
    let reader = Reader::new(&bytes, &Limits::default()).unwrap();
    assert_eq!(
        (reader.width(), reader.height(), reader.channels(), reader.depth()),
        (96, 64, Channels::Rgb, Depth::Eight)
    );
    let image = reader.read().unwrap();
    let whole = image.render(&image.view()).unwrap();
    assert_eq!(Decoder::new().decode(&bytes).unwrap().pixels, whole);
    // All ways of rendering give the same pixels, in any memory.
    let part = image.view().crop(Rect::new(16, 8, 40, 30)).unwrap();
    let drawn = image.render(&part).unwrap();
    assert_eq!(Decoder::new().region(Rect::new(16, 8, 40, 30)).decode(&bytes).unwrap().pixels, drawn);
    let mut out = vec![0; 40 * 30 * 3];
    Decoder::new().region(Rect::new(16, 8, 40, 30)).decode_into(&bytes, SamplesMut::U8(&mut out)).unwrap();
    assert_eq!(drawn.samples(), &Samples::U8(out));
    let small = Reader::new(&bytes, &Limits::default()).unwrap().thumbnail([24, 24]).unwrap().pixels;
    assert_eq!((small.width(), small.height()), (24, 16));
    let gaussians = Decoder::new().layers(Layers::Gaussians).decode(&bytes).unwrap().pixels;
    assert_eq!(gaussians.width(), 96);
}

#[test]
fn a_region_outside_the_picture_is_named_in_the_error() {
    let bytes = Encoder::new().bytes(300).effort(1).encode(&picture()).unwrap().bytes;
    for region in [
        Rect::new(96, 0, 1, 1),
        Rect::new(90, 0, 7, 1),
        Rect::new(0, 64, 1, 1),
        Rect::new(0, 0, 0, 1),
        Rect::new(u32::MAX, 0, 2, 1),
    ] {
        let found = Decoder::new().region(region).decode(&bytes);
        let Err(Error::Parameter { parameter, problem }) = found else { panic!("{region:?}") };
        assert_eq!(parameter, Parameter::Region);
        assert!(problem.contains(&format!("{} × {} at {}, {}", region.width, region.height, region.x, region.y)));
    }
}

#[test]
fn buffers_of_the_wrong_size_are_refused() {
    let bytes = Encoder::new().bytes(300).effort(1).encode(&picture()).unwrap().bytes;
    for length in [0, 96 * 64 * 3 - 1, 96 * 64 * 3 + 1] {
        let refused = Decoder::new().decode_into(&bytes, SamplesMut::U8(&mut vec![0; length]));
        assert!(matches!(refused, Err(Error::Parameter { parameter: Parameter::Out, .. })), "{length}: {refused:?}");
    }
}

#[test]
fn files_are_read_from_memory_a_path_and_any_reader_within_the_limits() {
    let bytes = Encoder::new().bytes(300).effort(1).encode(&picture()).unwrap().bytes;
    let pixels = Decoder::new().decode(&bytes).unwrap().pixels;
    let limits = Limits::default();
    let render = |reader: Reader<'_>| {
        let image = reader.read()?;
        image.render(&image.view())
    };
    let (head, tail) = bytes.split_at(bytes.len() / 2);
    let from_read = |source: &mut dyn std::io::Read, limits: &Limits| Reader::from_read(source, limits);
    assert_eq!(render(from_read(&mut head.chain(tail), &limits).unwrap()).unwrap(), pixels);
    assert!(matches!(from_read(&mut &head[..], &limits).and_then(render), Err(Error::Format(_))));
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("picture.ssplat");
    let missing = Reader::open(&path, &limits).unwrap_err();
    assert!(matches!(missing, Error::Io(_)) && missing.to_string().contains("picture.ssplat"), "{missing}");
    std::fs::write(&path, &bytes).unwrap();
    assert_eq!(render(Reader::open(&path, &limits).unwrap()).unwrap(), pixels);
    // A stream without an end is read no further than the limit on memory allows.
    let limits = Limits::default().alloc(1 << 20);
    let mut endless = bytes.chain(std::io::repeat(0)).take(1 << 30);
    let refused = from_read(&mut endless, &limits);
    assert!(matches!(refused, Err(Error::LimitExceeded { .. })), "{refused:?}");
    assert!(endless.limit() >= (1 << 30) - (1 << 20) - 64, "{} bytes left", endless.limit());
}

/// Gaussians with values that are not on any lattice.
fn given(channels: Channels, blend: Blend, depth: Depth) -> Gaussians {
    let list = (0..300u32)
        .map(|i| {
            let f = |k: u32| (f64::from(i) * f64::from(k).sqrt()).fract() as f32;
            let color = std::array::from_fn(|k| if k < channels.count() { f(13 + 2 * k as u32) } else { 0.0 });
            let scale = [0.4 + 9.0 * f(5).powi(2), 0.3 + 5.0 * f(7)];
            Gaussian { mean: [f(2) * 97.0, f(3) * 61.0], scale, rotation: 7.0 * f(11) - 3.0, color }
        })
        .collect();
    let background = std::array::from_fn(|k| if k < channels.count() { 0.2 + 0.1 * k as f32 } else { 0.0 });
    Gaussians { width: 97, height: 61, channels, depth, blend, background, list }
}

fn gaussians_of(file: &[u8]) -> Gaussians {
    Reader::new(file, &Limits::default()).unwrap().read().unwrap().gaussians().unwrap()
}

#[test]
fn gaussians_that_were_stored_once_keep_their_values_when_they_are_stored_again() {
    let encoders = [
        Encoder::new(),
        Encoder::new().levels(3),
        Encoder::new().layout(Layout::Planes),
        Encoder::new().layout(Layout::Packed),
        Encoder::new().bytes(2500),
        Encoder::new().bytes(3000),
        Encoder::new().bytes(5000),
        Encoder::new().ratio(4.0),
    ];
    for (channels, depth) in [
        (Channels::Grey, Depth::Sixteen),
        (Channels::GreyAlpha, Depth::Eight),
        (Channels::Rgb, Depth::Eight),
        (Channels::Rgba, Depth::Sixteen),
    ] {
        for blend in [Blend::Normalized, Blend::Sum] {
            for encoder in &encoders {
                let scattered = given(channels, blend, depth);
                // Rounding takes this scale across a limit at which the step of the positions changes.
                let mut equal = scattered.clone();
                equal.list.iter_mut().for_each(|g| g.scale = [9.45, 2.0]);
                for given in [scattered, equal] {
                    let first = encoder.encode_gaussians(&given).unwrap();
                    assert_eq!(first.report.gaussians, given.list.len());
                    let once = gaussians_of(&first.bytes);
                    assert_eq!((once.channels, once.depth, once.blend), (channels, depth, blend));
                    let second = encoder.encode_gaussians(&once).unwrap();
                    assert!(gaussians_of(&second.bytes) == once, "{channels:?} {blend:?} {encoder:?}");
                    assert!(second.bytes.len() <= first.bytes.len(), "{channels:?} {blend:?} {encoder:?}");
                }
            }
        }
    }
}

#[test]
fn gaussians_of_a_file_render_its_picture() {
    let bytes = Encoder::new().bytes(600).effort(1).detail(Detail::Off).encode(&picture()).unwrap().bytes;
    let gaussians = gaussians_of(&bytes);
    let renderer =
        Renderer::new(&gaussians, &View::new(gaussians.width, gaussians.height), &Limits::default()).unwrap();
    assert_eq!(renderer.render(gaussians.depth).unwrap(), Decoder::new().decode(&bytes).unwrap().pixels);
    // Their memory is held against the limits.
    let mut limits = Limits::default();
    limits.alloc = 20 * gaussians.list.len() as u64;
    let image = Reader::new(&bytes, &limits).and_then(|reader| reader.read());
    let refused = image.and_then(|image| image.gaussians());
    assert!(matches!(refused, Err(Error::LimitExceeded { .. })), "{refused:?}");
}

#[test]
fn options_and_values_that_gaussians_cannot_have_are_named_in_the_error() {
    let sound = given(Channels::Rgb, Blend::Sum, Depth::Eight);
    let refused = |encoder: Encoder, given: &Gaussians| match encoder.encode_gaussians(given) {
        Err(Error::Parameter { parameter, .. }) => parameter.name(),
        other => panic!("{other:?}"),
    };
    for (encoder, wanted) in [
        (Encoder::new().effort(3), "effort"),
        (Encoder::new().tune(Tune::Psnr), "tune"),
        (Encoder::new().psnr(30.0), "psnr"),
        (Encoder::new().time(std::time::Duration::from_secs(1)), "time"),
        (Encoder::new().detail(Detail::GaussianShare(0.5)), "detail"),
        (Encoder::new().thumbnail(Thumbnail::Bytes(100)), "thumbnail"),
        (Encoder::new().target(Target::Gaussians(9)), "gaussians"),
        (Encoder::new().levels(2).layout(Layout::Planes), "levels"),
        (Encoder::new().bytes(20), "bytes"),
    ] {
        assert_eq!(refused(encoder, &sound), wanted);
    }
    for (wanted, change) in [
        ("mean", (|g: &mut Gaussians| g.list[3].mean[0] = f32::NAN) as fn(&mut Gaussians)),
        ("mean", |g| g.list[3].mean[1] = 70.0),
        ("scale", |g| g.list[3].scale[1] = 0.0),
        ("scale", |g| g.list[3].scale[0] = f32::INFINITY),
        ("rotation", |g| g.list[3].rotation = f32::NEG_INFINITY),
        ("color", |g| g.list[3].color[1] = 100.0),
        ("color", |g| g.list[3].color[1] = f32::NAN),
        ("background", |g| g.background[2] = f32::NAN),
        ("color", |g| g.background[2] = 50.0),
        ("width", |g| g.width = 0),
        ("height", |g| g.height = 1 << 21),
    ] {
        let mut given = sound.clone();
        change(&mut given);
        assert_eq!(refused(Encoder::new(), &given), wanted);
    }
}

/// Fails to compile for a type that threads cannot send and share.
const fn is_send_and_sync<T: Send + Sync>() {}

#[test]
fn all_public_types_can_be_sent_to_and_shared_between_threads() {
    use ssplat::report::{Chosen, SkipReason, Skipped, StageTime};
    use ssplat::{
        Backend, Decoded, EncodeReport, Encoded, FormatError, GpuError, HiddenColors, Limit, Metadata, MetadataPolicy,
        MissingParts, Progress,
    };
    const {
        is_send_and_sync::<(Encoder, Encoded, EncodeReport, Progress, Chosen, SkipReason, Skipped, StageTime)>();
        is_send_and_sync::<(Backend, Detail, HiddenColors, MetadataPolicy, Target, Thumbnail, Tune)>();
        is_send_and_sync::<(Decoder, Decoded, Reader<'_>, SsplatImage, Renderer, View, Rect, SamplesMut<'_>)>();
        is_send_and_sync::<(Damage, Layers, Layout, Limits, Metadata, MissingParts)>();
        is_send_and_sync::<(Pixels, Samples, Depth, Channels, Blend, Gaussian, Gaussians)>();
        is_send_and_sync::<(Error, FormatError, GpuError, Limit, Parameter)>();
    }
    #[cfg(feature = "image")]
    const {
        is_send_and_sync::<(ssplat::SsplatDecoder<std::fs::File>, ssplat::SsplatEncoder<Vec<u8>>)>();
    }
    #[cfg(feature = "gpu")]
    const {
        is_send_and_sync::<(ssplat::gpu::Adapters, ssplat::gpu::Device, ssplat::gpu::Renderer)>();
    }
}

/// A broken file of another format, and the cause that its decoder gives, through the chain of sources.
#[cfg(feature = "image")]
#[test]
fn errors_of_the_image_crate_keep_their_cause() {
    let folder = tempfile::tempdir().unwrap();
    let (broken, output) = (folder.path().join("broken.ssplat"), folder.path().join("out.ssplat"));
    let mut bytes = Encoder::new().bytes(300).effort(1).encode(&picture()).unwrap().bytes;
    *bytes.last_mut().unwrap() ^= 1;
    std::fs::write(&broken, bytes).unwrap();
    let error = Encoder::new().transcode(&broken, &output).unwrap_err();
    assert!(matches!(error, Error::Source { .. }), "{error:?}");
    let of_image = std::error::Error::source(&error).and_then(|e| e.downcast_ref::<image::ImageError>());
    let cause = of_image.and_then(std::error::Error::source).and_then(|e| e.downcast_ref::<Error>());
    assert!(matches!(cause, Some(Error::Format(ssplat::FormatError::Checksum { .. }))), "{cause:?}");
}

#[cfg(feature = "image")]
#[test]
fn pictures_of_the_image_crate_are_encoded_as_their_pixels() {
    let rgb = image::RgbImage::from_fn(200, 150, |x, y| image::Rgb([x as u8, y as u8, (x * y / 100) as u8]));
    let rgb = image::DynamicImage::from(rgb);
    let pictures = [
        image::DynamicImage::from(rgb.to_luma8()),
        image::DynamicImage::from(rgb.to_luma_alpha16()),
        image::DynamicImage::from(rgb.to_rgba32f()),
        rgb,
    ];
    for picture in pictures {
        let pixels = Pixels::try_from(&picture).unwrap();
        let encoder = Encoder::new().bytes(300).effort(1);
        assert!(
            encoder.encode(&picture).unwrap().bytes == encoder.encode(&pixels).unwrap().bytes,
            "{:?}",
            picture.color()
        );
    }
    let nothing = Encoder::new().encode(&image::DynamicImage::new_rgb8(0, 4));
    assert!(matches!(nothing, Err(Error::Parameter { .. })), "{nothing:?}");
}

#[cfg(feature = "image")]
#[test]
fn pictures_of_the_image_crate_are_saved_and_opened() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("picture.ssplat");
    let picture = image::DynamicImage::new_rgb8(20, 10);
    Encoder::new().effort(1).save(&picture, &path).unwrap();
    ssplat::register();
    assert_eq!(image::open(&path).unwrap().to_rgb8(), picture.to_rgb8());
    let again = folder.path().join("again.ssplat");
    Encoder::new().effort(1).transcode(&path, &again).unwrap();
    assert_eq!(image::open(again).unwrap().width(), 20);
}

#[test]
fn slices_are_pixels_and_files_go_to_writers_and_come_from_paths() {
    let samples: Vec<u8> = (0..20 * 10 * 3).map(|i| i as u8).collect();
    let pixels = Pixels::new(20, 10, Channels::Rgb, &samples[..]).unwrap();
    assert_eq!(pixels, Pixels::new(20, 10, Channels::Rgb, Samples::U8(samples.clone())).unwrap());
    let wide: Vec<u16> = samples.iter().map(|&v| 257 * u16::from(v)).collect();
    assert_eq!(Pixels::new(20, 10, Channels::Rgb, &wide[..]).unwrap().depth(), Depth::Sixteen);
    assert!(Pixels::new(20, 10, Channels::Rgb, &samples[1..]).is_err());

    let encoder = Encoder::new().bytes(300).effort(1);
    let mut written = Vec::new();
    encoder.encode_to(&pixels, &mut written).unwrap();
    assert_eq!(written, encoder.encode(&pixels).unwrap().bytes);
    let refused = encoder.encode_to(&pixels, &mut [0u8; 9][..]);
    assert!(matches!(refused, Err(Error::Io(_))), "{refused:?}");

    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("picture.ssplat");
    std::fs::write(&path, &written).unwrap();
    assert_eq!(Decoder::new().decode_file(&path).unwrap().pixels, Decoder::new().decode(&written).unwrap().pixels);
    let missing = Decoder::new().decode_file(folder.path().join("missing.ssplat")).unwrap_err().to_string();
    assert!(missing.contains("missing.ssplat"), "{missing}");
}
