//! Accounts for the bytes of a file: by part and, for the Gaussians, by field.

use super::coder::range::Meter;
#[cfg(any(test, feature = "unstable"))]
use super::{header::Header, sections::SectionInfo};

/// Bytes of one part of a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Part {
    /// Its name in the specification.
    pub name: &'static str,
    /// Its bytes.
    pub bytes: u64,
}

/// Bits of one field, over all Gaussians.
#[derive(Debug, Clone, PartialEq)]
pub struct Field {
    /// Its name in the specification.
    pub name: &'static str,
    /// Bits of all Gaussians together; fractional with entropy coding.
    pub bits: f64,
}

/// Result of [`inspect`](super::inspect).
#[cfg(any(test, feature = "unstable"))]
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Report {
    /// The header.
    pub header: Header,
    /// Bytes of the whole file.
    pub bytes: u64,
    /// Parts in the order of the file; they add up to `bytes`.
    pub parts: Vec<Part>,
    /// Sections in the order of the file.
    pub sections: Vec<SectionInfo>,
    /// Fields of the Gaussians.
    pub fields: Vec<Field>,
    /// Bits of each Gaussian, in the order in which they are read. Bits that code the positions of all Gaussians, or
    /// of a group, are distributed equally. Empty for layouts in which all Gaussians have the same size.
    pub each: Vec<f32>,
    /// Gaussians of each progressive level.
    pub levels: Vec<u32>,
    /// Number of separately coded groups; 1 without a directory.
    pub groups: u32,
    /// Total bits of the detail layer's levels; 0 without a layer.
    pub layer_bits: f64,
}

/// The parts of the exact layer.
pub(super) const EXACT_INDEX: &str = "index of the exact layer";
pub(super) const EXACT_STREAMS: &str = "exact layer";

/// The parts of the detail layer.
pub(super) const INDEX: &str = "index of the detail layer";
pub(super) const STREAMS: &str = "detail layer";

#[cfg(any(test, feature = "unstable"))]
impl Report {
    /// Returns the bytes of the detail layer's index and streams; 0 without a layer.
    #[must_use]
    pub fn layer_bytes(&self) -> u64 {
        self.parts.iter().filter(|part| [INDEX, STREAMS].contains(&part.name)).map(|part| part.bytes).sum()
    }
}

#[cfg(any(test, feature = "unstable"))]
impl Report {
    /// Returns the bytes of the exact layer's index and streams; 0 without a layer.
    #[must_use]
    pub fn exact_bytes(&self) -> u64 {
        self.parts.iter().filter(|part| [EXACT_INDEX, EXACT_STREAMS].contains(&part.name)).map(|part| part.bytes).sum()
    }
}

/// Amount of detail in a report.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) enum Detail {
    /// The parts only.
    #[default]
    Parts,
    /// Also the bits of each field, which takes time.
    Fields,
}

/// Collects a report while a file is read.
#[derive(Debug, Default)]
pub(crate) struct Tally {
    pub detail: Detail,
    pub parts: Vec<Part>,
    pub fields: Vec<Field>,
    pub each: Vec<f32>,
    pub groups: u32,
    /// Bits of the detail layer's levels, if fields are reported.
    pub layer_bits: f64,
}

impl Tally {
    pub(crate) fn part(&mut self, name: &'static str, bytes: usize) {
        self.parts.push(Part { name, bytes: bytes as u64 });
    }

    /// Adds `bits` to a field.
    pub(crate) fn field(&mut self, name: &'static str, bits: f64) {
        match self.fields.iter_mut().find(|f| f.name == name) {
            Some(field) => field.bits += bits,
            None => self.fields.push(Field { name, bits }),
        }
    }

    /// Adds the counts of a meter that has read one stream.
    pub(crate) fn add<C>(&mut self, meter: Meter<C>) {
        meter.fields.into_iter().for_each(|(name, bits)| self.field(name, bits));
        if let Some((all, each)) = meter.each.split_first() {
            self.each.extend(each.iter().map(|bits| bits + all / each.len() as f32));
        }
    }
}
