//! The viewer with a file in it as one page that asks for nothing else.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde_json::{Map, Value, json};

use super::Shown;
use super::package::{MODULES, PAGE, Package, SCALAR};
use crate::failure::Failure;

/// What the page of `web/` has where its module is loaded, which the page of one file replaces.
const PLACE: &str = "<script type=\"module\" src=\"viewer.js\"></script>";

/// Writes the page. Its modules find each other by name in an import map, as such a page has no place beside it.
pub fn packed(package: &Package, file: &Shown, original: Option<&Shown>) -> Result<String, Failure> {
    let mut imports = Map::new();
    for module in MODULES {
        // A worker would be another file.
        if module == "worker.js" {
            continue;
        }
        let source =
            package.text(module)?.replace("from \"./", "from \"ssplat/").replace("from \"../", "from \"ssplat/");
        let url = format!("data:text/javascript;base64,{}", STANDARD.encode(source));
        imports.insert(format!("ssplat/{}", module.rsplit('/').next().unwrap_or(module)), Value::from(url));
    }
    let decoder = Shown { name: SCALAR.into(), bytes: package.file(SCALAR).unwrap_or_default().to_vec() };
    let mut inside = held("held-module", &decoder) + &held("held-file", file);
    if let Some(original) = original {
        inside += &held("held-original", original);
    }
    inside += &format!("<script type=\"importmap\">{}</script>\n", json!({ "imports": imports }));
    inside += "<script type=\"module\">import \"ssplat/viewer.js\"</script>";
    match package.text(PAGE)?.split_once(PLACE) {
        Some((before, after)) => Ok(format!("{before}{inside}{after}")),
        None => Err(package.broken(PAGE, "no page of the viewer")),
    }
}

/// Bytes that the page finds by the name `id`. A [`Shown`] has a name without letters that mean something in HTML.
fn held(id: &str, what: &Shown) -> String {
    let text = STANDARD.encode(&what.bytes);
    format!("<script type=\"application/octet-stream\" id=\"{id}\" data-name=\"{}\">{text}</script>\n", what.name)
}
