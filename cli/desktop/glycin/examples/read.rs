//! Reads a picture as GNOME's programs do, through glycin and the loader that its configuration names, and writes it to
//! standard output as PPM: `GLYCIN_DATA_DIR=DIR read FILE`. `cli/desktop/check` runs it.

use std::error::Error;
use std::io::Write;

use glycin::{Loader, MemoryFormat};

fn main() -> Result<(), Box<dyn Error>> {
    let path = std::env::args_os().nth(1).ok_or("usage: read FILE")?;
    let file = std::fs::read(path)?;
    futures_lite::future::block_on(async {
        let mut image = Loader::new_vec(file).load().await?;
        let frame = image.next_frame().await?;
        eprintln!("{} {:?}", image.mime_type(), image.active_sandbox_mechanism());
        if frame.memory_format() != MemoryFormat::R8g8b8 {
            return Err(format!("{:?} instead of R8g8b8", frame.memory_format()).into());
        }
        let mut out = std::io::stdout().lock();
        write!(out, "P6\n{} {}\n255\n", frame.width(), frame.height())?;
        for row in frame.buf_slice().chunks(frame.stride() as usize) {
            out.write_all(&row[..3 * frame.width() as usize])?;
        }
        Ok(())
    })
}
