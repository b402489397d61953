//! Options of the encoder and the decoder.

mod decode;
#[cfg(feature = "encode")]
mod encode;
#[cfg(feature = "encode")]
mod fit;

pub use decode::*;
#[cfg(feature = "encode")]
pub use encode::*;
#[cfg(feature = "encode")]
pub use fit::*;
