//! Interface to the `image` crate: the decoding hook, the encoder trait and pixel conversions.

mod carry;
mod convert;
mod decoder;
mod encoder;
mod replace;
mod transcode;

pub use carry::Carried;
pub use decoder::{EXTENSION, SsplatDecoder, register};
pub use encoder::{SsplatEncoder, save};
pub use transcode::{encode_decoder, transcode};
