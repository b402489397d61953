//! Measures the loss of a fit in tiles relative to a fit of the whole picture, and the part of it at the seams: `cargo
//! run --release -p ssplat-lab --example seams -- PICTURES [--tiles 512] [--ratio 50] [--effort 5] [--tune psnr]`.
//!
//! A seam is the border of two tiles of the first pass. Its error is that of the pixels within 16 pixels of it. The
//! error of the whole picture's fit differs there, too, depending on the content. `excess` is therefore the ratio of
//! the tiles' error to the whole fit's error at the seams, divided by the same ratio for all other pixels.

use std::time::Instant;

use image::ImageReader;
use ssplat::unstable::{DecodeOptions, EncodeOptions};
use ssplat::{Channels, Encoded, Pixels, Samples, Target, Tune};

/// Pixels on either side of a seam.
const SEAM_DISTANCE: u32 = 16;

/// Squared errors and sample counts: near seams, and elsewhere.
#[derive(Clone, Copy, Default)]
struct Found {
    errors: [f64; 2],
    samples: [f64; 2],
}

impl Found {
    fn of(original: &Pixels, encoded: &Encoded, side: u32) -> Self {
        let decoded =
            ssplat::unstable::decode(&encoded.bytes, &DecodeOptions::default()).expect("it was just written").pixels;
        let (Samples::U8(a), Samples::U8(b)) = (original.samples(), decoded.samples()) else { panic!("8 bits") };
        let (width, height) = (original.width(), original.height());
        let is_near = |v: u32, length: u32| {
            let seam = (v + side / 2) / side * side;
            seam > 0 && seam < length && v + SEAM_DISTANCE >= seam && v < seam + SEAM_DISTANCE
        };
        let count = original.channels().count();
        let mut found = Found::default();
        for (i, (a, b)) in a.chunks_exact(count).zip(b.chunks_exact(count)).enumerate() {
            let (x, y) = (i as u32 % width, i as u32 / width);
            let k = usize::from(!is_near(x, width) && !is_near(y, height));
            found.errors[k] += a.iter().zip(b).map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2)).sum::<f64>();
            found.samples[k] += count as f64;
        }
        found
    }

    fn mean(&self, k: usize) -> f64 {
        self.errors[k] / self.samples[k]
    }

    fn psnr(&self) -> f64 {
        let mean = (self.errors[0] + self.errors[1]) / (self.samples[0] + self.samples[1]);
        10.0 * (255.0 * 255.0 / mean).log10()
    }
}

fn main() {
    let mut options = EncodeOptions::default();
    options.target = Target::Ratio(50.0);
    let (mut side, mut paths) = (512, Vec::new());
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        let mut value = || arguments.next().expect("a value");
        match argument.as_str() {
            "--tiles" => side = value().parse().expect("a side"),
            "--ratio" => options.target = Target::Ratio(value().parse().expect("a ratio")),
            "--effort" => options.effort = value().parse().expect("1 to 9"),
            "--tune" => options.tune = (value() == "psnr").then_some(Tune::Psnr),
            _ => paths.push(argument),
        }
    }
    println!("picture  whole dB  tiles dB  loss  seam/elsewhere: whole  tiles  excess  bytes  seconds: whole  tiles");
    let mut sums = [Found::default(); 2];
    let mut losses = Vec::new();
    for path in &paths {
        let picture = ImageReader::open(path).expect("a file").decode().expect("a picture").into_rgb8();
        let (width, height) = picture.dimensions();
        let pixels = Pixels::new(width, height, Channels::Rgb, Samples::U8(picture.into_raw())).expect("a picture");
        let mut seconds = Vec::new();
        let mut encode = |tiles: Option<u32>| {
            let clock = Instant::now();
            options.tiles = tiles;
            let encoded = ssplat::unstable::encode(&pixels, &options).expect("an encode");
            seconds.push(clock.elapsed().as_secs_f64());
            (Found::of(&pixels, &encoded, side), encoded.bytes.len())
        };
        let ((whole, most), (tiles, bytes)) = (encode(None), encode(Some(side)));
        let name = std::path::Path::new(path).file_stem().expect("a name").to_string_lossy();
        let loss = whole.psnr() - tiles.psnr();
        let of_all = |f: &Found| f.mean(0) / f.mean(1);
        println!(
            "{name}  {:.3}  {:.3}  {loss:.3}  {:.3}  {:.3}  {:.3}  {most} {bytes}  {:.1}  {:.1}",
            whole.psnr(),
            tiles.psnr(),
            of_all(&whole),
            of_all(&tiles),
            of_all(&tiles) / of_all(&whole),
            seconds[0],
            seconds[1],
        );
        for (sum, found) in sums.iter_mut().zip([whole, tiles]) {
            for k in 0..2 {
                // Every picture has the same weight.
                sum.errors[k] += found.mean(k) / whole.mean(k);
                sum.samples[k] += 1.0;
            }
        }
        losses.push(loss);
    }
    println!(
        "all: loss {:.3} dB, excess at seams {:.3}",
        losses.iter().sum::<f64>() / losses.len() as f64,
        sums[1].mean(0) / sums[1].mean(1)
    );
}
