//! Uses the stable public names as a program that embeds the codec would, without `ssplat::unstable`.

use std::ops::ControlFlow;

use ssplat::{
    Channels, Damage, Decoder, Depth, Detail, Encoder, Error, Layers, Limits, Pixels, Reader, Samples, SamplesMut, Tune,
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
fn what_is_out_of_range_is_named() {
    for (encoder, wanted) in [
        (Encoder::new().effort(0), "effort"),
        (Encoder::new().ratio(f64::NAN), "ratio"),
        (Encoder::new().psnr(-1.0), "psnr"),
        (Encoder::new().levels(9), "levels"),
        (Encoder::new().tiles(100), "tiles"),
        (Encoder::new().detail(Detail::Share(1.0)), "detail"),
    ] {
        let Err(Error::Parameter { name, .. }) = encoder.encode(&picture()) else { panic!("{wanted}") };
        assert_eq!(name, wanted);
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
    let image = reader.read(Damage::Refuse).unwrap();
    let whole = image.draw(&image.view()).unwrap();
    assert_eq!(Decoder::new().decode(&bytes).unwrap().pixels, whole);
    // All ways of rendering give the same pixels, in any memory.
    let part = image.view().crop(16, 8, 40, 30).unwrap();
    let drawn = image.draw(&part).unwrap();
    assert_eq!(Decoder::new().region([16, 8, 40, 30]).decode(&bytes).unwrap().pixels, drawn);
    let mut out = vec![0; 40 * 30 * 3];
    Decoder::new().region([16, 8, 40, 30]).decode_into(&bytes, SamplesMut::U8(&mut out)).unwrap();
    assert_eq!(drawn.samples(), &Samples::U8(out));
    let small = Decoder::new().thumbnail(&bytes, [24, 24]).unwrap().pixels;
    assert_eq!((small.width(), small.height()), (24, 16));
    let gaussians = Decoder::new().layers(Layers::Gaussians).decode(&bytes).unwrap().pixels;
    assert_eq!(gaussians.width(), 96);
}

#[test]
fn memory_of_another_size_is_refused() {
    let bytes = Encoder::new().bytes(300).effort(1).encode(&picture()).unwrap().bytes;
    for length in [0, 96 * 64 * 3 - 1, 96 * 64 * 3 + 1] {
        let refused = Decoder::new().decode_into(&bytes, SamplesMut::U8(&mut vec![0; length]));
        assert!(matches!(refused, Err(Error::Parameter { name: "out", .. })), "{length}: {refused:?}");
    }
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
