//! Plots PSNR over the seconds of each method's first fit of the first picture, as a self-contained SVG.

use std::fmt::Write;

use super::Cell;

const WIDTH: f64 = 640.0;
const HEIGHT: f64 = 400.0;
/// Left, right, top, bottom.
const MARGIN: [f64; 4] = [48.0, 210.0, 16.0, 44.0];
const COLORS: [&str; 12] = [
    "#d62728", "#1f77b4", "#2ca02c", "#98df8a", "#ff7f0e", "#ffbb78", "#9467bd", "#c5b0d5", "#8c564b", "#c49c94",
    "#17becf", "#9edae5",
];

/// Returns the plot.
pub fn svg(cells: &[Cell]) -> String {
    let Some(first) = cells.first() else { return String::new() };
    let same =
        |c: &&Cell| (&c.picture, c.setup.count, c.setup.seed) == (&first.picture, first.setup.count, first.setup.seed);
    let lines: Vec<(String, Vec<(f64, f64)>)> = cells
        .iter()
        .filter(same)
        .map(|c| {
            let shown = |p: &&(f64, f64)| p.0 > 0.0 && p.1.is_finite();
            (c.contender.name(), c.measured.trace.iter().filter(shown).copied().collect())
        })
        .collect();
    let all = || lines.iter().flat_map(|l| l.1.iter().copied());
    let span = |values: &mut dyn Iterator<Item = f64>| {
        values.fold([f64::INFINITY, f64::NEG_INFINITY], |r, v| [r[0].min(v), r[1].max(v)])
    };
    let [x0, x1] = span(&mut all().map(|p| p.0.log10())).map(|v| v.clamp(-3.0, 6.0));
    let [y0, y1] = span(&mut all().map(|p| p.1)).map(|v| v.clamp(0.0, 100.0));
    let x = |v: f64| MARGIN[0] + (v.log10() - x0) / (x1 - x0).max(1e-9) * (WIDTH - MARGIN[0] - MARGIN[1]);
    let y = |v: f64| HEIGHT - MARGIN[3] - (v - y0) / (y1 - y0).max(1e-9) * (HEIGHT - MARGIN[2] - MARGIN[3]);
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" font-family=\"sans-serif\" font-size=\"12\">\n\
         <rect width=\"{WIDTH}\" height=\"{HEIGHT}\" fill=\"white\"/>\n"
    );
    let (left, right, bottom) = (MARGIN[0], WIDTH - MARGIN[1], HEIGHT - MARGIN[3]);
    let mut tick = (y0 / 2.0).ceil() * 2.0;
    while tick <= y1 {
        let at = y(tick);
        let _ = writeln!(
            out,
            "<path d=\"M{left} {at:.1}H{right}\" stroke=\"#ddd\"/><text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{tick}</text>",
            left - 6.0,
            at + 4.0
        );
        tick += 2.0;
    }
    for power in x0.ceil() as i32..=x1.floor() as i32 {
        let v = 10f64.powi(power);
        let _ = writeln!(
            out,
            "<path d=\"M{0:.1} {1}V{bottom}\" stroke=\"#ddd\"/><text x=\"{0:.1}\" y=\"{2}\" text-anchor=\"middle\">{v}</text>",
            x(v),
            MARGIN[2],
            bottom + 16.0
        );
    }
    let _ = writeln!(
        out,
        "<text x=\"{left}\" y=\"{}\">seconds of the fit; PSNR in dB; {}, {} Gaussians</text>",
        HEIGHT - 8.0,
        first.picture,
        first.setup.count
    );
    for (i, (name, points)) in lines.iter().enumerate() {
        let color = COLORS[i % COLORS.len()];
        let path: Vec<String> = points.iter().map(|p| format!("{:.1},{:.1}", x(p.0), y(p.1))).collect();
        let (at, from) = (MARGIN[2] + 8.0 + 18.0 * i as f64, right + 10.0);
        let _ = writeln!(
            out,
            "<polyline points=\"{}\" fill=\"none\" stroke=\"{color}\" stroke-width=\"2\"/>\n\
             <path d=\"M{from} {at}h16\" stroke=\"{color}\" stroke-width=\"2\"/><text x=\"{}\" y=\"{}\">{name}</text>",
            path.join(" "),
            from + 20.0,
            at + 4.0
        );
    }
    out + "</svg>\n"
}
