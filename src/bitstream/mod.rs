//! Bytes to integers and back; exact. Knows no colour and no pixel (spec §2 to §8).

mod attributes;
mod bits;
mod broken;
pub(crate) mod bytes;
pub(crate) mod checksum;
mod coded;
pub(crate) mod detail;
pub(crate) mod expect;
mod frame;
mod groups;
pub mod header;
mod hilbert;
mod kd;
pub mod lattice;
mod model;
mod neighbours;
mod packed;
mod palette;
mod planes;
pub mod range;
mod read;
mod region;
pub mod report;
pub mod rules;
pub mod sections;
pub mod splats;
mod spread;
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
