//! A process in which another hook is registered for the extension: that hook is kept.
#![cfg(all(feature = "unstable", feature = "image"))]

use std::io::Cursor;

use image::hooks::{decoding_hook_registered, register_decoding_hook};
use image::{ColorType, ImageDecoder, ImageReader, ImageResult};

/// A decoder of another crate.
struct Other;

impl ImageDecoder for Other {
    fn dimensions(&self) -> (u32, u32) {
        (1, 1)
    }

    fn color_type(&self) -> ColorType {
        ColorType::L8
    }

    fn read_image(self, buf: &mut [u8]) -> ImageResult<()> {
        buf.fill(77);
        Ok(())
    }

    fn read_image_boxed(self: Box<Self>, buf: &mut [u8]) -> ImageResult<()> {
        (*self).read_image(buf)
    }
}

#[test]
fn another_hook_is_never_replaced() {
    assert!(register_decoding_hook("ssplat".into(), Box::new(|_| Ok(Box::new(Other)))));
    assert!(!ssplat::register());
    assert!(!ssplat::register());
    assert!(decoding_hook_registered("ssplat".as_ref()));
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.ssplat");
    std::fs::write(&path, b"anything").unwrap();
    assert_eq!(image::open(path).unwrap().as_bytes(), [77]);
    // The content is not registered either.
    let reader =
        ImageReader::new(Cursor::new(ssplat::unstable::bitstream::header::MAGIC)).with_guessed_format().unwrap();
    assert!(reader.decode().is_err() && image::load_from_memory(&ssplat::unstable::bitstream::header::MAGIC).is_err());
}
