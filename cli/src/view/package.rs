//! The files of the viewer, embedded in the program: the sources in `web/`, and the WebAssembly that `web/build
//! --commit` puts beside them. WebAssembly for browsers without vector instructions is only in the web package.

/// The page.
pub const PAGE: &str = "viewer/index.html";
/// The WebAssembly of the decoder.
pub const MODULE: &str = "ssplat-simd.wasm";
/// That of the encoder.
const ENCODER: &str = "ssplat-encode-simd.wasm";
/// That of SSIMULACRA2.
const SCORE: &str = "ssplat-score-simd.wasm";

macro_rules! sources {
    ($($name:literal),* $(,)?) => { &[$(($name, include_str!(concat!(env!("SSPLAT_WEB"), "/", $name)))),*] };
}

/// The modules of the page. Their names without folders are distinct.
pub const MODULES: &[(&str, &str)] = sources![
    "encode-machine.js",
    "encode-worker.js",
    "encode.js",
    "error.js",
    "icc.js",
    "machine.js",
    "source.js",
    "ssplat.js",
    "worker.js",
    "viewer/camera.js",
    "viewer/encoder.js",
    "viewer/facts.js",
    "viewer/found.js",
    "viewer/gaussians.js",
    "viewer/maker.js",
    "viewer/mask.js",
    "viewer/picture.js",
    "viewer/scene.js",
    "viewer/splatting.js",
    "viewer/viewer.js",
    "viewer/webgpu.js",
];

/// The text of [`PAGE`].
pub const PAGE_TEXT: &str = include_str!(concat!(env!("SSPLAT_WEB"), "/viewer/index.html"));
/// The bytes of [`MODULE`].
pub const MODULE_BYTES: &[u8] = include_bytes!(concat!(env!("SSPLAT_WEB"), "/ssplat-simd.wasm"));

/// The bytes of [`ENCODER`], compressed by gzip.
const ENCODER_BYTES: &[u8] = include_bytes!(concat!(env!("SSPLAT_WEB"), "/ssplat-encode-simd.wasm.gz"));

/// The bytes of [`SCORE`], compressed by gzip.
const SCORE_BYTES: &[u8] = include_bytes!(concat!(env!("SSPLAT_WEB"), "/ssplat-score-simd.wasm.gz"));

macro_rules! samples {
    ($($name:literal),* $(,)?) => {
        &[$((concat!("viewer/samples/", $name), include_bytes!(concat!(env!("SSPLAT_WEB"), "/viewer/samples/", $name)))),*]
    };
}

/// The pictures that the start page offers, 40 kB.
const SAMPLES: &[(&str, &[u8])] = samples!["motocross.ssplat", "parrots.ssplat", "portrait.ssplat"];

/// Returns a file of the viewer by its path in the viewer's folder; `None` for other paths.
pub fn file(name: &str) -> Option<&'static [u8]> {
    match name {
        PAGE => Some(PAGE_TEXT.as_bytes()),
        MODULE => Some(MODULE_BYTES),
        ENCODER => Some(ENCODER_BYTES),
        SCORE => Some(SCORE_BYTES),
        _ => {
            let module = MODULES.iter().find(|(known, _)| *known == name).map(|(_, text)| text.as_bytes());
            module.or_else(|| SAMPLES.iter().find(|(known, _)| *known == name).map(|&(_, bytes)| bytes))
        }
    }
}
