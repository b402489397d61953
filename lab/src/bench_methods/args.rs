//! The command line of `ssplat-lab bench-methods`.

use std::path::PathBuf;

use crate::recipes::Method;
use clap::Args as ClapArgs;

use super::contender::Contender;
use ssplat_cli::args::positive;

const EXAMPLES: &str = "\
Examples:
  ssplat-lab bench-methods kodim*.png --out methods --ratios 20,50 --seeds 0,1,2
  ssplat-lab bench-methods photo.png --out methods --counts 1000 --side 256 --iterations 500
  ssplat-lab bench-methods photo.png --out methods --methods ssplat,lig --iterations published --at-most 5000 --rates 1
  ssplat-lab bench-methods kodim*.png --out methods --ablation --ratios 50 --effort 3

Each method fits the same number of Gaussians: that of the ratio at 7 bytes for each, as SmartSplat's
paper counts. Then each gets a file of as many bytes as the ratio has: those of ssplat and SmartSplat by the encoder, the others
by import of their Gaussians. Writes methods.md, methods.csv and convergence.svg into the folder.";

/// Names of the methods.
const NAMES: [&str; 8] =
    ["ssplat", "smartsplat", "gaussianimage-cholesky", "gaussianimage-rs", "image-gs", "lig", "3dgs", "3dgs-fixed"];

/// Number of iterations of the other methods.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Iterations {
    /// The same for all.
    Each(u32),
    /// The number of the published program.
    Published,
}

impl Iterations {
    fn parse(text: &str) -> Result<Self, String> {
        match (text, text.parse()) {
            ("published", _) => Ok(Iterations::Published),
            (_, Ok(n)) if n > 0 => Ok(Iterations::Each(n)),
            _ => Err("neither a whole number above 0 nor `published`".into()),
        }
    }
}

#[derive(Debug, ClapArgs)]
#[command(after_help = EXAMPLES)]
pub struct BenchMethods {
    /// The pictures, without alpha
    #[arg(required = true)]
    pub images: Vec<PathBuf>,
    /// The folder to write
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Ratios of 8-bit sample bytes to file bytes
    #[arg(long, value_name = "R,...", value_delimiter = ',', value_parser = positive, default_values_t = [20.0, 50.0], conflicts_with = "counts")]
    pub ratios: Vec<f64>,
    /// Numbers of Gaussians instead of ratios; files have 7 bytes per Gaussian
    #[arg(long, value_name = "N,...", value_delimiter = ',')]
    pub counts: Vec<u32>,
    /// Seeds
    #[arg(long, value_name = "N,...", value_delimiter = ',', default_values_t = [0, 1, 2])]
    pub seeds: Vec<u64>,
    /// Iterations of the other methods, or `published` for the number of each method's own program; ssplat and
    /// SmartSplat run as the effort determines
    #[arg(long, value_name = "N|published", default_value = "1000", value_parser = Iterations::parse)]
    pub iterations: Iterations,
    /// Maximum number of iterations, for published numbers that are too large
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub at_most: Option<u32>,
    /// Factors of the other methods' step sizes, which are chosen for ten to fifty times as many iterations
    #[arg(long, value_name = "F,...", value_delimiter = ',', value_parser = positive, default_values_t = [1.0, 10.0])]
    pub rates: Vec<f64>,
    /// Measure only these methods: ssplat, smartsplat, or a name in the table
    #[arg(long, value_name = "NAME,...", value_delimiter = ',', value_parser = NAMES)]
    pub methods: Vec<String>,
    /// Effort of ssplat and SmartSplat
    #[arg(long, value_name = "LEVEL", default_value_t = 5, value_parser = clap::value_parser!(u8).range(1..=9))]
    pub effort: u8,
    /// Measure the ablation from SmartSplat's pipeline to that of ssplat instead; writes ablation.md and ablation.csv
    #[arg(long, conflicts_with_all = ["counts", "iterations", "at_most", "rates", "methods"])]
    pub ablation: bool,
    /// Reduce pictures whose longer side has more pixels
    #[arg(long, value_name = "PIXELS")]
    pub side: Option<u32>,
}

impl BenchMethods {
    /// Returns the number of iterations of one of the other methods.
    pub fn iterations_of(&self, method: Method) -> u32 {
        let asked = match self.iterations {
            Iterations::Each(n) => n,
            Iterations::Published => method.published_iterations(),
        };
        asked.min(self.at_most.unwrap_or(u32::MAX))
    }

    /// Returns the methods in the order of the table.
    pub fn contenders(&self) -> Vec<Contender> {
        let mut all = vec![Contender::Ssplat, Contender::SmartSplat];
        for method in Method::ALL {
            all.extend(self.rates.iter().map(|&rate| Contender::Published { method, rate: rate as f32 }));
        }
        let is_asked = |c: &Contender| self.methods.is_empty() || self.methods.iter().any(|name| name == c.method());
        all.retain(is_asked);
        all
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn iterations_are_each_ones_own_if_asked_but_not_more_than_at_most() {
        use clap::Parser;
        #[derive(Parser)]
        struct Line {
            #[command(flatten)]
            args: BenchMethods,
        }
        let of = |words: &[&str]| {
            let line = ["bench", "a.png", "--out", "o"].iter().chain(words);
            Line::try_parse_from(line).map(|l| [Method::ImageGs, Method::Lig].map(|m| l.args.iterations_of(m)))
        };
        assert_eq!(of(&[]).unwrap(), [1000; 2]);
        assert_eq!(of(&["--iterations", "published"]).unwrap(), [10_000, 30_000]);
        assert_eq!(of(&["--iterations", "published", "--at-most", "20000"]).unwrap(), [10_000, 20_000]);
        assert!(of(&["--iterations", "0"]).is_err() && of(&["--iterations", "many"]).is_err());
    }

    #[test]
    fn every_method_can_be_asked_for_by_its_name() {
        let names: Vec<&str> = [Contender::Ssplat, Contender::SmartSplat].iter().map(|c| c.method()).collect();
        assert_eq!([names, Method::ALL.map(Method::name).to_vec()].concat(), NAMES);
    }
}
