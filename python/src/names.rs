//! The words that stand for the library's choices.

use pyo3::PyErr;
use ssplat::unstable::Needs;
use ssplat::unstable::bitstream::splats::Layout;
use ssplat::{Backend, Blend, Detail, MetadataPolicy, Tune};

use crate::failure::parameter;

pub const LAYOUTS: [(&str, Layout); 3] =
    [("coded", Layout::Coded), ("planes", Layout::Planes), ("packed", Layout::Packed)];
pub const BLENDS: [(&str, Blend); 2] = [("normalized", Blend::Normalized), ("sum", Blend::Sum)];
pub const TUNES: [(&str, Tune); 2] = [("psnr", Tune::Psnr), ("iq", Tune::Iq)];
pub const NEEDS: [(&str, Needs); 2] = [("measured", Needs::Measured), ("everything", Needs::Everything)];
pub const BACKENDS: [(&str, Backend); 3] = [("auto", Backend::Auto), ("cpu", Backend::Cpu), ("gpu", Backend::Gpu)];
pub const DETAILS: [(&str, Detail); 2] = [("auto", Detail::Auto), ("off", Detail::Off)];
pub const CARRIES: [(&str, MetadataPolicy); 4] = [
    ("needed", MetadataPolicy::Needed),
    ("all", MetadataPolicy::All),
    ("icc", MetadataPolicy::Icc),
    ("none", MetadataPolicy::None),
];

/// Returns the value that `word` stands for.
pub fn value<T: Copy>(name: &'static str, all: &[(&'static str, T)], word: &str) -> Result<T, PyErr> {
    all.iter().find(|(w, _)| *w == word).map(|&(_, v)| v).ok_or_else(|| {
        let words: Vec<_> = all.iter().map(|(w, _)| format!("{w:?}")).collect();
        parameter(name, format!("{word:?} is none of {}", words.join(", ")))
    })
}

/// The word for `value`.
pub fn word<T: PartialEq>(all: &[(&'static str, T)], value: T) -> &'static str {
    all.iter().find(|(_, v)| *v == value).map_or("unknown", |&(w, _)| w)
}
