//! Benchmarks of the stages of a decode and of a small encode: `cargo bench -p ssplat-lab`.

use divan::{Bencher, black_box};
use ssplat::unstable::bitstream::{self, splats::PackedSplats};
use ssplat::unstable::{EncodeOptions, encode};
use ssplat::{Limits, Pixels, Rect, Target};
use ssplat::{Renderer, View};

fn main() {
    divan::main();
}

fn photograph() -> Pixels {
    Pixels::try_from(
        image::open(concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/images/kodim05.png"))
            .expect("a picture of the repository"),
    )
    .expect("pixels")
}

/// The photograph at a ratio of 50, fitted quickly. Speed depends on the number of primitives, not on their quality.
fn file() -> Vec<u8> {
    let mut options = EncodeOptions::default();
    options.target = Target::Ratio(50.0);
    options.effort = 1;
    encode(&photograph(), &options).expect("an encode").bytes
}

fn splats() -> PackedSplats {
    bitstream::read(&file()[..], &Limits::default()).expect("a valid file")
}

#[divan::bench]
fn parse(bencher: Bencher) {
    let bytes = file();
    bencher.bench(|| bitstream::read(black_box(&bytes[..]), &Limits::default()));
}

#[divan::bench]
fn write(bencher: Bencher) {
    let splats = splats();
    bencher.bench(|| bitstream::to_bytes(black_box(&splats)));
}

/// Output widths; the whole picture is 768 pixels wide.
#[divan::bench(args = [96, 256, 768, 3072])]
fn rasterize(bencher: Bencher, width: u32) {
    let splats = splats();
    let picture = splats.to_gaussians();
    let view = View::new(picture.width, picture.height).resized(width, width * 512 / 768).expect("a size");
    bencher.bench(|| Renderer::new(black_box(&picture), &view, &Limits::default())?.render(splats.depth));
}

#[divan::bench]
fn rasterize_region_of_256(bencher: Bencher) {
    let splats = splats();
    let picture = splats.to_gaussians();
    let view = View::new(picture.width, picture.height).crop(Rect::new(200, 100, 256, 256)).expect("a region");
    bencher.bench(|| Renderer::new(black_box(&picture), &view, &Limits::default())?.render(splats.depth));
}

#[divan::bench(args = [1, 3], sample_count = 3)]
fn encode_photograph(bencher: Bencher, effort: u8) {
    let pixels = photograph();
    let mut options = EncodeOptions::default();
    options.effort = effort;
    bencher.bench(|| encode(black_box(&pixels), &options));
}
