//! The command line.

use std::num::NonZeroUsize;
use std::path::PathBuf;

use clap::{Args as ClapArgs, Parser, Subcommand};

/// Pictures stored as 2D Gaussians.
#[derive(Debug, Parser)]
#[command(name = "ssplat", version, max_term_width = 100, after_help = EXIT_STATUS)]
pub struct Args {
    #[command(subcommand)]
    pub command: Command,
    /// Threads to work with; the result does not depend on it [default: one a core]
    #[arg(long, global = true, value_name = "N")]
    pub threads: Option<NonZeroUsize>,
}

const EXIT_STATUS: &str = "\
Exit status: 0 success, 2 wrong usage, 3 reading or writing failed, 4 broken file,
5 unsupported format or version, 6 file beyond the limits, 1 anything else. On
failure no output file is left behind.";

#[derive(Debug, Subcommand)]
pub enum Command {
    /// Draw a .ssplat file as PNG, PNM or another format
    Decode(Decode),
    /// Say what a .ssplat file holds
    Info(Info),
    /// Measure how far two pictures are apart
    Compare(Compare),
}

const DECODE_EXAMPLES: &str = "\
Examples:
  ssplat decode photo.ssplat photo.png
  ssplat decode photo.ssplat thumbnail.png --width 256
  ssplat decode photo.ssplat detail.png --region 1000,800,512,512 --scale 2
  ssplat decode photo.ssplat - --format ppm | pnmtojpeg > photo.jpg
  ssplat decode cut-off.ssplat coarse.png --partial

PNG and PNM are written band by band, in little memory whatever the picture's size.";

#[derive(Debug, ClapArgs)]
#[command(after_help = DECODE_EXAMPLES)]
pub struct Decode {
    /// The .ssplat file; - for standard input
    pub input: PathBuf,
    /// The picture to write, in the format of its extension; - for standard output
    pub output: PathBuf,
    /// Output format, as an extension [default: that of OUTPUT, or png on standard output]
    #[arg(long, value_name = "EXT")]
    pub format: Option<String>,
    /// Draw only this part: left, top, width and height in pixels of the picture
    #[arg(long, value_name = "X,Y,W,H", value_parser = region)]
    pub region: Option<[u32; 4]>,
    /// Output width, pixels; alone it keeps the aspect ratio
    #[arg(long, value_name = "PIXELS", value_parser = clap::value_parser!(u32).range(1..=1 << 20), conflicts_with = "scale")]
    pub width: Option<u32>,
    /// Output height, pixels; alone it keeps the aspect ratio
    #[arg(long, value_name = "PIXELS", value_parser = clap::value_parser!(u32).range(1..=1 << 20), conflicts_with = "scale")]
    pub height: Option<u32>,
    /// Output pixels per pixel of the picture
    #[arg(long, value_name = "FACTOR", value_parser = positive)]
    pub scale: Option<f64>,
    /// Draw what is intact of a truncated or damaged file, and say what is missing
    #[arg(long)]
    pub partial: bool,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}

const INFO_EXAMPLES: &str = "\
Examples:
  ssplat info photo.ssplat
  ssplat info photo.ssplat --json";

#[derive(Debug, ClapArgs)]
#[command(after_help = INFO_EXAMPLES)]
pub struct Info {
    /// The .ssplat file; - for standard input
    pub input: PathBuf,
    /// Print as JSON
    #[arg(long)]
    pub json: bool,
}

const COMPARE_EXAMPLES: &str = "\
Examples:
  ssplat compare photo.png photo.ssplat
  ssplat compare photo.png photo.webp --json

Where one picture has colour or alpha and the other has not, grey is taken as equal
red, green and blue, and missing alpha as opaque; where depths differ, both are taken
with 16 bits. JSON keys: psnr in dB (99 at most), ssim, ms_ssim (null where a side is
under 11 or 161 pixels, too small for them).";

#[derive(Debug, ClapArgs)]
#[command(after_help = COMPARE_EXAMPLES)]
pub struct Compare {
    /// The original: any picture, or a .ssplat file
    pub reference: PathBuf,
    /// What became of it: any picture, or a .ssplat file
    pub test: PathBuf,
    /// Print as JSON
    #[arg(long)]
    pub json: bool,
}

fn positive(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(v) if v > 0.0 && f64::is_finite(v) => Ok(v),
        _ => Err("not a positive number".into()),
    }
}

fn region(text: &str) -> Result<[u32; 4], String> {
    let numbers: Result<Vec<u32>, _> = text.split(',').map(|n| n.trim().parse()).collect();
    let region = numbers.ok().and_then(|n| <[u32; 4]>::try_from(n).ok()).ok_or("not four whole numbers X,Y,W,H")?;
    if region[2] == 0 || region[3] == 0 {
        return Err("the region is empty".into());
    }
    Ok(region)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arguments_are_consistent() {
        use clap::CommandFactory;
        Args::command().debug_assert();
    }
}
