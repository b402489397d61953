//! Prints the texture of pictures, which determines how the encoder divides the bytes of a file between the Gaussians and
//! the detail layer. Each line is a JSON object with `picture`, `width`, `height`, `fineness`, `activity` and `flat`.
//!
//! `cargo run --release -p ssplat-lab --example texture -- PICTURE...`

use std::error::Error;

use ssplat::Pixels;
use ssplat::unstable::Texture;

fn main() -> Result<(), Box<dyn Error>> {
    let paths: Vec<String> = std::env::args().skip(1).collect();
    if paths.is_empty() {
        return Err("usage: texture PICTURE...".into());
    }
    for path in paths {
        let pixels = image::open(&path).map_err(|error| format!("{path}: {error}"))?;
        let pixels = Pixels::try_from(&pixels)?;
        let Some(Texture { fineness, activity, flat }) = Texture::of_pixels(&pixels) else {
            return Err(format!("{path}: the picture has no texture").into());
        };
        let (width, height) = (pixels.width(), pixels.height());
        println!(
            r#"{{"picture": {path:?}, "width": {width}, "height": {height}, "fineness": {fineness}, "activity": {activity}, "flat": {flat}}}"#
        );
    }
    Ok(())
}
