//! Names of option values on the command line and in output; shared with the lab.

use clap::builder::{PossibleValuesParser, TypedValueParser};
use ssplat::unstable::bitstream::splats::Layout;
use ssplat::{Backend, Blend, Layers, MetadataPolicy, Tune};

static LAYOUTS: [(&str, Layout); 3] =
    [("packed", Layout::Packed), ("planes", Layout::Planes), ("coded", Layout::Coded)];
static BLENDS: [(&str, Blend); 2] = [("normalized", Blend::Normalized), ("sum", Blend::Sum)];

/// Returns the name of a listed value.
fn name_of<T: PartialEq>(values: &[(&'static str, T)], value: &T) -> &'static str {
    values.iter().find(|v| v.1 == *value).map(|v| v.0).expect("a listed value")
}

/// Returns the value with this name.
fn value_of<T: Copy>(values: &[(&str, T)], name: &str) -> Option<T> {
    values.iter().find(|v| v.0 == name).map(|v| v.1)
}

pub fn layout_name(layout: Layout) -> &'static str {
    name_of(&LAYOUTS, &layout)
}

pub fn layout_of(name: &str) -> Option<Layout> {
    value_of(&LAYOUTS, name)
}

pub fn blend_name(blend: Blend) -> &'static str {
    name_of(&BLENDS, &blend)
}

pub fn blend_of(name: &str) -> Option<Blend> {
    value_of(&BLENDS, name)
}

/// Returns a parser that maps names to values.
fn named<T: Copy + Send + Sync + 'static>(values: &'static [(&'static str, T)]) -> impl TypedValueParser<Value = T> {
    let value = move |name: String| value_of(values, &name).expect("a listed name");
    PossibleValuesParser::new(values.iter().map(|v| v.0)).map(value)
}

pub fn layout() -> impl TypedValueParser<Value = Layout> {
    named(&LAYOUTS)
}

pub fn blend() -> impl TypedValueParser<Value = Blend> {
    named(&BLENDS)
}

pub fn tune() -> impl TypedValueParser<Value = Tune> {
    named(&[("psnr", Tune::Psnr), ("iq", Tune::Iq)])
}

pub fn backend() -> impl TypedValueParser<Value = Backend> {
    named(&[("auto", Backend::Auto), ("cpu", Backend::Cpu), ("gpu", Backend::Gpu)])
}

pub fn metadata_policy() -> impl TypedValueParser<Value = MetadataPolicy> {
    named(&[
        ("needed", MetadataPolicy::Needed),
        ("all", MetadataPolicy::All),
        ("icc", MetadataPolicy::Icc),
        ("none", MetadataPolicy::None),
    ])
}

pub fn render_backend() -> impl TypedValueParser<Value = Backend> {
    named(&[("cpu", Backend::Cpu), ("gpu", Backend::Gpu)])
}

pub fn layers() -> impl TypedValueParser<Value = Layers> {
    named(&[("both", Layers::Both), ("gaussians", Layers::Gaussians), ("detail", Layers::Detail)])
}
