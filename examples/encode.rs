//! A picture to a file and back, through the `image` crate:
//!
//! ```text
//! cargo run --release --example encode -- photo.png photo.ssplat photo-again.png
//! ```

use std::error::Error;

use ssplat::{Encoder, register};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let paths: Vec<String> = std::env::args().skip(1).collect();
    let [picture, file, again] = &paths[..] else { return Err("three paths: PICTURE FILE AGAIN".into()) };

    // Keeps the picture's ICC profile and orientation.
    let report = Encoder::new().ratio(100.0).transcode(picture, file)?;
    println!("{} Gaussians, {:.2} dB, {:.1} s", report.gaussians, report.psnr, report.seconds);

    // From here on, the `image` crate supports the format.
    register();
    Ok::<(), Box<dyn Error>>(image::open(file)?.save(again)?)
}
