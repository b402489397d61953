//! The door to the `image` crate: opening files through its hook, writing through its encoder trait, pixels both ways.

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
