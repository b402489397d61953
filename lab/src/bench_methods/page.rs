//! Formats the results as a table of means and spreads, and as CSV rows.

use std::fmt::Write;
use std::path::Path;

use super::args::BenchMethods;
use super::{Cell, Contender, Measured};

/// The names of a row's columns.
pub const HEAD: &str = "picture,gaussians,method,seed,iterations,published_iterations,float_psnr,ms_ssim,seconds,file_bytes,file_psnr,file_ms_ssim,counted_bytes,coded_bytes,counted_psnr,problem";

/// Formats one fit as a line without a line break.
pub fn row(cell: &Cell) -> String {
    let number = |v: Option<f64>, digits: usize| v.map_or(String::new(), |v| format!("{v:.digits$}"));
    let whole = |v: Option<u64>| v.map_or(String::new(), |v| v.to_string());
    let m = &cell.measured;
    let iterations = match cell.contender {
        Contender::Published { method, .. } => {
            format!("{},{}", m.iterations.map_or(String::new(), |n| n.to_string()), method.published_iterations())
        }
        Contender::Ssplat | Contender::SmartSplat => format!("effort {},", cell.setup.effort),
    };
    format!(
        "{},{},{},{},{iterations},{},{},{:.2},{},{},{},{},{},{},{}",
        cell.picture,
        cell.setup.count,
        // Commas separate the columns.
        cell.contender.name().replace(',', ""),
        cell.setup.seed,
        number(m.float_psnr, 3),
        number(m.ms_ssim, 5),
        m.seconds,
        whole(m.bytes),
        number(m.file_psnr, 3),
        number(m.file_ms_ssim, 5),
        whole(m.counted.map(|c| c.bytes)),
        whole(m.counted.and_then(|c| c.coded)),
        number(m.counted.map(|c| c.psnr), 3),
        m.problem.as_deref().unwrap_or("").replace(',', ";"),
    )
}

/// Returns the command that produced the page, without the folders of its files.
pub fn command(arguments: impl Iterator<Item = String>) -> String {
    let plain = |argument: String| match Path::new(&argument).file_name().and_then(|n| n.to_str()) {
        Some(name) if argument.contains(std::path::MAIN_SEPARATOR) => name.to_owned(),
        _ => argument,
    };
    arguments.map(plain).collect::<Vec<_>>().join(" ")
}

/// Returns the page.
pub fn markdown(cells: &[Cell], args: &BenchMethods, sides: &[String]) -> String {
    let mut out = format!("# Methods side by side\n\n```sh\n{}\n```\n\n", command(std::env::args()));
    let joined = |v: &[String]| v.join(", ");
    let seeds: Vec<String> = args.seeds.iter().map(u64::to_string).collect();
    let _ = writeln!(
        out,
        "Pictures: {}.\n\
         Seeds {}: means, and after ± half the distance between the smallest and the largest value.\n\
         \n\
         - **Iterations.** For the other methods, which run on the CPU, the table shows the iterations that were run and those\n\
         \x20\x20that are published. LIG runs this number on each level, and GaussianImage runs the same number again in its second\n\
         \x20\x20stage, which is not included in the times. ssplat and SmartSplat run at effort {}.\n\
         - **Float PSNR and float MS-SSIM** are those of the method's own picture before quantization. The encoder of ssplat\n\
         \x20\x20does not keep such a picture, only its PSNR.\n\
         - **Files** have at most the number of bytes in the heading. Those of ssplat and SmartSplat come from the encoder,\n\
         \x20\x20with as many Gaussians as it finds best. Those of the other methods come from importing the Gaussians of the row, at\n\
         \x20\x20the finest precision that fits.\n\
         - ***est.*** marks an estimate, not a file: rounded values at the entropy of their codes, rendered by the method.\n\
         - **Own count** is the number of bytes that the method's own program counts for its rounded values, and the PSNR of\n\
         \x20\x20the picture that it renders from them. No file is written for it either. *Coded* stores GaussianImage's codes with\n\
         \x20\x20an entropy coder and its tables. The program of GaussianImage can do this, but its published sizes do not.\n\
         \n\
         `methods.csv` has every fit.\n",
        joined(sides),
        joined(&seeds),
        args.effort
    );
    let mut rest = cells;
    let mut heading = None;
    while let Some(first) = rest.first() {
        let is_same = |c: &Cell| {
            c.picture == first.picture && c.setup.count == first.setup.count && c.contender == first.contender
        };
        let end = rest.iter().position(|c| !is_same(c)).unwrap_or(rest.len());
        let (group, others) = rest.split_at(end);
        rest = others;
        let of = (first.picture.clone(), first.setup.count);
        if heading.as_ref() != Some(&of) {
            let _ = writeln!(
                out,
                "\n## {}, {} Gaussians, files of {} bytes\n\n\
                 | method | iterations | float PSNR, dB | float MS-SSIM | fit, s | file PSNR, dB | file MS-SSIM | own count: bytes | own count: PSNR, dB | failures |\n\
                 |---|---|---|---|---|---|---|---|---|---|",
                first.picture, first.setup.count, first.setup.bytes
            );
            heading = Some(of);
        }
        let column = |digits: usize, value: &dyn Fn(&Measured) -> Option<f64>| {
            let values: Vec<f64> = group.iter().filter_map(|c| value(&c.measured)).collect();
            summary(&values, digits)
        };
        let problems: Vec<String> = group
            .iter()
            .filter_map(|c| Some(format!("seed {}: {}", c.setup.seed, c.measured.problem.as_ref()?)))
            .collect();
        let _ = writeln!(
            out,
            "| {} | {} | {} | {} | {} | {}{} | {} | {} | {} | {} |",
            first.contender.name(),
            iterations(group),
            column(2, &|m| m.float_psnr),
            column(4, &|m| m.ms_ssim),
            column(1, &|m| Some(m.seconds)),
            column(2, &|m| m.file_psnr),
            if first.contender.is_estimated() && first.measured.file_psnr.is_some() { " *est.*" } else { "" },
            column(4, &|m| m.file_ms_ssim),
            own_count(group),
            column(2, &|m| m.counted.map(|c| c.psnr)),
            if problems.is_empty() { "none".into() } else { problems.join("; ") }
        );
    }
    out + "\n![PSNR along the seconds of the fits](convergence.svg)\n"
}

/// Formats the size by the method's own count, and with an entropy coder if its program has one.
fn own_count(group: &[Cell]) -> String {
    let counted = || group.iter().filter_map(|c| c.measured.counted);
    let Some(first) = counted().next() else { return "—".into() };
    let coded: Vec<f64> = counted().filter_map(|c| Some(c.coded? as f64)).collect();
    if coded.is_empty() { first.bytes.to_string() } else { format!("{}; coded {}", first.bytes, summary(&coded, 0)) }
}

/// Formats the iterations of a method with several seeds, and the published number.
fn iterations(group: &[Cell]) -> String {
    let Some(method) = group.first().and_then(|c| c.contender.published_as()) else { return "—".into() };
    let ran = || group.iter().filter_map(|c| c.measured.iterations);
    let ran = match (ran().min(), ran().max()) {
        (Some(least), Some(most)) if least < most => format!("{least} to {most}"),
        (Some(all), _) => all.to_string(),
        (None, _) => "none".into(),
    };
    format!("{ran} of {}", method.published_iterations())
}

/// Returns half the range of the values; 0 if there are none.
pub fn half_spread(values: &[f64]) -> f64 {
    let range = values.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |r, &v| [r[0].min(v), r[1].max(v)]);
    (0.5 * (range[1] - range[0])).max(0.0)
}

/// Formats the mean and half the range.
fn summary(values: &[f64], digits: usize) -> String {
    if values.is_empty() {
        return "—".into();
    }
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    if !mean.is_finite() {
        return "not a number".into();
    }
    if values.len() == 1 {
        format!("{mean:.digits$}")
    } else {
        format!("{mean:.digits$} ± {:.digits$}", half_spread(values))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_names_no_folders() {
        let arguments = ["/home/me/bin/ssplat-lab", "bench-methods", "a/b/kodim05.png", "--ratios", "20,50"];
        let arguments = arguments.map(|a| a.replace('/', std::path::MAIN_SEPARATOR_STR));
        assert_eq!(command(arguments.into_iter()), "ssplat-lab bench-methods kodim05.png --ratios 20,50");
    }

    #[test]
    fn what_is_missing_or_no_number_is_said() {
        assert_eq!(summary(&[], 2), "—");
        assert_eq!(summary(&[30.0, 30.5, 31.0], 2), "30.50 ± 0.50");
        assert_eq!(summary(&[30.0, f64::NAN], 2), "not a number");
        assert_eq!(summary(&[2.25], 1), "2.2");
    }
}
