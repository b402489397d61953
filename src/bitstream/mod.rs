//! Converts bytes to integers and back, exactly. It does not interpret colours or pixels (spec §2 to §8).

pub mod area;
mod broken;
pub(crate) mod bytes;
pub(crate) mod checksum;
pub mod coder;
pub(crate) mod detail;
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
mod uncoded;
mod write;

#[doc(hidden)]
pub use self::detail::Maker;
pub use self::detail::{DetailHead, DetailLayer};
pub use self::groups::Missing;
pub(crate) use self::read::{Reading, read_rest};
pub use self::read::{inspect, read, read_area, read_partial};
pub use self::write::{to_bytes, write};

/// Bytes of the checksum at the end.
const CHECKSUM: usize = 4;
