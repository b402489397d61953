//! Interface to the `image` crate: the decoding hook, the encoder trait and pixel conversions.

#[cfg_attr(not(feature = "encode"), allow(dead_code, reason = "only the encoder compares and makes other profiles"))]
pub(crate) mod colour;
mod convert;
mod decoder;
#[cfg(feature = "encode")]
mod encoder;
#[cfg(feature = "encode")]
pub(crate) mod input;
#[cfg(feature = "encode")]
mod metadata_policy;
#[cfg(feature = "encode")]
pub(crate) mod overlay;
#[cfg(feature = "encode")]
mod replace;
#[cfg(feature = "encode")]
mod source;
#[cfg(feature = "encode")]
pub(crate) mod stated;
#[cfg(feature = "encode")]
mod transcode;

pub use decoder::{EXTENSION, SsplatDecoder, register};
#[cfg(feature = "encode")]
pub use encoder::SsplatEncoder;
#[cfg(all(feature = "encode", any(test, feature = "unstable")))]
pub use encoder::save;
#[cfg(all(feature = "encode", any(test, feature = "unstable")))]
pub use metadata_policy::Carried;
#[cfg(all(feature = "encode", any(test, feature = "unstable")))]
pub use transcode::{encode_decoder, transcode};
