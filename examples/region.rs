//! Opens a file once, and renders parts of it at any size into the same memory:
//!
//! ```text
//! cargo run --release --example region -- photo.ssplat
//! ```

use std::error::Error;

use ssplat::{Limits, Reader, Rect, SamplesMut};

fn main() -> Result<(), Box<dyn Error>> {
    let path = std::env::args().nth(1).ok_or("the path of an .ssplat file")?;
    let reader = Reader::open(path, &Limits::default())?;
    let (width, height, channels) = (reader.width(), reader.height(), reader.channels().count());
    println!("{width} × {height}, {} Gaussians", reader.gaussian_count());

    // A pan over the middle row, at twice the size.
    let image = reader.read()?;
    let (part, step) = ([width.min(64), height.min(64)], 16);
    let mut frame = vec![0; 4 * (part[0] * part[1]) as usize * channels];
    for x in (0..=width - part[0]).step_by(step) {
        let view = image.view().crop(Rect::new(x, (height - part[1]) / 2, part[0], part[1]))?;
        image.render_into(&view.resized(2 * part[0], 2 * part[1])?, SamplesMut::U8(&mut frame))?;
        let sum: u64 = frame.iter().map(|&v| u64::from(v)).sum();
        println!("from {x}: mean code value {:.1}", sum as f64 / frame.len() as f64);
    }
    Ok(())
}
