//! Savings by the data that the encoder leaves out: each scene is encoded with everything and with only the necessary
//! data.

use serde_json::{Value, json};
use ssplat::unstable::{DecodeOptions, EncodeOptions, Needs, encode, metrics};
use ssplat::{Pixels, Target, Tune};

use super::scenes;

/// Number of encodes that are averaged: with few primitives, chance has as much effect as the data left out.
const SEEDS: u64 = 4;

/// Effort of each encode, a small part of the report's.
const EFFORT: u8 = 1;

/// Describes the settings of these encodes.
pub fn settings() -> String {
    format!("effort {EFFORT}, means over {SEEDS} seeds")
}

/// One scene, encoded both with everything and with only the necessary data; means over the seeds.
#[derive(Debug, Clone, PartialEq)]
pub struct Needless {
    pub scene: String,
    pub what: Vec<String>,
    pub bytes: [u64; 2],
    pub seconds: [f64; 2],
    /// PSNR of the decoded samples, dB, at most 99.
    pub psnr: [f64; 2],
}

impl Needless {
    /// Returns the names of the data that this scene leaves out, except those that are `common` to all scenes.
    pub fn own(&self, common: &[&str]) -> String {
        let own: Vec<&str> = self.what.iter().map(String::as_str).filter(|w| !common.contains(w)).collect();
        if own.is_empty() { "nothing".into() } else { own.join("; ") }
    }

    pub fn as_json(&self) -> Value {
        json!({
            "scene": self.scene, "left_out": self.what, "bytes": self.bytes, "seconds": self.seconds, "psnr": self.psnr,
        })
    }
}

/// Returns the data that every scene leaves out, if there are several scenes.
pub fn common(rows: &[Needless]) -> Vec<&str> {
    let [first, rest @ ..] = rows else { return Vec::new() };
    let everywhere = |what: &&String| !rest.is_empty() && rest.iter().all(|n| n.what.contains(what));
    first.what.iter().filter(everywhere).map(String::as_str).collect()
}

/// Reads the result of [`Needless::as_json`].
pub fn from_json(v: &Value) -> Option<Needless> {
    let pair = |key: &str| Some([v[key][0].as_f64()?, v[key][1].as_f64()?]);
    Some(Needless {
        scene: v["scene"].as_str()?.into(),
        what: v["left_out"].as_array()?.iter().filter_map(|w| Some(w.as_str()?.to_string())).collect(),
        bytes: [v["bytes"][0].as_u64()?, v["bytes"][1].as_u64()?],
        seconds: pair("seconds")?,
        psnr: pair("psnr")?,
    })
}

/// A picture of the table, and how it is encoded.
pub struct Scene {
    pub name: String,
    pub pixels: Pixels,
    pub target: Target,
    pub tune: Tune,
}

impl Scene {
    /// A scene with at most 400 primitives and without a layer, for the lowest squared error.
    fn of_primitives(name: &str, pixels: Pixels) -> Self {
        Scene { name: name.into(), pixels, target: Target::Gaussians(400), tune: Tune::Psnr }
    }

    /// A scene with the default tuning, which has a detail layer at most ratios.
    fn of_ratio(name: &str, pixels: Pixels, ratio: f64) -> Self {
        Scene { name: format!("{name}, ratio {ratio}"), pixels, target: Target::Ratio(ratio), tune: Tune::Iq }
    }
}

/// Returns the scenes of the table; the photograph is a crop of `photograph`.
pub fn list(photograph: Option<Pixels>) -> Vec<Scene> {
    let mut list = vec![
        Scene::of_primitives("flat icon, opaque alpha", scenes::icon()),
        Scene::of_primitives("grey scan stored as colour", scenes::scan()),
        Scene::of_primitives("gradient", scenes::gradient()),
        Scene::of_primitives("text page stored as colour", scenes::text()),
        Scene::of_primitives("diagram", scenes::diagram(256)),
        Scene::of_ratio("flat icon, opaque alpha", scenes::icon(), 50.0),
        Scene::of_ratio("grey scan stored as colour", scenes::scan(), 50.0),
        Scene::of_ratio("diagram", scenes::diagram(256), 50.0),
        Scene::of_ratio("diagram", scenes::diagram(256), 200.0),
    ];
    if let Some(photograph) = photograph {
        list.push(Scene::of_primitives("photograph", photograph.clone()));
        list.push(Scene::of_ratio("photograph", photograph, 50.0));
    }
    list
}

/// Encodes a scene both ways.
///
/// # Errors
/// Errors of the encoder and of the decoder.
pub fn measure(Scene { name, pixels, target, tune }: &Scene) -> ssplat::Result<Needless> {
    let mut options = EncodeOptions::default();
    options.target = *target;
    options.effort = EFFORT;
    options.tune = Some(*tune);
    let mut out = Needless { scene: name.clone(), what: Vec::new(), bytes: [0; 2], seconds: [0.0; 2], psnr: [0.0; 2] };
    let both = [Needs::Everything, Needs::Measured].into_iter().enumerate();
    let all = (0..SEEDS).flat_map(|seed| both.clone().map(move |(i, needs)| (seed, i, needs)));
    for (seed, i, needs) in all {
        (options.seed, options.needs) = (seed, needs);
        let encoded = encode(pixels, &options)?;
        let drawn = ssplat::unstable::decode(&encoded.bytes, &DecodeOptions::default())?.pixels;
        out.bytes[i] += encoded.bytes.len() as u64;
        out.seconds[i] += encoded.report.seconds / SEEDS as f64;
        out.psnr[i] += metrics::psnr(pixels, &drawn)?.min(99.0) / SEEDS as f64;
        for l in &encoded.report.skipped {
            let text = match l.bytes {
                0 => l.what.to_string(),
                bytes => format!("{} ({bytes} B)", l.what),
            };
            // The first seed's bytes represent all.
            if i == 1 && !out.what.iter().any(|w| w.starts_with(&l.what.to_string())) {
                out.what.push(text);
            }
        }
    }
    out.bytes = out.bytes.map(|b| (b + SEEDS / 2) / SEEDS);
    Ok(out)
}
