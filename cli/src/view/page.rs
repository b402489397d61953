//! The viewer and a file as one self-contained HTML page.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde_json::{Map, Value, json};

use super::Shown;
use super::package::{MODULE, MODULE_BYTES, MODULES, PAGE_TEXT};

/// The element of the page in `web/` that loads its module; the self-contained page replaces it.
const PLACE: &str = "<script type=\"module\" src=\"viewer.js\"></script>";

/// Returns the page. Its modules are in an import map, because a self-contained page has no files beside it.
pub fn packed(file: &Shown, original: Option<&Shown>) -> String {
    let mut imports = Map::new();
    for (name, text) in MODULES {
        // A worker would need a file of its own, and the page shows one file only.
        if *name == "worker.js" || name.starts_with("encode") {
            continue;
        }
        let source = text.replace("from \"./", "from \"ssplat/").replace("from \"../", "from \"ssplat/");
        let url = format!("data:text/javascript;base64,{}", STANDARD.encode(source));
        imports.insert(format!("ssplat/{}", name.rsplit('/').next().unwrap_or(name)), Value::from(url));
    }
    let mut inside = held("held-module", MODULE, MODULE_BYTES) + &held("held-file", &file.name, &file.bytes);
    if let Some(original) = original {
        inside += &held("held-original", &original.name, &original.bytes);
    }
    inside += &format!("<script type=\"importmap\">{}</script>\n", json!({ "imports": imports }));
    inside += "<script type=\"module\">import \"ssplat/viewer.js\"</script>";
    PAGE_TEXT.replacen(PLACE, &inside, 1)
}

/// Returns an element with bytes that the page finds by `id`. The name of a [`Shown`] needs no escaping in HTML.
fn held(id: &str, name: &str, bytes: &[u8]) -> String {
    let text = STANDARD.encode(bytes);
    format!("<script type=\"application/octet-stream\" id=\"{id}\" data-name=\"{name}\">{text}</script>\n")
}
