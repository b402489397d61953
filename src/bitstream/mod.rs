//! Converts bytes to integers and back, exactly. It does not interpret colours or pixels (spec §2 to §8).

pub mod broken;
pub(crate) mod bytes;
pub(crate) mod checksum;
pub mod cicp;
pub mod coder;
pub(crate) mod detail;
pub(crate) mod exact;
mod groups;
pub mod header;
pub mod lattice;
mod palette;
mod read;
mod region;
pub mod report;
pub mod rules;
pub mod sections;
pub mod splats;
mod tile_index;
mod uncoded;
mod write;

pub use self::detail::DetailLayer;
#[cfg(any(test, feature = "unstable"))]
pub use self::detail::{DetailHead, Maker};
pub use self::exact::ExactLayer;
pub use self::groups::MissingParts;
pub(crate) use self::read::{Reading, read_rest};
#[cfg(any(test, feature = "unstable"))]
pub use self::read::{inspect, read_area, read_partial};
#[cfg(any(test, feature = "unstable"))]
pub use self::write::write;
#[cfg(any(feature = "encode", feature = "unstable"))]
pub use self::{read::read, write::to_bytes};

/// Bytes of the checksum at the end.
const CHECKSUM: usize = 4;
