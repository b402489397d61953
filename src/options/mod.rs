//! Options of the encoder and the decoder.

mod decode;
#[cfg(feature = "encode")]
mod encode;

pub use decode::*;
#[cfg(feature = "encode")]
pub use encode::*;
