//! The committed header is what cbindgen makes of the source.

use std::path::Path;

#[test]
fn the_committed_header_is_current() {
    let root = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/.."));
    let config = cbindgen::Config::from_file(root.join("cbindgen.toml")).unwrap();
    let mut made = Vec::new();
    let builder = cbindgen::Builder::new().with_config(config);
    let sources = ["lib", "failure", "format", "decoder", "encoding", "encoder"].map(|name| format!("src/{name}.rs"));
    let builder = sources.iter().fold(builder, |builder, file| builder.with_src(root.join(file)));
    builder.generate().unwrap().write(&mut made);
    let (made, path) = (String::from_utf8(made).unwrap(), root.join("include/ssplat.h"));
    if std::env::var_os("SSPLAT_WRITE_HEADER").is_some() {
        std::fs::write(&path, &made).unwrap();
    }
    let committed = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(committed == made, "{} is old; SSPLAT_WRITE_HEADER=1 cargo test -p ssplat-capi-header", path.display());
}
