//! The command line of `ssplat-lab report`.

use std::path::PathBuf;

use clap::Args as ClapArgs;
use ssplat::Backend;

use ssplat_cli::args::positive;
use ssplat_cli::names;

const REPORT_EXAMPLES: &str = "\
Examples:
  ssplat-lab report photo.png --out report                    efforts, recipes, stability: minutes
  ssplat-lab report *.png --out report --ratios 20,50,200,1000 --efforts 1,3,5,7,9
  ssplat-lab report *.png --out report --anchors anchors.csv --codecs none

Writes index.html, tables.md, results.csv, results.json and anchors.csv into the folder. What is
done is kept in its folder cells: started again, the command goes on where it stopped.
The CSV of anchors has the columns image, codec, bytes, psnr, msssim, ssim, enc_s,
dec_s, setting, and may have ssimulacra2 and butteraugli.";

#[derive(Debug, ClapArgs)]
#[command(after_help = REPORT_EXAMPLES)]
pub struct Report {
    /// The pictures
    #[arg(required = true)]
    pub images: Vec<PathBuf>,
    /// The folder to write
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Ratios of 8-bit sample bytes to file bytes; efforts and recipes are compared at the middle one
    #[arg(long, value_name = "R,...", value_delimiter = ',', value_parser = positive, default_value = "20,50,200")]
    pub ratios: Vec<f64>,
    /// Efforts; ratios and recipes are compared at the middle one
    #[arg(long, value_name = "N,...", value_delimiter = ',', value_parser = clap::value_parser!(u8).range(1..=9), default_value = "3,5,7")]
    pub efforts: Vec<u8>,
    /// Recipes to compare with that of ssplat
    #[arg(long, value_enum, default_value_t = Recipes::All)]
    pub recipes: Recipes,
    /// Number of pictures, from the first on, for which SmartSplat runs; its fits take by far the longest [default:
    /// all]
    #[arg(long, value_name = "N")]
    pub smartsplat_images: Option<usize>,
    /// Backends to compare with the default one [default: cpu,gpu if there is a GPU, none otherwise]
    #[arg(long, value_name = "NAME,...", value_delimiter = ',', value_parser = names::backend())]
    pub backends: Vec<Backend>,
    /// Results of other codecs
    #[arg(long, value_name = "CSV")]
    pub anchors: Option<PathBuf>,
    /// Other codecs to run: those of cjpeg, cwebp, avifenc and cjxl that are installed, or none
    #[arg(long, value_enum, default_value_t = Codecs::Installed)]
    pub codecs: Codecs,
    /// Table of stiff cases, as the tests print it
    #[arg(long, value_name = "FILE")]
    pub stability: Option<PathBuf>,
}

/// Recipes of a report.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Recipes {
    /// Both blends, and SmartSplat with its ablation
    All,
    /// Only our own, with both blends
    Own,
}

/// Codecs that a report runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Codecs {
    Installed,
    None,
}
