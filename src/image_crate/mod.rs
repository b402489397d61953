//! The door to the `image` crate: opening files through its hook, writing through its encoder trait, pixels both ways.

mod convert;
mod decoder;
mod encoder;
mod replace;

pub use decoder::{EXTENSION, SsplatDecoder, register};
pub use encoder::{SsplatEncoder, save};
