//! Learns the initial states of a tile's models from their final states in the tiles of many files.
//!
//! `SSPLAT_LEARN="a.ssplat b.ssplat …" cargo test --release --lib learn_where_models_begin -- --ignored` writes the
//! table of the specification. `examples/python/learn_detail.py` makes such files and runs it.

use super::model::Models;
use super::tile::{Count, read_with};
use crate::bitstream::coder::range::Decoder;
use crate::bitstream::detail::index::streams;
use crate::bitstream::read;
use crate::limits::Limits;

/// Confidence of an initial state, in decisions, by the number of decisions seen of its model.
const CONFIDENCE: [(f64, u8); 4] = [(2.0, 0), (30.0, 2), (150.0, 5), (f64::INFINITY, 8)];

#[test]
#[ignore = "writes the table"]
fn learn_where_models_begin() {
    let files = std::env::var("SSPLAT_LEARN").expect("SSPLAT_LEARN names files");
    // The weights of zeros and of ones for each model.
    let mut seen: Vec<[f64; 2]> = Vec::new();
    for file in files.split_whitespace() {
        let bytes = std::fs::read(file).unwrap();
        let splats = read(&bytes[..], &Limits::default()).unwrap();
        let Some(layer) = &splats.detail else { continue };
        let size = [splats.width, splats.height];
        for (stream, [width, height]) in streams(layer, size, splats.channels) {
            let mut models = Models::start();
            let mut decoder = Decoder::new(&stream).unwrap();
            read_with(
                &mut decoder,
                &mut models,
                (&layer.head, splats.channels, [width, height]),
                &mut Count::up_to(usize::MAX),
            )
            .unwrap();
            let mut begun = Vec::new();
            Models::start().each(&mut |models| begun.extend_from_slice(models));
            let mut ended = Vec::new();
            models.each(&mut |models| ended.extend_from_slice(models));
            seen.resize(ended.len(), [0.0; 2]);
            for ((model, begun), seen) in ended.iter().zip(&begun).zip(&mut seen) {
                let (slow, count) = model.learnt();
                let more = f64::from(count) - f64::from(begun.learnt().1);
                if model != begun && more > 0.0 {
                    let one = f64::from(slow) / 65_536.0;
                    *seen = [seen[0] + more * (1.0 - one), seen[1] + more * one];
                }
            }
        }
    }
    let one = |s: &[f64; 2]| ((s[1] + 0.4) / (s[0] + s[1] + 0.8) * 256.0) as u8;
    let trust = |s: &[f64; 2]| CONFIDENCE.iter().find(|t| s[0] + s[1] < t.0).expect("the last is infinite").1;
    let rows = |values: Vec<u8>| {
        let numbers: Vec<String> = values.iter().map(u8::to_string).collect();
        numbers.chunks(32).map(|row| row.join(" ") + "\n").collect::<String>()
    };
    let [one, trust] = [rows(seen.iter().map(one).collect()), rows(seen.iter().map(trust).collect())];
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/spec/detail-models.txt");
    std::fs::write(path, format!("{one}\n{trust}")).unwrap();
}
