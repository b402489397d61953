//! Renders numbers as SVG: line charts and stacked bars, coloured by the page's style, which supports light and dark
//! mode.

use std::fmt::Write;

/// Size of a chart, in units of which its text is 11 high. A phone shows it at nearly full size.
const WIDTH: f64 = 420.0;
const HEIGHT: f64 = 270.0;
/// Space for the labels: left, right, top, bottom.
const MARGIN: [f64; 4] = [46.0, 12.0, 10.0, 40.0];

/// Mapping of values to positions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scale {
    Linear,
    Log,
}

/// An axis: its label, with the unit, and its scale.
#[derive(Debug, Clone)]
pub struct Axis {
    pub label: &'static str,
    pub scale: Scale,
}

/// Style of a line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stroke {
    /// A thick line with dots: the main series.
    Strong,
    /// A thin line with dots: a series for comparison.
    Plain,
    /// A line without dots, for many points.
    Bare,
}

/// One line.
#[derive(Debug, Clone)]
pub struct Series {
    pub name: String,
    /// Index into the page's colours.
    pub color: usize,
    pub stroke: Stroke,
    pub points: Vec<(f64, f64)>,
}

/// A chart of lines.
#[derive(Debug, Clone)]
pub struct Chart {
    pub title: String,
    pub x: Axis,
    pub y: Axis,
    pub series: Vec<Series>,
}

impl Chart {
    /// Returns the chart as an HTML figure with its legend.
    pub fn html(&self) -> String {
        let points = || self.series.iter().flat_map(|s| s.points.iter().copied());
        if points().count() == 0 {
            return String::new();
        }
        let x = Span::new(points().map(|p| p.0), self.x.scale);
        let y = Span::new(points().map(|p| p.1), self.y.scale);
        let [left, right, top, bottom] = MARGIN;
        let (w, h) = (WIDTH - left - right, HEIGHT - top - bottom);
        let at = |p: (f64, f64)| (left + w * x.share(p.0), top + h * (1.0 - y.share(p.1)));
        let mut svg = format!(
            r#"<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{}">"#,
            escape(&format!("{}: {} against {}", self.title, self.y.label, self.x.label))
        );
        for tick in y.ticks(5) {
            let (_, py) = at((x.low, tick));
            let _ = write!(
                svg,
                r#"<line class="grid" x1="{left}" x2="{}" y1="{py:.1}" y2="{py:.1}"/><text x="{}" y="{:.1}" text-anchor="end">{}</text>"#,
                WIDTH - right,
                left - 6.0,
                py + 4.0,
                y.text(tick)
            );
        }
        let mut free = f64::NEG_INFINITY;
        for tick in x.ticks(6) {
            let (px, _) = at((tick, y.low));
            let text = x.text(tick);
            let half = text.len() as f64 * 3.2;
            let _ =
                write!(svg, r#"<line class="grid" x1="{px:.1}" x2="{px:.1}" y1="{top}" y2="{}"/>"#, HEIGHT - bottom);
            // A label that would touch its neighbour is omitted; its line is kept.
            if px - half > free && px + half < WIDTH {
                let _ = write!(
                    svg,
                    r#"<text x="{px:.1}" y="{}" text-anchor="middle">{text}</text>"#,
                    HEIGHT - bottom + 15.0
                );
                free = px + half + 4.0;
            }
        }
        let _ = write!(
            svg,
            r#"<text class="label" x="{:.1}" y="{}" text-anchor="middle">{}</text>"#,
            left + w / 2.0,
            HEIGHT - 6.0,
            escape(self.x.label)
        );
        // The main series is drawn last, on top.
        let mut order: Vec<&Series> = self.series.iter().collect();
        order.sort_by_key(|s| s.stroke == Stroke::Strong);
        for s in order {
            let places: Vec<(f64, f64)> = s.points.iter().map(|&p| at(p)).collect();
            let line: String = places.iter().map(|p| format!("{:.1},{:.1} ", p.0, p.1)).collect();
            let class = if s.stroke == Stroke::Strong { " strong" } else { "" };
            let _ = write!(svg, r#"<polyline class="line s{}{class}" points="{}"/>"#, s.color, line.trim_end());
            if s.stroke == Stroke::Bare {
                continue;
            }
            for (place, p) in places.iter().zip(&s.points) {
                let _ = write!(
                    svg,
                    r#"<circle class="dot s{}" cx="{:.1}" cy="{:.1}" r="{}"><title>{}: {} {}, {} {}</title></circle>"#,
                    s.color,
                    place.0,
                    place.1,
                    if s.stroke == Stroke::Strong { 3.5 } else { 2.5 },
                    escape(&s.name),
                    number(p.0),
                    escape(self.x.label),
                    number(p.1),
                    escape(self.y.label)
                );
            }
        }
        svg += "</svg>";
        let names: Vec<(usize, &str)> = self.series.iter().map(|s| (s.color, s.name.as_str())).collect();
        figure(&format!("{} <small>{}</small>", escape(&self.title), escape(self.y.label)), &svg, &names)
    }
}

/// Rows of stacked bars: each row has a label and one value for each part.
#[derive(Debug, Clone)]
pub struct Bars {
    pub title: String,
    pub unit: &'static str,
    pub parts: Vec<String>,
    pub rows: Vec<(String, Vec<f64>)>,
    /// Whether rows fill the width whatever their sum, or share one scale.
    pub length: Length,
}

/// Meaning of a bar's length.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Length {
    /// No meaning: parts are fractions of their row.
    Share,
    /// The row's sum.
    Sum,
}

impl Bars {
    /// Returns the bars as an HTML figure with its legend.
    pub fn html(&self) -> String {
        const ROW: f64 = 30.0;
        let (left, right) = (78.0, 62.0);
        let sum = |v: &[f64]| v.iter().sum::<f64>();
        let longest = self.rows.iter().map(|r| sum(&r.1)).fold(0.0, f64::max);
        if longest <= 0.0 {
            return String::new();
        }
        let height = ROW * self.rows.len() as f64 + 8.0;
        let mut svg =
            format!(r#"<svg viewBox="0 0 {WIDTH} {height}" role="img" aria-label="{}">"#, escape(&self.title));
        for (i, (label, values)) in self.rows.iter().enumerate() {
            let y = ROW * i as f64 + 4.0;
            let all = sum(values);
            let scale = (WIDTH - left - right) / if self.length == Length::Sum { longest } else { all.max(1e-12) };
            let _ =
                write!(svg, r#"<text x="{}" y="{}" text-anchor="end">{}</text>"#, left - 8.0, y + 15.0, escape(label));
            let mut x = left;
            for (k, &v) in values.iter().enumerate() {
                let w = v * scale;
                if w > 0.05 {
                    let _ = write!(
                        svg,
                        r#"<rect class="bar s{k}" x="{x:.1}" y="{y}" width="{:.2}" height="20"><title>{}: {} {}, {:.0} %</title></rect>"#,
                        (w - 1.0).max(0.4),
                        escape(&self.parts[k]),
                        number(v),
                        self.unit,
                        100.0 * v / all
                    );
                }
                x += w;
            }
            let _ = write!(svg, r#"<text x="{:.1}" y="{}">{} {}</text>"#, x + 6.0, y + 15.0, number(all), self.unit);
        }
        svg += "</svg>";
        let names: Vec<(usize, &str)> = self.parts.iter().enumerate().map(|(i, n)| (i, n.as_str())).collect();
        figure(&escape(&self.title), &svg, &names)
    }
}

fn figure(title: &str, svg: &str, names: &[(usize, &str)]) -> String {
    let mut html = format!("<figure><figcaption>{title}</figcaption>{svg}<ul class=\"legend\">");
    for (color, name) in names {
        let _ = write!(html, r#"<li><i class="s{color}"></i>{}</li>"#, escape(name));
    }
    html + "</ul></figure>\n"
}

/// The values that an axis shows.
struct Span {
    low: f64,
    high: f64,
    scale: Scale,
}

impl Span {
    fn new(values: impl Iterator<Item = f64>, scale: Scale) -> Self {
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for v in values.filter(|v| v.is_finite()) {
            (low, high) = (low.min(v), high.max(v));
        }
        match scale {
            Scale::Log => {
                low = low.max(1e-6);
                // At least two round values, however few points there are.
                let pad = (high / low).max(1.2).powf(0.04).max((2.6 / (high / low)).sqrt());
                Span { low: low / pad, high: high.max(low) * pad, scale }
            }
            Scale::Linear => {
                let pad = ((high - low) * 0.06).max(high.abs() * 1e-3).max(1e-6);
                let under = if low >= 0.0 && low - pad < 0.0 { 0.0 } else { low - pad };
                Span { low: under, high: high + pad, scale }
            }
        }
    }

    fn share(&self, v: f64) -> f64 {
        match self.scale {
            Scale::Log => (v.max(1e-6) / self.low).ln() / (self.high / self.low).ln(),
            Scale::Linear => (v - self.low) / (self.high - self.low),
        }
    }

    /// Returns a tick's label, with as many digits as distinguish it from the next one.
    fn text(&self, tick: f64) -> String {
        let span = self.high - self.low;
        if self.scale == Scale::Log || span > 5.0 || self.high.abs() >= 999.5 {
            return number(tick);
        }
        let digits = (1 - (span / 5.0).log10().floor() as i32).clamp(0, 6) as usize;
        let text = format!("{tick:.digits$}");
        if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').into() } else { text }
    }

    /// Returns about `count` round values within the span.
    fn ticks(&self, count: usize) -> Vec<f64> {
        if self.scale == Scale::Log {
            let decades = (self.high / self.low).log10();
            let steps: &[f64] = if decades < 2.5 { &[1.0, 2.0, 5.0] } else { &[1.0] };
            let first = self.low.log10().floor() as i32;
            let last = self.high.log10().ceil() as i32;
            let all = (first..=last).flat_map(|e| steps.iter().map(move |s| s * 10f64.powi(e)));
            return all.filter(|v| (self.low..=self.high).contains(v)).collect();
        }
        let rough = (self.high - self.low) / count as f64;
        let power = 10f64.powf(rough.log10().floor());
        let step = [1.0, 2.0, 5.0, 10.0].into_iter().map(|m| m * power).find(|s| *s >= rough).unwrap_or(rough);
        let first = (self.low / step).ceil() as i64;
        (first..).map(|i| i as f64 * step).take_while(|v| *v <= self.high).collect()
    }
}

/// Formats a value with about three digits.
pub fn number(v: f64) -> String {
    let a = v.abs();
    let short = |v: f64, unit: &str| {
        let text = if v.abs() < 9.95 { format!("{v:.1}") } else { format!("{v:.0}") };
        format!("{}{unit}", text.trim_end_matches(".0"))
    };
    match a {
        _ if a >= 999_500.0 => short(v / 1e6, "M"),
        _ if a >= 999.5 => short(v / 1e3, "k"),
        _ if a >= 99.5 || v == 0.0 => format!("{v:.0}"),
        _ => {
            let digits = (2 - a.log10().floor() as i32).clamp(1, 6) as usize;
            let text = format!("{v:.digits$}");
            text.trim_end_matches('0').trim_end_matches('.').into()
        }
    }
}

/// Escapes text for HTML.
pub fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_three_digits() {
        let cases = [
            (0.0, "0"),
            (0.05, "0.05"),
            (1.0, "1"),
            (27.136, "27.1"),
            (950.0, "950"),
            (1234.0, "1.2k"),
            (2.5e6, "2.5M"),
        ];
        for (v, text) in cases {
            assert_eq!(number(v), text);
        }
    }

    #[test]
    fn a_single_point_is_a_chart() {
        let axis = Axis { label: "x", scale: Scale::Log };
        let series = Series { name: "a<b".into(), color: 0, stroke: Stroke::Strong, points: vec![(5.0, 1.0)] };
        let html = Chart { title: "t".into(), x: axis.clone(), y: axis, series: vec![series] }.html();
        assert!(!html.contains("NaN") && html.contains("a&lt;b"));
    }
}
