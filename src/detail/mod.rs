//! Levels of the detail layer to what they add to a picture; exact, in integers modulo 2³² (spec §11.5).
//!
//! `steps` gives levels their values, `transform` makes planes of them, `lap` joins the blocks, `tile` does all of it for a tile,
//! where `supers` says that there is something to do.

pub(crate) mod lap;
pub(crate) mod steps;
pub(crate) mod supers;
pub(crate) mod tile;
pub(crate) mod transform;
