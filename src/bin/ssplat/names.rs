//! The names that options have on the command line; shared with the measuring programs in `examples/`.

use clap::builder::{PossibleValuesParser, TypedValueParser};
use ssplat::bitstream::splats::Layout;
use ssplat::{Ablation, Backend, Blend, Recipe, Tune};

/// A parser of names for values.
fn named<T: Copy + Send + Sync + 'static>(values: &'static [(&'static str, T)]) -> impl TypedValueParser<Value = T> {
    let value = move |name: String| values.iter().find(|v| v.0 == name).map(|v| v.1).expect("a listed name");
    PossibleValuesParser::new(values.iter().map(|v| v.0)).map(value)
}

pub fn layout() -> impl TypedValueParser<Value = Layout> {
    named(&[("packed", Layout::Packed), ("planes", Layout::Planes), ("coded", Layout::Coded)])
}

pub fn blend() -> impl TypedValueParser<Value = Blend> {
    named(&[("normalized", Blend::Normalized), ("sum", Blend::Sum)])
}

pub fn recipe() -> impl TypedValueParser<Value = Recipe> {
    named(&[
        ("ssplat", Recipe::Ssplat),
        ("smartsplat", Recipe::SmartSplat(Ablation::Colors)),
        ("smartsplat-random", Recipe::SmartSplat(Ablation::Random)),
        ("smartsplat-means", Recipe::SmartSplat(Ablation::Means)),
        ("smartsplat-scales", Recipe::SmartSplat(Ablation::Scales)),
    ])
}

pub fn tune() -> impl TypedValueParser<Value = Tune> {
    named(&[("psnr", Tune::Psnr), ("ssim", Tune::Ssim), ("iq", Tune::Iq)])
}

pub fn backend() -> impl TypedValueParser<Value = Backend> {
    named(&[("auto", Backend::Auto), ("cpu", Backend::Cpu), ("gpu", Backend::Gpu)])
}

pub fn drawing_backend() -> impl TypedValueParser<Value = Backend> {
    named(&[("cpu", Backend::Cpu), ("gpu", Backend::Gpu)])
}
