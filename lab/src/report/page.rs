//! Formats the measurements as one self-contained HTML page.

use std::collections::BTreeMap;
use std::fmt::Write;

use ssplat::Backend;

use super::cells::{Cell, Subject};
use super::chart::{Axis, Bars, Chart, Length, Scale, Series, Stroke, escape, number};
use super::codecs::{self, Anchor};
use super::crops;
use super::left_out::{self, Needless};
use super::stability::{Bound, Row};

/// Everything that the page shows.
pub struct Contents<'a> {
    pub subjects: &'a [Subject],
    pub cells: &'a [Cell],
    pub anchors: &'a [Anchor],
    pub stability: &'a [Row],
    pub left_out: &'a [Needless],
    /// The ratio and the effort at which the other is varied.
    pub middle: (f64, u8),
    /// The GPU's name, or the reason why none was found.
    pub gpu: &'a Result<String, String>,
    pub threads: usize,
    /// The command line that makes the page.
    pub command: String,
}

const STYLE: &str = include_str!("page.css");

/// Colours of the codecs, in order of occurrence; 0 is ssplat.
fn codec_colors(anchors: &[Anchor]) -> BTreeMap<&str, usize> {
    let mut colors = BTreeMap::new();
    for a in anchors {
        let next = colors.len() + 1;
        colors.entry(a.codec.as_str()).or_insert(next.min(7));
    }
    colors
}

impl Contents<'_> {
    /// Returns the page.
    pub fn html(&self) -> String {
        let mut html = format!(
            "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><meta name=\"viewport\" content=\"width=device-width,initial-scale=1\">\
             <meta name=\"color-scheme\" content=\"light dark\"><title>ssplat-lab report</title><style>{STYLE}</style></head><body><main>\n\
             <h1>ssplat-lab report</h1>\n<p class=\"lead\">Pictures as 2D Gaussians, version {}: {} picture{}, {} encodes. Sizes are those of whole files; \
             quality is that of the decoded samples.</p>\n",
            env!("CARGO_PKG_VERSION"),
            self.subjects.len(),
            if self.subjects.len() == 1 { "" } else { "s" },
            self.cells.len(),
        );
        html += &self.headline();
        for (i, subject) in self.subjects.iter().enumerate() {
            html += &self.picture(i, subject);
        }
        html += &self.stability();
        html += &self.needless();
        html += &self.method();
        html + "</main></body></html>\n"
    }

    /// Returns the cells of a picture with our own recipe on the default backend.
    fn ours(&self, subject: usize) -> impl Iterator<Item = &Cell> {
        self.cells.iter().filter(move |c| {
            let s = c.job.setup;
            let own = s.smartsplat.is_none() && s.blend.is_none() && s.backend == Backend::Auto;
            c.job.subject == subject && own && c.failed().is_none()
        })
    }

    pub fn over_ratios(&self, subject: usize) -> Vec<&Cell> {
        let mut cells: Vec<&Cell> = self.ours(subject).filter(|c| c.job.setup.effort == self.middle.1).collect();
        cells.sort_by(|a, b| a.job.setup.ratio.total_cmp(&b.job.setup.ratio));
        cells
    }

    fn over_efforts(&self, subject: usize) -> Vec<&Cell> {
        let mut cells: Vec<&Cell> = self.ours(subject).filter(|c| c.job.setup.ratio == self.middle.0).collect();
        cells.sort_by_key(|c| c.job.setup.effort);
        cells
    }

    fn over_recipes(&self, subject: usize) -> Vec<&Cell> {
        let same = |c: &&Cell| {
            let s = c.job.setup;
            c.job.subject == subject && s.ratio == self.middle.0 && s.effort == self.middle.1 && c.failed().is_none()
        };
        self.cells.iter().filter(same).collect()
    }

    /// Returns the first table: at each ratio, our quality and that of the codecs at the same size.
    fn headline(&self) -> String {
        let colors = codec_colors(self.anchors);
        let mut table = String::from(
            "<h2>At a glance</h2>\n<div class=\"scroll\"><table><thead><tr><th>Picture</th><th>Ratio</th><th>Bytes</th><th>PSNR dB</th><th>MS-SSIM</th><th>SSIMULACRA2</th><th>Butteraugli</th><th>Encode s</th><th>Decode ms</th>",
        );
        for codec in colors.keys() {
            let _ = write!(table, "<th>Δ {} dB</th>", escape(codec));
        }
        table += "</tr></thead><tbody>\n";
        for (i, subject) in self.subjects.iter().enumerate() {
            for cell in self.over_ratios(i) {
                let psnr = cell.number("psnr");
                let _ = write!(
                    table,
                    "<tr><th>{}</th><td>{}</td><td>{}</td><td><b>{psnr:.2}</b></td><td>{:.4}</td><td>{:.1}</td><td>{:.2}</td><td>{:.1}</td><td>{:.1}</td>",
                    escape(&subject.name),
                    number(cell.job.setup.ratio),
                    cell.number("bytes"),
                    cell.number("ms_ssim"),
                    cell.number("ssimulacra2"),
                    cell.number("butteraugli"),
                    cell.number("seconds"),
                    cell.number("decode_ms_full"),
                );
                for codec in colors.keys() {
                    match self.lead(&subject.name, codec, cell) {
                        Some(lead) if lead >= 0.0 => {
                            let _ = write!(table, "<td class=\"up\">+{lead:.2}</td>");
                        }
                        Some(lead) => {
                            let _ = write!(table, "<td class=\"down\">−{:.2}</td>", -lead);
                        }
                        None => table += "<td class=\"none\">–</td>",
                    }
                }
                table += "</tr>\n";
            }
        }
        table += "</tbody></table></div>\n<p class=\"note\">Δ is our PSNR minus the codec's at the same bytes, between its measured files; – where it \
                  has no files around that size.</p>\n";
        table
    }

    /// Returns the names of the other codecs.
    pub fn codecs(&self) -> Vec<&str> {
        codec_colors(self.anchors).into_keys().collect()
    }

    /// Returns the difference of the PSNR of `cell` and of `codec` at the same size, dB; `None` if the codec has no
    /// files of about that size.
    pub fn lead(&self, image: &str, codec: &str, cell: &Cell) -> Option<f64> {
        let curve = self.curve(image, codec, |a| Some(a.psnr));
        codecs::at_bytes(&curve, cell.number("bytes")).map(|other| cell.number("psnr") - other)
    }

    fn curve(&self, image: &str, codec: &str, value: impl Fn(&Anchor) -> Option<f64>) -> Vec<(f64, f64)> {
        let of = self.anchors.iter().filter(|a| a.image == image && a.codec == codec);
        let mut curve: Vec<(f64, f64)> = of.filter_map(|a| Some((a.bytes as f64, value(a)?))).collect();
        curve.sort_by(|a, b| a.0.total_cmp(&b.0));
        curve
    }

    fn picture(&self, i: usize, subject: &Subject) -> String {
        let p = &subject.pixels;
        let mut html = format!(
            "<h2>{}</h2>\n<p>{} × {} pixels, {} channel{}.</p>\n<div class=\"grid\">\n",
            escape(&subject.name),
            p.width(),
            p.height(),
            p.channels().count(),
            if p.channels().count() == 1 { "" } else { "s" }
        );
        html += &self.quality(i, subject);
        html += &self.time(i);
        html += &self.recipes(i);
        html += &self.decoding(i);
        html += &self.bytes(i);
        html += &self.stages(i);
        html += "</div>\n";
        html + &self.crops(i, subject)
    }

    /// Quality against bytes, with the other codecs.
    fn quality(&self, i: usize, subject: &Subject) -> String {
        let cells = self.over_ratios(i);
        let sizes: Vec<f64> = cells.iter().map(|c| c.number("bytes")).collect();
        let (low, high) = sizes.iter().fold((f64::INFINITY, 0.0f64), |(l, h), &b| (l.min(b), h.max(b)));
        let colors = codec_colors(self.anchors);
        let x = Axis { label: "bytes", scale: Scale::Log };
        let chart = |title: &str, label, key: &str, value: fn(&Anchor) -> Option<f64>, shown: fn(f64) -> f64| {
            let points = |list: Vec<(f64, f64)>| list.into_iter().map(|(b, v)| (b, shown(v))).collect();
            let own = cells.iter().map(|c| (c.number("bytes"), c.number(key))).filter(|p| p.1.is_finite()).collect();
            let mut series =
                vec![Series { name: "ssplat".into(), color: 0, stroke: Stroke::Strong, points: points(own) }];
            for (codec, &color) in &colors {
                let mut curve = self.curve(&subject.name, codec, value);
                curve.retain(|p| p.0 > low / 1.6 && p.0 < high * 1.6);
                if !curve.is_empty() {
                    let stroke = Stroke::Plain;
                    series.push(Series { name: (*codec).into(), color, stroke, points: points(curve) });
                }
            }
            let y = Axis { label, scale: Scale::Linear };
            Chart { title: title.into(), x: x.clone(), y, series }.html()
        };
        let log = |v: f64| -10.0 * (1.0 - v).max(1e-6).log10();
        chart("PSNR", "dB", "psnr", |a| Some(a.psnr), |v| v)
            + &chart("MS-SSIM", "dB of 1 − MS-SSIM", "ms_ssim", |a| a.ms_ssim, log)
            + &chart("SSIM", "dB of 1 − SSIM", "ssim", |a| a.ssim, log)
            + &chart("SSIMULACRA2", "SSIMULACRA2", "ssimulacra2", |a| a.ssimulacra2, |v| v)
            + &chart("Butteraugli", "Butteraugli, 3-norm (less is better)", "butteraugli", |a| a.butteraugli, |v| v)
    }

    /// Quality against seconds along each encode, by effort.
    fn time(&self, i: usize) -> String {
        let cells = self.over_efforts(i);
        let chart = |title: &str, key: &str, label| {
            let series = cells.iter().enumerate().map(|(k, c)| Series {
                name: format!("effort {}", c.job.setup.effort),
                color: if c.job.setup.effort == self.middle.1 { 0 } else { k + 1 },
                stroke: Stroke::Bare,
                points: settled(c.trace(key)),
            });
            let x = Axis { label: "seconds", scale: Scale::Log };
            let y = Axis { label, scale: Scale::Linear };
            Chart { title: format!("{title} while encoding, ratio {}", self.middle.0), x, y, series: series.collect() }
                .html()
        };
        chart("PSNR", "psnr", "dB") + &chart("SSIM", "ssim", "") + &chart("MS-SSIM", "ms_ssim", "")
    }

    /// Recipes and backends, against seconds.
    fn recipes(&self, i: usize) -> String {
        let cells = self.over_recipes(i);
        if cells.len() < 2 {
            return String::new();
        }
        let is_compared = cells.iter().any(|c| c.job.setup.backend != Backend::Auto);
        let what = if is_compared { "Recipes and backends" } else { "Recipes" };
        let name = |c: &Cell| match c.job.setup.backend {
            Backend::Auto => c.job.setup.recipe_name(),
            _ => format!("{} ({})", c.job.setup.recipe_name(), c.job.setup.backend_name()),
        };
        let series = cells.iter().enumerate().map(|(k, c)| Series {
            name: format!("{}: {:.2} dB", name(c), c.number("psnr")),
            color: k % 8,
            stroke: if k == 0 { Stroke::Strong } else { Stroke::Plain },
            points: settled(c.trace("psnr")),
        });
        let series = series.map(|s| Series { stroke: Stroke::Bare, ..s }).collect();
        let x = Axis { label: "seconds", scale: Scale::Log };
        let y = Axis { label: "dB", scale: Scale::Linear };
        Chart { title: format!("{what}, ratio {}, PSNR", self.middle.0), x, y, series }.html()
    }

    /// Decode time against quality.
    fn decoding(&self, i: usize) -> String {
        let cells = self.over_ratios(i);
        let views = [
            ("whole picture", "decode_ms_full"),
            ("region of 256 px", "decode_ms_region"),
            ("thumbnail of 160 px", "decode_ms_thumbnail"),
        ];
        let series = views.into_iter().enumerate().map(|(k, (name, key))| Series {
            name: name.into(),
            color: k,
            stroke: if k == 0 { Stroke::Strong } else { Stroke::Plain },
            points: cells.iter().map(|c| (c.number("psnr"), c.number(key))).collect(),
        });
        let x = Axis { label: "PSNR, dB", scale: Scale::Linear };
        let y = Axis { label: "ms, from file bytes to samples", scale: Scale::Log };
        Chart { title: "Decode time".into(), x, y, series: series.collect() }.html()
    }

    /// Bytes by part of the file.
    fn bytes(&self, i: usize) -> String {
        let cells = self.over_ratios(i);
        let mut parts: Vec<String> = Vec::new();
        for c in &cells {
            for (name, _) in c.pairs("fields") {
                if !parts.contains(&name) {
                    parts.push(name);
                }
            }
        }
        let mut rows = Vec::new();
        for c in &cells {
            let fields = c.pairs("fields");
            let mut values: Vec<f64> =
                parts.iter().map(|p| fields.iter().find(|f| f.0 == *p).map_or(0.0, |f| f.1)).collect();
            values.push((c.number("bytes") - values.iter().sum::<f64>()).max(0.0));
            rows.push((format!("1 : {}", number(c.job.setup.ratio)), values));
        }
        parts.push("header, checks and the rest".into());
        Bars { title: "Where the bytes went".into(), unit: "B", parts, rows, length: Length::Share }.html()
    }

    /// Time by stage.
    fn stages(&self, i: usize) -> String {
        let cells = self.over_efforts(i);
        let mut parts: Vec<String> = Vec::new();
        for c in &cells {
            for (name, _) in c.pairs("stages") {
                if !parts.contains(&name) {
                    parts.push(name);
                }
            }
        }
        let rows = cells.iter().map(|c| {
            let stages = c.pairs("stages");
            let of = |p: &String| stages.iter().filter(|s| s.0 == *p).map(|s| s.1).sum::<f64>();
            (format!("effort {}", c.job.setup.effort), parts.iter().map(of).collect())
        });
        let rows = rows.collect();
        Bars { title: "Where the time went".into(), unit: "s", parts, rows, length: Length::Sum }.html()
    }

    /// Crops of the decoded pictures and of their errors.
    fn crops(&self, i: usize, subject: &Subject) -> String {
        let original = crops::rgb(&subject.pixels);
        let place = crops::busiest(&original);
        let whole = crops::cut(&original, place);
        let piece = |uri: String, text: String| {
            format!(
                "<figure class=\"piece\"><img src=\"{uri}\" alt=\"{text}\" width=\"{}\" height=\"{}\"><figcaption>{text}</figcaption></figure>",
                place[2], place[3]
            )
        };
        let mut html = String::from("<div class=\"pieces\">\n");
        html += &piece(crops::data_uri(&whole), "original".into());
        for cell in self.over_ratios(i) {
            let Ok(decoded) = ssplat_cli::source::decode(std::path::Path::new(&subject.name), &cell.bytes) else {
                continue;
            };
            let part = crops::cut(&crops::rgb(&decoded.pixels), place);
            let ratio = number(cell.job.setup.ratio);
            html += &piece(crops::data_uri(&part), format!("1 : {ratio}, {:.1} dB", cell.number("psnr")));
            let error = crops::error(&whole, &part);
            html += &piece(crops::data_uri(&error), format!("its error × {}", crops::GAIN));
        }
        html + "</div>\n"
    }

    fn stability(&self) -> String {
        if self.stability.is_empty() {
            return String::new();
        }
        let failed = self.stability.iter().filter(|r| !r.holds()).count();
        let mut html = format!(
            "<h2>Stiff and extreme cases</h2>\n<p>{} cases, {}. A fit must be finite and no worse than the picture of its mean colour; a picture drawn in \
             f32 must stay within one 8-bit code value of the f64 definition; gradients must be those of finite differences in f64.</p>\n",
            self.stability.len(),
            if failed == 0 { "all within their bounds".into() } else { format!("{failed} beyond their bounds") },
        );
        html += "<div class=\"scroll\"><table><thead><tr><th>Kind</th><th>Cases</th><th class=\"text\">The worst of them</th><th>Worst</th>\
                 <th>Bound</th></tr></thead><tbody>\n";
        let mut groups: Vec<&str> = Vec::new();
        for row in self.stability {
            if !groups.contains(&row.group.as_str()) {
                groups.push(&row.group);
            }
        }
        for group in groups {
            let rows = || self.stability.iter().filter(|r| r.group == group);
            let Some(row) = rows().max_by(|a, b| a.badness().total_cmp(&b.badness())) else { continue };
            let (worst, bound) = figures(row);
            let _ = writeln!(
                html,
                "<tr><th>{}</th><td>{}</td><td class=\"text\">{}</td><td>{worst}</td><td>{bound}</td></tr>",
                escape(group),
                rows().count(),
                escape(&row.case),
            );
        }
        html += "</tbody></table></div>\n<details><summary>All cases, and what guards each</summary>\n<div class=\"scroll\"><table><thead><tr><th>Kind</th>\
                 <th class=\"text\">Case</th><th>Worst</th><th>Bound</th><th></th><th class=\"text\">What guards it</th></tr></thead><tbody>\n";
        for row in self.stability {
            let (worst, bound) = figures(row);
            let _ = writeln!(
                html,
                "<tr><th>{}</th><th>{}</th><td>{worst}</td><td>{bound}</td><td class=\"{}\">{}</td><td class=\"text\">{}</td></tr>",
                escape(&row.group),
                escape(&row.case),
                if row.holds() { "up" } else { "down" },
                if row.holds() { "✓" } else { "✗" },
                escape(&row.guard)
            );
        }
        html + "</tbody></table></div></details>\n"
    }

    fn needless(&self) -> String {
        if self.left_out.is_empty() {
            return String::new();
        }
        let mut html = format!(
            "<h2>What a scene leaves out</h2>\n<p>The same picture, encoded with 400 primitives or fewer: once with everything, once without what the encoder \
             measured to be needless; {}; in brackets, bytes of the file written both ways. The photograph is a part of the first picture.</p>\n\
             <div class=\"scroll\"><table><thead><tr><th>Scene</th><th class=\"text\">Left out</th><th>Bytes</th><th>Saved</th>\
             <th>Seconds</th><th>Saved</th><th>PSNR dB</th><th>Change</th></tr></thead><tbody>\n",
            left_out::settings()
        );
        let common = left_out::common(self.left_out);
        for n in self.left_out {
            let _ = writeln!(
                html,
                "<tr><th>{}</th><td class=\"text\">{}</td><td>{}</td><td>{}</td><td>{:.2}</td><td>{:.2}</td><td>{:.2}</td><td>{:+.2}</td></tr>",
                escape(&n.scene),
                escape(&n.own(&common)),
                n.bytes[1],
                n.bytes[0] as i64 - n.bytes[1] as i64,
                n.seconds[1],
                n.seconds[0] - n.seconds[1],
                n.psnr[1],
                n.psnr[1] - n.psnr[0],
            );
        }
        html += "</tbody></table></div>\n";
        if !common.is_empty() {
            let _ = writeln!(html, "<p>All of them leave out: {}.</p>", escape(&common.join("; ")));
        }
        html
    }

    /// Describes the devices that fitted, and whether a GPU is among them.
    pub fn backends(&self) -> String {
        let mut devices: Vec<&str> = self.cells.iter().filter_map(|c| c.values["device"].as_str()).collect();
        devices.sort_unstable();
        devices.dedup();
        let gpu = match self.gpu {
            Ok(name) => format!("The GPU of this machine is {name}."),
            Err(why) => format!("No row is from a hardware GPU: {why}."),
        };
        format!("Fitted on: {}. {gpu}", devices.join("; "))
    }

    fn method(&self) -> String {
        let seconds: f64 = self.cells.iter().map(|c| c.number("seconds")).filter(|s| s.is_finite()).sum();
        let mut html = format!(
            "<h2>How this was made</h2>\n<p><code>{}</code></p>\n<p>{} threads. The encodes took {} seconds in all; seconds along an encode do not count the \
             measuring. Decode times are the best of seven in one process, from the file's bytes in memory to samples. Everything but the times is the same \
             at every run. The numbers are in <code>results.csv</code> and <code>results.json</code>.</p>\n",
            escape(&self.command),
            self.threads,
            number(seconds)
        );
        let _ = writeln!(html, "<p>{}</p>", escape(&self.backends()));
        for c in self.cells.iter().filter(|c| c.failed().is_some()) {
            let s = c.job.setup;
            let _ = writeln!(
                html,
                "<p>Not measured: {} at ratio {}, {}, {}: {}</p>",
                escape(&self.subjects[c.job.subject].name),
                s.ratio,
                escape(&s.recipe_name()),
                s.backend_name(),
                escape(c.failed().unwrap_or(""))
            );
        }
        html
    }
}

/// Returns the texts of a row's measured value and of its bound.
pub fn figures(row: &Row) -> (String, String) {
    let small = |v: f64| if v != 0.0 && v.abs() < 1e-2 { format!("{v:.0e}") } else { number(v) };
    match row.bound {
        Bound::Codes(v) => (format!("{} codes", small(row.worst)), format!("≤ {} codes", number(v))),
        Bound::Gain(v) => (format!("{:+.2} dB", row.worst), format!("≥ {v} dB")),
        Bound::Relative(v) => (format!("{:.1e}", row.worst), format!("≤ {v:e}")),
        Bound::Reported if row.worst.is_infinite() => ("singular".into(), "–".into()),
        Bound::Reported => (format!("{:.1e}", row.worst), "–".into()),
    }
}

/// Returns a trace from its third point on: the first ones, of the initial state, would dominate the scale.
fn settled(trace: Vec<(f64, f64)>) -> Vec<(f64, f64)> {
    let skip = trace.iter().position(|p| p.0 > 0.0).unwrap_or(0).max(2).min(trace.len().saturating_sub(2));
    trace[skip..].to_vec()
}
