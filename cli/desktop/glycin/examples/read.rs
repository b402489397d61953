//! Reads a picture as GNOME's programs do, through glycin and the loader that its configuration names, and writes it to
//! standard output as PAM: `GLYCIN_DATA_DIR=DIR read FILE [MOST]`. A picture with a side above MOST pixels is refused.
//! `cli/desktop/glycin/check` runs it.

use std::error::Error;
use std::io::Write;

use glycin::{Limits, Loader, MemoryFormat};

fn main() -> Result<(), Box<dyn Error>> {
    let path = std::env::args_os().nth(1).ok_or("usage: read FILE [MOST]")?;
    let most = std::env::args().nth(2).map(|most| most.parse()).transpose()?;
    let file = std::fs::read(path)?;
    futures_lite::future::block_on(async {
        let mut loader = Loader::new_vec(file);
        if let Some(most) = most {
            loader.limits(Limits::default().max_dimensions((most, most)));
        }
        let mut image = loader.load().await?;
        let frame = image.next_frame().await?;
        eprintln!("{} {:?}", image.mime_type(), image.active_sandbox_mechanism());
        let (channels, bytes, kind) = match frame.memory_format() {
            MemoryFormat::G8 => (1, 1, "GRAYSCALE"),
            MemoryFormat::G16 => (1, 2, "GRAYSCALE"),
            MemoryFormat::R8g8b8 => (3, 1, "RGB"),
            MemoryFormat::R8g8b8a8 => (4, 1, "RGB_ALPHA"),
            MemoryFormat::R16g16b16a16 => (4, 2, "RGB_ALPHA"),
            other => return Err(format!("unexpected format {other:?}").into()),
        };
        let (width, height, most) = (frame.width(), frame.height(), (1u32 << (8 * bytes)) - 1);
        let mut out = std::io::stdout().lock();
        writeln!(out, "P7\nWIDTH {width}\nHEIGHT {height}\nDEPTH {channels}\nMAXVAL {most}\nTUPLTYPE {kind}\nENDHDR")?;
        for row in frame.buf_slice().chunks(frame.stride() as usize) {
            let mut row = row[..channels * bytes * width as usize].to_vec();
            if bytes == 2 && cfg!(target_endian = "little") {
                row.chunks_exact_mut(2).for_each(|sample| sample.reverse());
            }
            out.write_all(&row)?;
        }
        Ok(())
    })
}
