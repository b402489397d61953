//! Guarantees for users of the `image` crate: opening by name and by content, limits, metadata, all colour types.

use std::io::{self, Cursor, Read};

use image::error::LimitErrorKind;
use image::{ColorType, DynamicImage, ExtendedColorType, ImageDecoder, ImageEncoder, ImageError, ImageReader};
use ssplat::unstable::EncodeOptions;
use ssplat::unstable::bitstream::splats::{Layout, Metadata, PackedSplats, Steps};
use ssplat::unstable::quantize::Quantizer;
use ssplat::{
    Blend, Channels, Depth, Error, Gaussian, Limits, MetadataPolicy, Parameter, Pixels, SsplatDecoder, SsplatEncoder,
    Target,
};
use ssplat::{Renderer, View};

const WIDTH: u32 = 83;
const HEIGHT: u32 = 150;
const CHANNELS: [Channels; 4] = [Channels::Grey, Channels::GreyAlpha, Channels::Rgb, Channels::Rgba];

/// A picture of a few primitives.
fn splats(channels: Channels, depth: Depth, metadata: Metadata) -> PackedSplats {
    let steps = Steps { scale: 2, angle: 1, position: 6, coarsest: -2, range: 0, luma: 6, chroma: 1 };
    let layout = Layout::Packed;
    let q = Quantizer::new(&steps, layout, [WIDTH, HEIGHT], channels);
    let gaussian = |i: u8| Gaussian {
        mean: [f32::from(i % 5) * 18.0 + 4.0, f32::from(i / 5) * 30.0 + 9.0],
        scale: [9.0 + f32::from(i % 3) * 4.0, 5.0],
        rotation: f32::from(i) * 0.4,
        color: [0.1 * f32::from(i % 7), 0.04 * f32::from(i), 1.0 - 0.05 * f32::from(i), 0.9],
    };
    PackedSplats {
        width: WIDTH,
        height: HEIGHT,
        channels,
        depth,
        blend: Blend::Normalized,
        layout,
        steps,
        background: q.quantize_color([0.4, 0.5, 0.3, 1.0]),
        codebook: None,
        gaussians: (0..25).map(|i| q.quantize(&gaussian(i))).collect(),
        levels: Vec::new(),
        detail: None,
        exact: None,
        metadata,
    }
}

fn file(channels: Channels, depth: Depth) -> Vec<u8> {
    ssplat::unstable::bitstream::to_bytes(&splats(channels, depth, Metadata::default())).unwrap()
}

/// The picture as the crate itself renders it.
fn expected(channels: Channels, depth: Depth) -> Pixels {
    let limits = Limits::default();
    let picture = ssplat::unstable::bitstream::read(&file(channels, depth)[..], &limits).unwrap().to_gaussians();
    Renderer::new(&picture, &View::new(picture.width, picture.height), &limits).unwrap().render(depth).unwrap()
}

/// A PNG that states sides of 2²⁰ pixels but has no samples.
fn lying_png() -> Vec<u8> {
    let mut png = Vec::new();
    DynamicImage::new_rgba16(1, 1).write_to(&mut Cursor::new(&mut png), image::ImageFormat::Png).unwrap();
    // The sides in the first chunk, and its checksum.
    png[16..24].copy_from_slice(&[0, 16, 0, 0, 0, 16, 0, 0]);
    let checksum = crc32fast::hash(&png[12..29]).to_be_bytes();
    png[29..33].copy_from_slice(&checksum);
    png
}

/// `image` alone would allocate 8 TiB and abort the process.
#[test]
fn a_picture_that_claims_a_huge_size_is_a_limits_error() {
    let folder = tempfile::tempdir().unwrap();
    let (input, output) = (folder.path().join("a.png"), folder.path().join("a.ssplat"));
    std::fs::write(&input, lying_png()).unwrap();
    let refused = |found: Result<(), Error>| matches!(found, Err(Error::Source { error: ImageError::Limits(_), .. }));
    let encoder = ssplat::Encoder::new().effort(1);
    assert!(refused(encoder.transcode(&input, &output).map(drop)));
    assert!(!output.exists());
    let mut reader = ImageReader::new(Cursor::new(lying_png())).with_guessed_format().unwrap();
    reader.no_limits();
    assert!(refused(encoder.encode_decoder(reader.into_decoder().unwrap()).map(drop)));
}

fn metadata() -> Metadata {
    let mut metadata = Metadata::default();
    metadata.icc = Some((0..=255).cycle().take(3000).collect());
    // A TIFF header and one entry: orientation 6.
    let exif = b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0";
    metadata.exif = Some(exif.to_vec());
    metadata
}

#[test]
fn opens_by_extension_and_by_content() {
    assert!(ssplat::register());
    assert!(ssplat::register(), "registering again says the same");
    let bytes = file(Channels::Rgb, Depth::Eight);
    let expected = DynamicImage::from(expected(Channels::Rgb, Depth::Eight));

    let folder = tempfile::tempdir().unwrap();
    let named = folder.path().join("picture.SSPLAT");
    std::fs::write(&named, &bytes).unwrap();
    assert!(image::open(&named).unwrap() == expected);
    assert!(ImageReader::open(&named).unwrap().decode().unwrap() == expected);

    let unnamed = folder.path().join("picture");
    std::fs::write(&unnamed, &bytes).unwrap();
    assert!(ImageReader::open(&unnamed).unwrap().decode().is_err());
    assert!(ImageReader::open(&unnamed).unwrap().with_guessed_format().unwrap().decode().unwrap() == expected);
    let misnamed = folder.path().join("picture.png");
    std::fs::write(&misnamed, &bytes).unwrap();
    assert!(ImageReader::open(&misnamed).unwrap().with_guessed_format().unwrap().decode().unwrap() == expected);

    assert!(image::load_from_memory(&bytes).unwrap() == expected);
    assert_eq!(ImageReader::open(&named).unwrap().into_dimensions().unwrap(), (WIDTH, HEIGHT));
}

#[test]
fn every_colour_type_is_decoded_unchanged() {
    let types = [
        [ColorType::L8, ColorType::La8, ColorType::Rgb8, ColorType::Rgba8],
        [ColorType::L16, ColorType::La16, ColorType::Rgb16, ColorType::Rgba16],
    ];
    for (depth, types) in [Depth::Eight, Depth::Sixteen].into_iter().zip(types) {
        for (channels, color) in CHANNELS.into_iter().zip(types) {
            let decoder = SsplatDecoder::new(Cursor::new(file(channels, depth))).unwrap();
            assert_eq!(decoder.color_type(), color);
            assert_eq!(decoder.original_color_type(), color.into());
            assert_eq!(decoder.total_bytes(), u64::from(WIDTH * HEIGHT) * u64::from(color.bytes_per_pixel()));
            let picture = DynamicImage::from_decoder(decoder).unwrap();
            assert!(picture == DynamicImage::from(expected(channels, depth)), "{color:?}");
            assert!(Pixels::try_from(&picture).unwrap() == expected(channels, depth), "{color:?}");
            assert!(Pixels::try_from(picture).unwrap() == expected(channels, depth), "{color:?}");
        }
    }
}

#[test]
fn sixteen_bits_decode_into_a_buffer_at_an_odd_address() {
    let decoder = SsplatDecoder::new(Cursor::new(file(Channels::Rgb, Depth::Sixteen))).unwrap();
    let mut buf = vec![0u8; decoder.total_bytes() as usize + 2];
    let start = 1 + buf.as_ptr().addr() % 2;
    let end = start + decoder.total_bytes() as usize;
    decoder.read_image(&mut buf[start..end]).unwrap();
    let picture = DynamicImage::from(expected(Channels::Rgb, Depth::Sixteen));
    assert!(buf[start..end] == *picture.as_bytes());
}

#[test]
fn icc_profile_and_exif_are_returned_unchanged() {
    let bytes = ssplat::unstable::bitstream::to_bytes(&splats(Channels::Rgb, Depth::Eight, metadata())).unwrap();
    let mut decoder = SsplatDecoder::new(&bytes[..]).unwrap();
    assert_eq!(decoder.icc_profile().unwrap(), metadata().icc);
    assert_eq!(decoder.exif_metadata().unwrap(), metadata().exif);
    assert_eq!(decoder.orientation().unwrap(), image::metadata::Orientation::Rotate90);
    // The orientation is kept, not applied.
    assert!(DynamicImage::from_decoder(decoder).unwrap() == expected(Channels::Rgb, Depth::Eight).into());
    let mut plain = SsplatDecoder::new(Cursor::new(file(Channels::Rgb, Depth::Eight))).unwrap();
    assert_eq!((plain.icc_profile().unwrap(), plain.exif_metadata().unwrap()), (None, None));
}

/// Counts the bytes that are read.
struct Counting<'a>(Cursor<Vec<u8>>, &'a std::cell::Cell<usize>);

impl Read for Counting<'_> {
    fn read(&mut self, buf: &mut [u8]) -> io::Result<usize> {
        let n = self.0.read(buf)?;
        self.1.set(self.1.get() + n);
        Ok(n)
    }
}

#[test]
fn only_the_header_is_read_before_the_limits_are_set() {
    let read = std::cell::Cell::new(0);
    let mut decoder = SsplatDecoder::new(Counting(Cursor::new(file(Channels::Rgb, Depth::Eight)), &read)).unwrap();
    assert!(read.get() <= 24, "{} bytes read", read.get());
    decoder.set_limits(image::Limits::default()).unwrap();
    assert!(read.get() <= 24, "{} bytes read", read.get());
}

#[track_caller]
fn limit_of(result: Result<impl Sized, ImageError>) -> LimitErrorKind {
    match result {
        Err(ImageError::Limits(e)) => e.kind(),
        Err(other) => panic!("{other:?}"),
        Ok(_) => panic!("not limited"),
    }
}

#[test]
fn limits_are_enforced() {
    assert!(ssplat::register());
    let decode = |width, height, alloc| {
        let mut limits = image::Limits::no_limits();
        (limits.max_image_width, limits.max_image_height, limits.max_alloc) = (width, height, alloc);
        let mut reader = ImageReader::new(Cursor::new(file(Channels::Rgb, Depth::Eight)));
        reader.limits(limits);
        reader.with_guessed_format().unwrap().decode()
    };
    let output = u64::from(WIDTH * HEIGHT * 3);
    assert_eq!(limit_of(decode(Some(WIDTH - 1), None, None)), LimitErrorKind::DimensionError);
    assert_eq!(limit_of(decode(None, Some(HEIGHT - 1), None)), LimitErrorKind::DimensionError);
    assert_eq!(limit_of(decode(None, None, Some(output - 1))), LimitErrorKind::InsufficientMemory);
    // The output fits, but not the memory for rendering it.
    assert_eq!(limit_of(decode(None, None, Some(output + 100))), LimitErrorKind::InsufficientMemory);
    decode(Some(WIDTH), Some(HEIGHT), Some(output + (1 << 20))).unwrap();
    decode(None, None, None).unwrap();
}

#[test]
fn limits_set_late_apply_to_data_already_read() {
    let mut splats = splats(Channels::Rgb, Depth::Eight, Metadata::default());
    splats.metadata.icc = Some(vec![7; 5000]);
    let bytes = ssplat::unstable::bitstream::to_bytes(&splats).unwrap();
    let output = u64::from(WIDTH * HEIGHT * 3);
    let late = |alloc| {
        let mut decoder = SsplatDecoder::new(&bytes[..])?;
        assert!(decoder.icc_profile()?.is_some());
        let mut limits = image::Limits::no_limits();
        limits.max_alloc = Some(alloc);
        decoder.set_limits(limits)?;
        decoder.read_image(&mut vec![0; output as usize])
    };
    // The profile and the integers are already in memory.
    assert_eq!(limit_of(late(5000)), LimitErrorKind::InsufficientMemory);
    // The renderer is not.
    assert_eq!(limit_of(late(6000)), LimitErrorKind::InsufficientMemory);
    late(1 << 20).unwrap();
}

#[test]
fn broken_files_are_decoding_errors() {
    assert!(ssplat::register());
    let bytes = file(Channels::Rgb, Depth::Eight);
    for end in 0..bytes.len() {
        let error = SsplatDecoder::new(&bytes[..end]).and_then(DynamicImage::from_decoder).unwrap_err();
        let ImageError::Decoding(e) = error else { panic!("{error:?} at {end}") };
        assert!(std::error::Error::source(&e).is_some_and(|e| e.is::<ssplat::Error>()), "{e:?}");
    }
    let mut newer = bytes.clone();
    newer[4] = 200;
    assert!(matches!(SsplatDecoder::new(&newer[..]), Err(ImageError::Unsupported(_))));
    assert!(image::load_from_memory(&bytes[..16]).is_err());
}

/// A reader that fails.
#[derive(Debug)]
struct Failing;

impl Read for Failing {
    fn read(&mut self, _: &mut [u8]) -> io::Result<usize> {
        Err(io::Error::new(io::ErrorKind::PermissionDenied, "for a test"))
    }
}

#[test]
fn errors_of_the_reader_stay_io_errors() {
    let error = SsplatDecoder::new(Failing).unwrap_err();
    assert!(matches!(error, ImageError::IoError(e) if e.kind() == io::ErrorKind::PermissionDenied));
}

#[test]
#[should_panic(expected = "buffer length")]
fn a_buffer_of_wrong_length_panics_as_image_asks() {
    let decoder = SsplatDecoder::new(Cursor::new(file(Channels::Rgb, Depth::Eight))).unwrap();
    let mut buf = vec![0; 5];
    let _ = decoder.read_image(&mut buf);
}

#[test]
fn floats_are_converted_to_sixteen_bits_as_documented() {
    let of = |v: Vec<f32>| Pixels::try_from(DynamicImage::from(image::Rgb32FImage::from_vec(1, 1, v).unwrap()));
    let pixels = of(vec![-1.0, 0.5, 7.0]).unwrap();
    assert_eq!(pixels.samples(), &ssplat::Samples::U16(vec![0, 32768, 65535]));
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        assert!(matches!(of(vec![0.0, bad, 0.0]), Err(ssplat::Error::Parameter { parameter: Parameter::Samples, .. })));
    }
}

fn quick() -> EncodeOptions {
    let mut options = EncodeOptions::default();
    (options.target, options.effort) = (Target::Bytes(400), 1);
    options
}

/// A small picture of gradients in `color`.
fn ramps(color: ColorType) -> DynamicImage {
    let rgba = image::Rgba32FImage::from_fn(40, 30, |x, y| {
        image::Rgba([x as f32 / 40.0, y as f32 / 30.0, 0.5, 1.0 - x as f32 / 80.0])
    });
    let picture = DynamicImage::from(rgba);
    match color {
        ColorType::L8 => picture.to_luma8().into(),
        ColorType::La8 => picture.to_luma_alpha8().into(),
        ColorType::Rgb8 => picture.to_rgb8().into(),
        ColorType::Rgba8 => picture.to_rgba8().into(),
        ColorType::L16 => picture.to_luma16().into(),
        ColorType::La16 => picture.to_luma_alpha16().into(),
        ColorType::Rgb16 => picture.to_rgb16().into(),
        ColorType::Rgba16 => picture.to_rgba16().into(),
        ColorType::Rgb32F => picture.to_rgb32f().into(),
        _ => picture,
    }
}

#[test]
fn every_colour_type_is_encoded() {
    let same = |c| (c, c);
    let floats = [(ColorType::Rgb32F, ColorType::Rgb16), (ColorType::Rgba32F, ColorType::Rgba16)];
    let whole = [
        ColorType::L8,
        ColorType::La8,
        ColorType::Rgb8,
        ColorType::Rgba8,
        ColorType::L16,
        ColorType::La16,
        ColorType::Rgb16,
        ColorType::Rgba16,
    ];
    for (given, stored) in whole.map(same).into_iter().chain(floats) {
        let picture = ramps(given);
        assert_eq!(picture.color(), given);
        let mut bytes = Vec::new();
        picture.write_with_encoder(SsplatEncoder::new(&mut bytes, quick())).unwrap();
        assert!(bytes.len() <= 400, "{} bytes", bytes.len());
        let decoded = DynamicImage::from_decoder(SsplatDecoder::new(&bytes[..]).unwrap()).unwrap();
        assert_eq!(decoded.color(), stored);
        let psnr =
            ssplat::unstable::metrics::psnr(&Pixels::try_from(picture).unwrap(), &Pixels::try_from(decoded).unwrap());
        assert!(psnr.as_ref().is_ok_and(|&p| p > 25.0), "{given:?}: {psnr:?}");
    }
}

#[test]
fn blue_first_is_red_first_with_bytes_exchanged() {
    let rgba = ramps(ColorType::Rgba8).into_rgba8().into_raw();
    let encode = |bytes: &[u8], color| {
        let mut out = Vec::new();
        SsplatEncoder::new(&mut out, quick()).write_image(bytes, 40, 30, color).unwrap();
        out
    };
    let bgra: Vec<u8> = rgba.chunks_exact(4).flat_map(|p| [p[2], p[1], p[0], p[3]]).collect();
    assert!(encode(&rgba, ExtendedColorType::Rgba8) == encode(&bgra, ExtendedColorType::Bgra8));
}

#[test]
fn other_colour_types_and_samples_that_are_not_finite_are_errors() {
    let write = |bytes: &[u8], color| SsplatEncoder::new(Vec::new(), quick()).write_image(bytes, 2, 1, color);
    assert!(matches!(write(&[0; 8], ExtendedColorType::Cmyk8), Err(ImageError::Unsupported(_))));
    assert!(matches!(write(&[0], ExtendedColorType::L4), Err(ImageError::Unsupported(_))));
    let mut floats = [0.5f32; 6].map(f32::to_ne_bytes);
    floats[4] = f32::NAN.to_ne_bytes();
    assert!(matches!(write(floats.as_flattened(), ExtendedColorType::Rgb32F), Err(ImageError::Parameter(_))));
}

#[test]
#[should_panic(expected = "buffer length")]
fn encoding_a_buffer_of_wrong_length_panics_as_image_asks() {
    let _ = SsplatEncoder::new(Vec::new(), quick()).write_image(&[0; 5], 2, 1, ExtendedColorType::Rgb8);
}

#[test]
fn saved_pictures_open_again_with_their_metadata() {
    assert!(ssplat::register());
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("saved.ssplat");
    let report = ssplat::unstable::save(&ramps(ColorType::Rgb8), &path, &quick()).unwrap();
    assert!(report.psnr > 25.0);
    assert_eq!(image::open(&path).unwrap().color(), ColorType::Rgb8);

    let mut bytes = Vec::new();
    let mut encoder = SsplatEncoder::new(&mut bytes, quick());
    encoder.set_icc_profile(vec![3; 50]).unwrap();
    encoder.set_exif_metadata(metadata().exif.unwrap()).unwrap();
    ramps(ColorType::Rgb8).write_with_encoder(encoder).unwrap();
    let mut decoder = SsplatDecoder::new(&bytes[..]).unwrap();
    assert_eq!(decoder.icc_profile().unwrap(), Some(vec![3; 50]));
    assert_eq!(decoder.exif_metadata().unwrap(), metadata().exif);
}

/// Low effort, with room for any metadata.
fn roomy() -> EncodeOptions {
    let mut options = quick();
    options.target = Target::Gaussians(20);
    options
}

/// A rotated PNG with a profile and a long EXIF block.
fn photograph() -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = image::codecs::png::PngEncoder::new(&mut bytes);
    encoder.set_icc_profile([&[7u8; 16][..], b"RGB ", &[7; 480]].concat()).unwrap();
    encoder.set_exif_metadata([metadata().exif.unwrap(), vec![5; 20_000]].concat()).unwrap();
    ramps(ColorType::Rgb8).write_with_encoder(encoder).unwrap();
    bytes
}

#[test]
fn transcode_keeps_profile_and_orientation_but_not_the_rest_of_exif() {
    let folder = tempfile::tempdir().unwrap();
    let (input, output) = (folder.path().join("phone.png"), folder.path().join("phone.ssplat"));
    std::fs::write(&input, photograph()).unwrap();
    let carried = |path: &std::path::Path| {
        let mut decoder = SsplatDecoder::new(std::fs::File::open(path).unwrap()).unwrap();
        let orientation = decoder.orientation().unwrap();
        let exif = decoder.exif_metadata().unwrap().map_or(0, |e| e.len());
        (decoder.icc_profile().unwrap().map_or(0, |p| p.len()), exif, orientation)
    };
    use image::metadata::Orientation::{NoTransforms, Rotate90};
    ssplat::unstable::transcode(&input, &output, &roomy()).unwrap();
    assert_eq!(carried(&output), (500, 26, Rotate90));
    // From one ssplat file to another.
    let again = folder.path().join("again.ssplat");
    ssplat::unstable::transcode(&output, &again, &roomy()).unwrap();
    assert_eq!(carried(&again), (500, 26, Rotate90));
    let mut options = roomy();
    for (policy, expected) in [
        (MetadataPolicy::All, (500, 20_000 + metadata().exif.unwrap().len(), Rotate90)),
        (MetadataPolicy::Icc, (500, 0, NoTransforms)),
        (MetadataPolicy::None, (0, 0, NoTransforms)),
    ] {
        options.metadata = policy;
        ssplat::unstable::transcode(&input, &output, &options).unwrap();
        assert_eq!(carried(&output), expected, "{policy:?}");
    }
    // Metadata of the caller are kept.
    options.icc = Some(vec![1; 10]);
    ssplat::unstable::transcode(&input, &output, &options).unwrap();
    assert_eq!(carried(&output), (10, 0, NoTransforms));
}

#[test]
fn transcoding_errors_name_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    std::fs::write(path("text.txt"), "no picture").unwrap();
    std::fs::write(path("cut.png"), &photograph()[..60]).unwrap();
    std::fs::write(path("good.png"), photograph()).unwrap();
    let refused = |input: &str, output: &str| {
        ssplat::unstable::transcode(path(input), path(output), &roomy()).expect_err(input).to_string()
    };
    for (input, output, named) in [
        ("missing.png", "o.ssplat", "missing.png"),
        ("text.txt", "o.ssplat", "text.txt"),
        ("cut.png", "o.ssplat", "cut.png"),
        ("good.png", "o.png", "o.png has the extension of another format"),
        ("good.png", "no/o.ssplat", "no/o.ssplat"),
    ] {
        let said = refused(input, output);
        assert!(said.contains(named), "{said}");
        assert!(!path(output).exists());
    }
    let saved = ssplat::unstable::save(&ramps(ColorType::Rgb8), path("z.png"), &quick());
    assert!(matches!(saved, Err(Error::Parameter { parameter: Parameter::Path, .. })), "{saved:?}");
}

#[test]
fn a_failed_save_keeps_the_old_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("kept.ssplat");
    std::fs::write(&path, "before").unwrap();
    let mut options = quick();
    options.target = Target::Bytes(1);
    assert!(ssplat::unstable::save(&ramps(ColorType::Rgb8), &path, &options).is_err());
    assert_eq!(std::fs::read(&path).unwrap(), b"before");
}

#[test]
#[cfg(unix)]
fn save_keeps_the_permissions_of_a_replaced_file() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("secret.ssplat");
    std::fs::write(&path, "before").unwrap();
    std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o600)).unwrap();
    ssplat::unstable::save(&ramps(ColorType::Rgb8), &path, &quick()).unwrap();
    assert_eq!(std::fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o600);
}

#[test]
#[cfg(unix)]
fn save_replaces_a_file_atomically_and_leaves_no_temporary_file() {
    let folder = tempfile::tempdir().unwrap();
    let names = || {
        let mut names: Vec<_> = std::fs::read_dir(folder.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
        names.sort();
        names
    };
    let (path, link) = (folder.path().join("a.ssplat"), folder.path().join("link.ssplat"));
    std::fs::write(&path, "before").unwrap();
    // A reader that has opened the file before it is replaced still reads the old one.
    let mut reader = std::fs::File::open(&path).unwrap();
    std::os::unix::fs::symlink("a.ssplat", &link).unwrap();
    ssplat::unstable::save(&ramps(ColorType::Rgb8), &link, &quick()).unwrap();
    let mut before = String::new();
    std::io::Read::read_to_string(&mut reader, &mut before).unwrap();
    assert_eq!(before, "before");
    assert!(std::fs::symlink_metadata(&link).unwrap().is_symlink());
    assert!(std::fs::read(&path).unwrap().starts_with(&ssplat::unstable::bitstream::header::MAGIC));
    assert_eq!(names(), ["a.ssplat", "link.ssplat"]);
    std::fs::create_dir(folder.path().join("folder")).unwrap();
    assert!(ssplat::unstable::save(&ramps(ColorType::Rgb8), folder.path().join("folder"), &quick()).is_err());
    assert_eq!(names(), ["a.ssplat", "folder", "link.ssplat"]);
}

#[test]
fn code_points_reach_programs_that_use_image() {
    use ssplat::Cicp;
    let file = |cicp, icc: Option<Vec<u8>>| {
        let mut options = roomy();
        (options.cicp, options.icc) = (Some(cicp), icc);
        ssplat::unstable::encode(&Pixels::try_from(ramps(ColorType::Rgb8)).unwrap(), &options).unwrap().bytes
    };
    let hdr = file(Cicp::BT2100_PQ, Some(vec![3; 300]));
    let mut decoder = SsplatDecoder::new(&hdr[..]).unwrap();
    assert_eq!(decoder.cicp().unwrap(), Some(Cicp::BT2100_PQ));
    // No profile can express them, so that of the file is all there is.
    assert_eq!(decoder.icc_profile().unwrap(), Some(vec![3; 300]));
    // Others become a profile, which takes the place of that of the file.
    let p3 = file(Cicp::new(12, 13), Some(vec![3; 300]));
    let icc = SsplatDecoder::new(&p3[..]).unwrap().icc_profile().unwrap().unwrap();
    assert!(icc.len() > 300 && !ssplat::unstable::colour::is_srgb(&icc));

    for cicp in [Cicp::BT2100_PQ, Cicp::BT2100_HLG, Cicp::new(12, 13), Cicp::from_bytes(&[1, 13, 0, 0]).unwrap()] {
        let of_image = image::metadata::Cicp::try_from(cicp).unwrap();
        assert_eq!(Cicp::try_from(of_image).unwrap(), cicp);
    }
    assert_eq!(image::metadata::Cicp::try_from(Cicp::new(12, 13)).unwrap(), image::metadata::Cicp::DISPLAY_P3);
    assert!(image::metadata::Cicp::try_from(Cicp::new(200, 13)).is_err());
    let mut ycbcr = image::metadata::Cicp::SRGB;
    ycbcr.matrix = image::metadata::CicpMatrixCoefficients::Bt709;
    assert!(Cicp::try_from(ycbcr).unwrap_err().to_string().contains("cicp"));
}
