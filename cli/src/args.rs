//! The command line.

use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::{Args as ClapArgs, Parser, Subcommand};
use ssplat::unstable::EncodeOptions;
use ssplat::unstable::Recipe;
use ssplat::unstable::bitstream::splats::Layout;
use ssplat::{Backend, Blend, Detail, HiddenColors, Layers, MetadataPolicy, Target, Thumbnail, Tune};

use crate::exchange::format::{ExportFormat, ImportFormat};
use crate::exchange::{csv, foreign};
use crate::failure::Failure;
use crate::names;

/// Pictures stored as 2D Gaussians.
#[derive(Debug, Parser)]
#[command(name = "ssplat", version = VERSION, max_term_width = 100, after_help = EXIT_STATUS)]
pub struct Args {
    #[command(subcommand)]
    pub command: Command,
    /// Threads to work with; the result does not depend on it [default: one a core]
    #[arg(long, global = true, value_name = "N", value_parser = count)]
    pub threads: Option<NonZeroUsize>,
}

/// The version, and what was built in.
const VERSION: &str =
    if cfg!(feature = "gpu") { concat!(env!("CARGO_PKG_VERSION"), " (with GPU)") } else { env!("CARGO_PKG_VERSION") };

const EXIT_STATUS: &str = "\
Exit status: 0 success, 2 wrong usage, 3 reading or writing failed, 4 broken file,
5 unsupported format or version, 6 file beyond the limits, 1 anything else. On
failure no output file is left behind. Of several inputs the status is that of all
failures, or 1 where they differ.";

#[derive(Debug, Subcommand)]
pub enum Command {
    /// Fit a picture and write it as .ssplat
    Encode(Box<Encode>),
    /// Draw a .ssplat file as PNG, PNM or another format
    Decode(Decode),
    /// Say what a .ssplat file holds
    Info(Info),
    /// Measure how far two pictures are apart
    Compare(Compare),
    /// Print a picture as the text of a small .ssplat file, to stand in a web page until the picture is there
    Placeholder(Placeholder),
    /// Show a .ssplat file in the browser, at any zoom, and where its bits go
    View(View),
    /// Write a .ssplat file's Gaussians for other programs
    Export(Export),
    /// Store Gaussians that were fitted elsewhere
    Import(Import),
    /// Print completions for a shell
    Completions(Completions),
    /// List the formats that are read and written
    Formats,
    /// Print the manual page
    Man,
}

const ENCODE_USAGE: &str = "\
ssplat encode [OPTIONS] <INPUT> <OUTPUT>
       ssplat encode [OPTIONS] <INPUT>... --out-dir <DIR>";

const DECODE_USAGE: &str = "\
ssplat decode [OPTIONS] <INPUT> <OUTPUT>
       ssplat decode [OPTIONS] <INPUT>... --out-dir <DIR>";

const ENCODE_EXAMPLES: &str = "\
Examples:
  ssplat encode photo.jpg photo.ssplat                        at the default ratio of 50
  ssplat encode photo.png photo.ssplat --bytes 300            a placeholder
  ssplat encode photo.png photo.ssplat --ratio 200 --effort 9
  ssplat encode photo.png photo.ssplat --preview result.png   also decode and measure
  ssplat encode *.jpg scans --recursive --out-dir small --skip-existing
  cat photo.png | ssplat encode - - > photo.ssplat

With --out-dir all paths are inputs, folders too: small pictures are encoded side by side,
one that fails does not stop the others, and with --skip-existing a second run goes on where
the first stopped. anim.gif becomes anim.ssplat, but anim.gif.ssplat where there is anim.webp, too.

An orientation is carried along, unless --auto-orient applies it. Samples in 32-bit floats are
clamped to 0..1 and kept with 16 bits. What of the input is lost (most of an EXIF block, XMP, further
frames) is told on standard error.

With no size asked for, the ratio is 50, but the primitives get 80 bytes at least, and metadata come
on top: no picture is too small. A size that is asked for is kept or refused.";

#[derive(Debug, ClapArgs)]
#[command(after_help = ENCODE_EXAMPLES, override_usage = ENCODE_USAGE)]
pub struct Encode {
    /// The picture, in any format known by its content, and the .ssplat file to write; - for standard input or output
    #[arg(required = true, value_name = "PATH")]
    pub paths: Vec<PathBuf>,
    /// The file to write, as a second path would name it
    #[arg(long, short, value_name = "FILE", conflicts_with = "out_dir")]
    pub output: Option<PathBuf>,
    #[command(flatten)]
    pub many: Many,
    #[command(flatten)]
    pub target: TargetArgs,
    /// Take what is there of a JPEG or GIF that was cut off
    #[arg(long)]
    pub partial: bool,
    /// Turn the picture as its EXIF block says
    #[arg(long)]
    pub auto_orient: bool,
    /// Choose which of the input's metadata the file carries, within its size: needed (ICC profile and orientation),
    /// all (the whole EXIF block too, with time and place), icc, or none
    #[arg(help_heading = "What the file has, and how it is made", long, value_name = "WHICH", default_value = "needed", hide_possible_values = true, value_parser = names::carry())]
    pub metadata: MetadataPolicy,
    /// Write the file even under the extension of another format
    #[arg(long)]
    pub force: bool,
    /// Say nothing but errors
    #[arg(long, short)]
    pub quiet: bool,
    /// How much work to spend, 1 to 9
    #[arg(long, short, value_name = "LEVEL", default_value_t = 5, value_parser = clap::value_parser!(u8).range(1..=9))]
    pub effort: u8,
    /// Wall-clock budget for the whole command; the best state reached is written
    #[arg(long, value_name = "SECONDS", value_parser = seconds)]
    pub time: Option<Duration>,
    /// Seed of everything random
    #[arg(help_heading = "Research", long, value_name = "N", default_value_t = 0)]
    pub seed: u64,
    /// How the file is laid out
    #[arg(help_heading = "Research", long, default_value = "coded", value_parser = names::layout())]
    pub layout: Layout,
    /// How primitives blend [default: as the recipe has it]
    #[arg(help_heading = "Research", long, value_parser = names::blend())]
    pub blend: Option<Blend>,
    /// The fitting recipe; the last four are the SmartSplat paper's and its ablation
    #[arg(help_heading = "Research", long, default_value = "ssplat", value_parser = names::recipe())]
    pub recipe: Recipe,
    /// Which measure to favour: squared error, structure, or what eyes see [default: iq; psnr with --psnr and for the paper's
    /// recipes]
    #[arg(help_heading = "Research", long, value_parser = names::tune())]
    pub tune: Option<Tune>,
    /// Keep the colours of transparent pixels; by default they continue the visible ones, which takes fewer bytes
    #[arg(help_heading = "What the file has, and how it is made", long)]
    pub keep_hidden: bool,
    /// Whether the file has a detail layer, a transform of what the Gaussians leave: auto (where it pays), off, or the share of
    /// the bytes that the Gaussians get, above 0 and below 1
    #[arg(long, value_name = "WHICH", default_value = "auto", value_parser = detail)]
    pub detail: Detail,
    /// Progressive levels, each 1 to 2 % of the bytes: a file cut after one decodes with --partial
    #[arg(help_heading = "What the file has, and how it is made", long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u8).range(1..=8))]
    pub levels: u8,
    /// Whether the file carries a small version of the picture, within its size: auto, none, or the most bytes that it may
    /// take; auto is for files of 100 kB and more, a hundredth of them, at most 4 kB
    #[arg(help_heading = "What the file has, and how it is made", long, value_name = "WHICH", default_value = "auto", value_parser = thumbnail)]
    pub thumbnail: Thumbnail,
    /// Fit the picture in tiles of so many pixels a side, in memory that does not grow with it: a multiple of 128, 2048 where
    /// none is given [default: above 33 megapixels, but with a GPU only above 268]
    #[arg(help_heading = "What the file has, and how it is made", long, value_name = "SIDE", num_args = 0..=1, require_equals = true, default_missing_value = "2048")]
    pub tiles: Option<u32>,
    /// Which device fits
    #[arg(help_heading = "What the file has, and how it is made", long, default_value = "auto", value_parser = names::backend())]
    pub backend: Backend,
    /// Also decode the file, write the pixels here, and measure them
    #[arg(long, value_name = "PNG", conflicts_with = "out_dir")]
    pub preview: Option<PathBuf>,
    /// Say where the time and the bytes went
    #[arg(help_heading = "Research", long)]
    pub explain: bool,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}

/// Treatment of outputs that exist already, when there are several inputs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Existing {
    Refuse,
    Skip,
    Replace,
}

/// How several inputs are treated.
#[derive(Debug, ClapArgs)]
pub struct Many {
    /// Write into this folder: every path is an input, a folder stands for its files
    #[arg(help_heading = "Several files", long, short = 'd', value_name = "DIR")]
    pub out_dir: Option<PathBuf>,
    /// Also take the folders in folders
    #[arg(help_heading = "Several files", long, requires = "out_dir")]
    pub recursive: bool,
    /// How many small pictures to work on at a time [default: one a thread]
    #[arg(help_heading = "Several files", long, value_name = "N", requires = "out_dir", value_parser = count)]
    pub jobs: Option<NonZeroUsize>,
    /// Pass over inputs whose output is there
    #[arg(help_heading = "Several files", long, requires = "out_dir", conflicts_with = "overwrite")]
    pub skip_existing: bool,
    /// Replace outputs that are there
    #[arg(help_heading = "Several files", long, requires = "out_dir")]
    pub overwrite: bool,
    /// Add a line of JSON for each file to this one
    #[arg(help_heading = "Several files", long, value_name = "JSONL", requires = "out_dir")]
    pub manifest: Option<PathBuf>,
}

impl Many {
    pub fn existing(&self) -> Existing {
        match (self.skip_existing, self.overwrite) {
            (true, _) => Existing::Skip,
            (_, true) => Existing::Replace,
            _ => Existing::Refuse,
        }
    }
}

/// The input and the output where there is one of each.
pub fn pair<'a>(paths: &'a [PathBuf], output: Option<&'a Path>) -> Result<(&'a Path, &'a Path), Failure> {
    match (paths, output) {
        ([input], Some(output)) => Ok((input, output)),
        ([input, output], None) => Ok((input, output)),
        ([input], None) => Err(Failure::usage(format!("{}: where to? name an output, or --out-dir", input.display()))),
        _ => Err(Failure::usage(format!("{} paths: several inputs need --out-dir", paths.len()))),
    }
}

/// Target of an encode: at most one of these.
#[derive(Debug, ClapArgs)]
#[group(multiple = false)]
pub struct TargetArgs {
    /// Width x height x channels bytes over file bytes [default: 50, with 80 bytes at least for the primitives]
    #[arg(help_heading = "Size or quality, at most one", long, short, value_name = "R", value_parser = positive)]
    pub ratio: Option<f64>,
    /// File size, bytes, or as 20k or 1.5M; never exceeded
    #[arg(help_heading = "Size or quality, at most one", long, short, value_name = "N", value_parser = bytes)]
    pub bytes: Option<u64>,
    /// Number of primitives
    #[arg(help_heading = "Size or quality, at most one", long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub primitives: Option<u32>,
    /// Quality as eyes see it, as SSIMULACRA2 measures it: 30 low, 50 medium, 70 high (hard to tell from the original side by
    /// side), 90 very high (hard to tell even when flipping between them); within half a point, by up to six tries
    #[arg(help_heading = "Size or quality, at most one", long, short = 'Q', value_name = "POINTS", value_parser = points)]
    pub quality: Option<f64>,
    /// The smallest file that reaches this PSNR
    #[arg(help_heading = "Size or quality, at most one", long, value_name = "DB", value_parser = positive)]
    pub psnr: Option<f64>,
}

impl Encode {
    /// The library's options for these arguments.
    pub fn options(&self) -> EncodeOptions {
        let mut o = EncodeOptions::default();
        let t = &self.target;
        let targets = [
            t.ratio.map(Target::Ratio),
            t.bytes.map(Target::Bytes),
            t.primitives.map(Target::Primitives),
            t.psnr.map(Target::Psnr),
            t.quality.map(Target::Quality),
        ];
        o.target = targets.into_iter().flatten().next().unwrap_or(o.target);
        o.effort = self.effort;
        o.time = self.time;
        o.seed = self.seed;
        o.layout = self.layout;
        o.blend = self.blend;
        o.recipe = self.recipe;
        o.tune = self.tune;
        (o.detail, o.levels, o.tiles) = (self.detail, self.levels, self.tiles);
        o.hidden = if self.keep_hidden { HiddenColors::Keep } else { HiddenColors::Continue };
        o.thumbnail = self.thumbnail;
        o.backend = self.backend;
        o.metadata = self.metadata;
        o
    }
}

const DECODE_EXAMPLES: &str = "\
Examples:
  ssplat decode photo.ssplat photo.png
  ssplat decode photo.ssplat thumbnail.png --thumbnail 256    from what the file carries for that
  ssplat decode photo.ssplat smaller.png --width 1000
  ssplat decode photo.ssplat detail.png --region 1000,800,512,512 --scale 2
  ssplat decode photo.ssplat - --format ppm | pnmtojpeg > photo.jpg
  ssplat decode cut-off.ssplat coarse.png --partial
  ssplat decode small --out-dir large --format jpg

PNG and PNM are written band by band, in little memory whatever the picture's size.";

#[derive(Debug, ClapArgs)]
#[command(after_help = DECODE_EXAMPLES, override_usage = DECODE_USAGE)]
pub struct Decode {
    /// The .ssplat file, and the picture to write, in the format of its extension; - for standard input or output
    #[arg(required = true, value_name = "PATH")]
    pub paths: Vec<PathBuf>,
    #[command(flatten)]
    pub many: Many,
    /// The file to write, as a second path would name it
    #[arg(long, short, value_name = "FILE", conflicts_with = "out_dir")]
    pub output: Option<PathBuf>,
    /// Output format, as an extension [default: that of OUTPUT, or png on standard output and in a folder]
    #[arg(long, value_name = "EXT")]
    pub format: Option<String>,
    /// Lay pictures with alpha over this colour, as six hexadecimal digits [default: ffffff for JPEG, else none]
    #[arg(long, value_name = "RRGGBB", value_parser = color)]
    pub background: Option<[u8; 3]>,
    /// Turn the picture as its EXIF block says
    #[arg(long)]
    pub auto_orient: bool,
    /// Say nothing but errors
    #[arg(long, short)]
    pub quiet: bool,
    /// Draw only this part: left, top, width and height in pixels of the picture
    #[arg(long, value_name = "X,Y,W,H", value_parser = region)]
    pub region: Option<[u32; 4]>,
    /// Output width, pixels; alone it keeps the aspect ratio
    #[arg(long, value_name = "PIXELS", value_parser = clap::value_parser!(u32).range(1..=1 << 20), conflicts_with = "scale")]
    pub width: Option<u32>,
    /// Output height, pixels; alone it keeps the aspect ratio
    #[arg(long, value_name = "PIXELS", value_parser = clap::value_parser!(u32).range(1..=1 << 20), conflicts_with = "scale")]
    pub height: Option<u32>,
    /// Draw the picture as it fits into a square of so many pixels, from the thumbnail that the file carries where that is
    /// large enough: at once, and less exactly
    #[arg(long, value_name = "PIXELS", value_parser = clap::value_parser!(u32).range(1..=1 << 20), conflicts_with_all = ["region", "width", "height", "scale", "backend", "partial", "layers"])]
    pub thumbnail: Option<u32>,
    /// Output pixels per pixel of the picture; below 1 the picture is low-passed
    #[arg(long, value_name = "FACTOR", value_parser = positive)]
    pub scale: Option<f64>,
    /// Choose the layers to draw: both, the Gaussians alone, or the detail layer alone, on grey
    #[arg(long, value_name = "WHICH", default_value = "both", value_parser = names::layers())]
    pub layers: Layers,
    /// Which device draws; a file from a stranger is best drawn on the CPU
    #[arg(long, default_value = "cpu", value_parser = names::drawing_backend())]
    pub backend: Backend,
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
  ssplat info photo.ssplat --json
  ssplat info small/*.ssplat";

#[derive(Debug, ClapArgs)]
#[command(after_help = INFO_EXAMPLES)]
pub struct Info {
    /// The .ssplat files; - for standard input
    #[arg(required = true, value_name = "INPUT")]
    pub inputs: Vec<PathBuf>,
    /// Print as JSON; of several files an object for each, with its name as `file`
    #[arg(long)]
    pub json: bool,
}

const PLACEHOLDER_EXAMPLES: &str = "\
Examples:
  ssplat placeholder photo.jpg                                base64 of at most 300 bytes
  ssplat placeholder photo.jpg --bytes 100 --format uri
  ssplat placeholder photo.jpg --format html --alt \"A lighthouse\" --src photo.ssplat

web/placeholder.js draws such a file without WebAssembly; web/ssplat-img.js has the element <ssplat-img>. The
picture is turned as its EXIF block says. Profile and EXIF block are left out.";

/// Output format of `ssplat placeholder`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum PlaceholderFormat {
    /// The file in base64
    Base64,
    /// The file as a data URI
    Uri,
    /// An element <ssplat-img>
    Html,
}

#[derive(Debug, ClapArgs)]
#[command(after_help = PLACEHOLDER_EXAMPLES)]
pub struct Placeholder {
    /// The picture, in any format known by its content; - for standard input
    pub input: PathBuf,
    /// Size of the file, bytes, never exceeded; base64 makes four letters of three
    #[arg(long, value_name = "N", default_value_t = 300, value_parser = clap::value_parser!(u64).range(..=16 << 10))]
    pub bytes: u64,
    /// Choose the form of the output
    #[arg(long, value_enum, default_value = "base64")]
    pub format: PlaceholderFormat,
    /// The element's source [default: the input's name]
    #[arg(long, value_name = "URL")]
    pub src: Option<String>,
    /// Set the element's text for where the picture cannot be seen
    #[arg(long, value_name = "TEXT")]
    pub alt: Option<String>,
    /// How much work to spend, 1 to 9
    #[arg(long, value_name = "LEVEL", default_value_t = 5, value_parser = clap::value_parser!(u8).range(1..=9))]
    pub effort: u8,
}

const VIEW_EXAMPLES: &str = "\
Examples:
  ssplat view photo.ssplat                       until Ctrl-C
  ssplat view                                    encode pictures in the browser, with sliders for size and effort
  ssplat view photo.ssplat --original photo.png  with a slider between the two
  ssplat view photo.ssplat --html photo.html     one page that needs nothing else, to send to someone

The page is served to this machine alone, at a free port, with nothing but the viewer and
the files that are named here. They are read once; a change shows when the command is run anew.";

#[derive(Debug, ClapArgs)]
#[command(after_help = VIEW_EXAMPLES)]
pub struct View {
    /// The .ssplat file; - for standard input. Without one the page asks for a picture and encodes it in the browser
    pub input: Option<PathBuf>,
    /// The picture that it was made of, to compare with, in a format that browsers know
    #[arg(long, value_name = "PICTURE", requires = "input")]
    pub original: Option<PathBuf>,
    /// Write the viewer with the file in it as one page instead of serving it; - for standard output
    #[arg(long, value_name = "OUT", requires = "input")]
    pub html: Option<PathBuf>,
    /// Print the page's address without opening a browser
    #[arg(long, conflicts_with = "html")]
    pub no_open: bool,
}

const COMPLETIONS_EXAMPLES: &str = "\
Examples:
  ssplat completions bash > ~/.local/share/bash-completion/completions/ssplat
  ssplat man > ~/.local/share/man/man1/ssplat.1";

#[derive(Debug, ClapArgs)]
#[command(after_help = COMPLETIONS_EXAMPLES)]
pub struct Completions {
    /// Which one
    pub shell: clap_complete::Shell,
}

const COMPARE_EXAMPLES: &str = "\
Examples:
  ssplat compare photo.png photo.ssplat
  ssplat compare photo.png photo.webp --json

Where one picture has colour or alpha and the other has not, grey is taken as equal
red, green and blue, and missing alpha as opaque; where depths differ, both are taken
with 16 bits. JSON keys: psnr in dB (99 at most), ssim, ms_ssim (null where a side is
under 11 or 161 pixels, too small for them), ssimulacra2 (100 is the best; null where a
side is under 8 pixels), butteraugli (3-norm, 0 is the best; null there and above 16
million pixels).";

#[derive(Debug, ClapArgs)]
#[command(after_help = COMPARE_EXAMPLES)]
pub struct Compare {
    /// The original: any picture, or a .ssplat file
    pub reference: PathBuf,
    /// The picture to compare with it: any picture, or a .ssplat file
    pub test: PathBuf,
    /// Print as JSON
    #[arg(long)]
    pub json: bool,
}

const EXPORT_EXAMPLES: &str = "\
Examples:
  ssplat export photo.ssplat photo.npz      arrays for NumPy
  ssplat export photo.ssplat photo.ply      for viewers of 3D Gaussian Splatting

Means, scales and covariances are in pixels with pixel centres at +0.5, y down; rotations in radians,
colours in encoded sRGB values, 0 to 1. The .npz holds means, scales, rotations, covariances, colors,
background, size, blend, depth, layout and steps; the .csv the same as columns. Import of either gives
the same integers again. A .ply is flat in z and drawn by opacity in viewers, so it shows the Gaussians
rather than the picture; an .svg has an ellipse at one scale for each. Metadata are not exported.";

#[derive(Debug, ClapArgs)]
#[command(after_help = EXPORT_EXAMPLES)]
pub struct Export {
    /// The .ssplat file; - for standard input
    pub input: PathBuf,
    /// The file to write; - for standard output
    pub output: PathBuf,
    /// Format of the output [default: by its name]
    #[arg(long, value_enum)]
    pub format: Option<ExportFormat>,
}

const IMPORT_EXAMPLES: &str = "\
Examples:
  ssplat import photo.npz photo.ssplat
  ssplat import fit.npz fit.ssplat --size 768x512 --bytes 20000

Reads what export writes, or archives with means, colors, and scales with rotations or covariances;
and the parameters of GaussianImage (_xyz, _cholesky or _scaling and _rotation, _features_dc) and of
Image-GS (xy, scale, rot, feat), which do not state the picture's size. Their checkpoints become
archives by one line:
";

#[derive(Debug, ClapArgs)]
#[command(after_help = format!("{IMPORT_EXAMPLES}\n{}", foreign::HOW))]
pub struct Import {
    /// An .npz or .csv file; - for standard input
    pub input: PathBuf,
    /// The .ssplat file to write; - for standard output
    pub output: PathBuf,
    /// Format of the input [default: by its name]
    #[arg(long, value_enum)]
    pub format: Option<ImportFormat>,
    /// Width and height of the picture, pixels [default: as the input says]
    #[arg(long, value_name = "WxH", value_parser = csv::size)]
    pub size: Option<[u32; 2]>,
    /// How the Gaussians blend [default: as the input says]
    #[arg(long, value_parser = names::blend())]
    pub blend: Option<Blend>,
    /// How fine the integers are, 0 to 9 [default: as they were stored, else 6]
    #[arg(long, value_name = "LEVEL", conflicts_with = "bytes", value_parser = clap::value_parser!(u8).range(0..=i64::from(ssplat::unstable::FINEST)))]
    pub precision: Option<u8>,
    /// The finest integers whose file has at most so many bytes
    #[arg(long, value_name = "N", value_parser = bytes)]
    pub bytes: Option<u64>,
    /// How the file is laid out [default: as it was stored, else coded]
    #[arg(long, value_parser = names::layout())]
    pub layout: Option<Layout>,
}

/// A whole number from 1 on.
fn count(text: &str) -> Result<NonZeroUsize, String> {
    text.parse().map_err(|_| "not a whole number from 1 on".into())
}

/// A number of bytes, or of thousands or millions of them.
fn bytes(text: &str) -> Result<u64, String> {
    let (number, unit) = match text.strip_suffix(['k', 'K']) {
        Some(number) => (number, 1e3),
        None => text.strip_suffix('M').map_or((text, 1.0), |number| (number, 1e6)),
    };
    let found = match unit {
        1.0 => number.parse().ok(),
        _ => number.parse::<f64>().ok().map(|n| n * unit).filter(|n| (0.0..1e18).contains(n)).map(|n| n as u64),
    };
    found.ok_or_else(|| "not a number of bytes, as 20000 or 20k or 1.5M".into())
}

pub fn positive(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(v) if v > 0.0 && f64::is_finite(v) => Ok(v),
        _ => Err("not a positive number".into()),
    }
}

fn points(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(v) if (0.0..=100.0).contains(&v) => Ok(v),
        _ => Err("not a number from 0 to 100".into()),
    }
}

fn color(text: &str) -> Result<[u8; 3], String> {
    let digits = text.trim_start_matches('#');
    match u32::from_str_radix(digits, 16) {
        Ok(v) if digits.len() == 6 => Ok([(v >> 16) as u8, (v >> 8) as u8, v as u8]),
        _ => Err("not six hexadecimal digits".into()),
    }
}

fn seconds(text: &str) -> Result<Duration, String> {
    positive(text).and_then(|s| Duration::try_from_secs_f64(s).map_err(|e| e.to_string()))
}

fn thumbnail(text: &str) -> Result<Thumbnail, String> {
    match text {
        "auto" => Ok(Thumbnail::Auto),
        "none" => Ok(Thumbnail::Never),
        bytes => bytes.parse().map(Thumbnail::Bytes).map_err(|_| "neither auto nor none nor a number of bytes".into()),
    }
}

fn detail(text: &str) -> Result<Detail, String> {
    match text {
        "auto" => Ok(Detail::Auto),
        "off" => Ok(Detail::Off),
        share => match share.parse() {
            Ok(share) if share > 0.0 && share < 1.0 => Ok(Detail::Share(share)),
            _ => Err("neither auto nor off nor a share above 0 and below 1".into()),
        },
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
