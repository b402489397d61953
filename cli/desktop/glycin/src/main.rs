//! Loads `.ssplat` pictures for glycin, with which GNOME's programs (Loupe, Nautilus' thumbnails, GTK 4 programs) read
//! pictures. Each picture is read by a process of its own, in a sandbox.

use std::io::Read;

use glycin_utils::image_rs::Handler;
use glycin_utils::{
    ByteData, Frame, FrameRequest, GenericContexts, ImageDetails, InitializationDetails, LoaderImplementation,
    ProcessError, init_main_loader, pre_main,
};
use ssplat::image::{self, ImageDecoder};
use ssplat::{Limits, Reader, SsplatDecoder};

init_main_loader!(SsplatLoader);

/// The file that is shown.
pub struct SsplatLoader {
    file: Vec<u8>,
}

fn handler() -> Handler {
    Handler::default().format_name("ssplat").default_bit_depth(8)
}

/// The program's limits of width and height. Memory is limited by the library and by glycin's sandbox.
fn limits(details: &InitializationDetails) -> image::Limits {
    let (width, height) = details.limits.max_dimensions;
    let mut limits = image::Limits::no_limits();
    limits.max_image_width = Some(width);
    limits.max_image_height = Some(height);
    limits.max_alloc = Some(Limits::default().alloc);
    limits
}

impl LoaderImplementation for SsplatLoader {
    fn load<B: ByteData, R: Read + Send + 'static>(
        mut stream: R,
        _mime_type: String,
        details: InitializationDetails,
    ) -> Result<(Self, ImageDetails<B>), ProcessError> {
        let mut file = Vec::new();
        stream.read_to_end(&mut file).expected_error()?;
        let mut decoder = SsplatDecoder::new(&file[..]).expected_error()?;
        decoder.set_limits(limits(&details)).expected_error()?;
        if decoder.total_bytes() > Limits::default().alloc {
            return Err(ProcessError::out_of_memory());
        }
        let mut details = handler().info(&mut decoder);
        let metadata = Reader::new(&file, &Limits::default()).and_then(|reader| reader.metadata()).expected_error()?;
        details.metadata_exif = metadata.exif.map(B::try_from_vec).transpose().expected_error()?;
        Ok((SsplatLoader { file }, details))
    }

    fn specific_frame<B: ByteData>(&mut self, _request: FrameRequest) -> Result<Frame<B>, ProcessError> {
        let mut decoder = SsplatDecoder::new(&self.file[..]).expected_error()?;
        // Code points take precedence over the profile.
        let cicp = decoder.cicp().expected_error()?;
        let mut frame = handler().frame(decoder)?;
        frame.details.color_cicp = cicp.map(ssplat::Cicp::to_bytes);
        Ok(frame)
    }
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use super::*;
    use glycin_utils::{FungibleMemory, MemoryFormat};

    fn vector(name: &str) -> Vec<u8> {
        read(&format!("valid/{name}"))
    }

    fn read(name: &str) -> Vec<u8> {
        std::fs::read(format!("{}/../../../spec/vectors/{name}/file.ssplat", env!("CARGO_MANIFEST_DIR"))).unwrap()
    }

    fn load(file: Vec<u8>) -> Result<(ImageDetails<FungibleMemory>, Frame<FungibleMemory>), ProcessError> {
        load_within(file, InitializationDetails::default())
    }

    fn load_within(
        file: Vec<u8>,
        details: InitializationDetails,
    ) -> Result<(ImageDetails<FungibleMemory>, Frame<FungibleMemory>), ProcessError> {
        let (mut loader, details) = SsplatLoader::load(Cursor::new(file), "image/x-ssplat".into(), details)?;
        Ok((details, loader.specific_frame(FrameRequest::default())?))
    }

    #[test]
    fn pictures_are_those_of_the_decoder() {
        for (name, format) in [
            ("coded-rgb", MemoryFormat::R8g8b8),
            ("detail-rgba", MemoryFormat::R8g8b8a8),
            ("coded-rgba", MemoryFormat::R16g16b16a16),
            ("coded-grey", MemoryFormat::G8),
            ("detail-grey-16", MemoryFormat::G16),
        ] {
            let file = vector(name);
            let decoder = SsplatDecoder::new(&file[..]).unwrap();
            let (width, height) = decoder.dimensions();
            let mut expected = vec![0; decoder.total_bytes() as usize];
            decoder.read_image(&mut expected).unwrap();
            let (details, frame) = load(file).unwrap();
            assert_eq!((details.width, details.height), (width, height), "{name}");
            assert_eq!((frame.width, frame.height, frame.memory_format), (width, height, format), "{name}");
            assert!(frame.texture[..] == expected, "{name}");
        }
    }

    #[test]
    fn metadata_and_code_points_are_handed_on() {
        let (details, frame) = load(vector("sections")).unwrap();
        assert_eq!(&details.metadata_exif.unwrap()[..4], b"II*\0");
        assert_eq!(&frame.details.color_icc_profile.unwrap()[..], b"not a real profile");
        assert_eq!(load(vector("cicp")).unwrap().1.details.color_cicp, Some([9, 16, 0, 1]));
    }

    #[test]
    fn broken_files_are_errors() {
        let file = vector("coded-rgb");
        for end in 0..file.len() {
            assert!(load(file[..end].to_vec()).is_err(), "{end} bytes");
        }
    }

    #[test]
    fn limits_are_kept() {
        let within = |side| {
            let mut details = InitializationDetails::default();
            details.limits.max_dimensions = side;
            load_within(vector("coded-rgb"), details)
        };
        let whole = within((1 << 16, 1 << 16)).unwrap().0;
        assert!(within((whole.width, whole.height)).is_ok());
        assert!(within((whole.width - 1, whole.height)).is_err());
        assert!(within((whole.width, whole.height - 1)).is_err());
        // Pictures of up to 2^20 pixels a side, and work without end, in a few bytes.
        for name in ["heavy-overlap", "huge-picture", "many-primitives"] {
            assert!(load(read(&format!("limits/{name}"))).is_err(), "{name}");
            let mut details = InitializationDetails::default();
            details.limits.max_dimensions = (u32::MAX, u32::MAX);
            assert!(load_within(read(&format!("limits/{name}")), details).is_err(), "{name}");
        }
    }
}
