//! Formats the tables of the page as Markdown.

use std::fmt::Write;

use super::chart::number;
use super::left_out;
use super::page::{Contents, figures};

/// Formats the headline, the stiff cases and the savings of the scenes.
pub fn markdown(contents: &Contents) -> String {
    let mut text = format!("# ssplat-lab report\n\nMade by `{}`. {}\n", contents.command, contents.backends());
    headline(contents, &mut text);
    needless(contents, &mut text);
    stability(contents, &mut text);
    text
}

fn headline(contents: &Contents, text: &mut String) {
    let codecs = contents.codecs();
    *text += "\n## At a glance\n\nΔ: our PSNR minus the codec's at the same bytes, – where it has no files around that size.\n\n";
    *text += "| picture | ratio | bytes | PSNR dB | MS-SSIM | SSIMULACRA2 | Butteraugli | encode s | decode ms |";
    codecs.iter().for_each(|c| *text += &format!(" Δ {c} dB |"));
    *text += "\n|---|--:|--:|--:|--:|--:|--:|--:|--:|";
    codecs.iter().for_each(|_| *text += "--:|");
    *text += "\n";
    for (i, subject) in contents.subjects.iter().enumerate() {
        for cell in contents.over_ratios(i) {
            let _ = write!(
                text,
                "| {} | {} | {} | {:.2} | {:.4} | {:.1} | {:.2} | {:.1} | {:.1} |",
                subject.name,
                cell.job.setup.ratio,
                cell.number("bytes"),
                cell.number("psnr"),
                cell.number("ms_ssim"),
                cell.number("ssimulacra2"),
                cell.number("butteraugli"),
                cell.number("seconds"),
                cell.number("decode_ms_full"),
            );
            for codec in &codecs {
                match contents.lead(&subject.name, codec, cell) {
                    Some(lead) => *text += &format!(" {lead:+.2} |"),
                    None => *text += " – |",
                }
            }
            *text += "\n";
        }
    }
}

fn needless(contents: &Contents, text: &mut String) {
    let _ = write!(
        text,
        "\n## What a scene leaves out\n\nWith everything → with what the scene needs; {}.\n\n\
         | scene | left out | bytes | seconds | PSNR dB |\n|---|---|--:|--:|--:|\n",
        left_out::settings()
    );
    let common = left_out::common(contents.left_out);
    for n in contents.left_out {
        let _ = writeln!(
            text,
            "| {} | {} | {} → {} | {:.2} → {:.2} | {:.2} → {:.2} |",
            n.scene,
            n.own(&common),
            n.bytes[0],
            n.bytes[1],
            n.seconds[0],
            n.seconds[1],
            n.psnr[0],
            n.psnr[1],
        );
    }
    if !common.is_empty() {
        let _ = writeln!(text, "\nAll of them leave out: {}.", common.join("; "));
    }
}

fn stability(contents: &Contents, text: &mut String) {
    let failed = contents.stability.iter().filter(|r| !r.holds()).count();
    let _ = writeln!(
        text,
        "\n## Stiff and extreme cases\n\n{} cases, {} beyond their bounds.\n\n| kind | case | worst | bound | | what guards it |\n|---|---|--:|--:|---|---|",
        number(contents.stability.len() as f64),
        failed,
    );
    for row in contents.stability {
        let (worst, bound) = figures(row);
        let mark = if row.holds() { "✓" } else { "✗" };
        let _ = writeln!(text, "| {} | {} | {worst} | {bound} | {mark} | {} |", row.group, row.case, row.guard);
    }
}
