//! The command line.

use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::{Args as ClapArgs, Parser, Subcommand};
use ssplat::unstable::bitstream::splats::Layout;
use ssplat::unstable::{DEFAULT_QUALITY, EncodeOptions};
use ssplat::{Backend, Blend, Detail, HiddenColors, Layers, MetadataPolicy, Target, Thumbnail, Tune};

use crate::exchange::format::{ExportFormat, ImportFormat};
use crate::exchange::{foreign, parameters};
use crate::failure::Failure;
use crate::names;
use crate::sink::{ReadOnly, Sink};

/// Encode pictures as 2D Gaussians and a detail layer (.ssplat), and decode them
#[derive(Debug, Parser)]
#[command(name = "ssplat", version = VERSION, max_term_width = 100, after_help = EXIT_STATUS)]
pub struct Args {
    #[command(subcommand)]
    pub command: Command,
    /// Number of threads; the result does not depend on it [default: one per core]
    #[arg(long, global = true, value_name = "N", value_parser = count)]
    pub threads: Option<NonZeroUsize>,
}

/// The version, with "(with GPU)" if the build has GPU support.
const VERSION: &str =
    if cfg!(feature = "gpu") { concat!(env!("CARGO_PKG_VERSION"), " (with GPU)") } else { env!("CARGO_PKG_VERSION") };

// Texts after the options: clap wraps them, so each paragraph is one line. Lines that begin with spaces are examples,
// which fit into 80 columns.
const EXIT_STATUS: &str = "\
Exit status: 0 success, 2 wrong usage, 3 reading or writing failed, 4 broken file, 5 unsupported format or version, 6 \
file beyond the limits, 1 anything else. A command that fails leaves no output file. With several inputs, the outputs \
of the others stay, and the status is that of the failures, or 1 if they differ.";

#[derive(Debug, Subcommand)]
pub enum Command {
    /// Encode pictures as .ssplat files
    Encode(Box<Encode>),
    /// Decode .ssplat files to PNG, PNM or another format
    Decode(Decode),
    /// Show what a .ssplat file contains
    Info(Info),
    /// Compare two pictures by quality metrics
    Compare(Compare),
    /// Print a placeholder for a web page: a .ssplat file of a few hundred bytes, as text
    Placeholder(Placeholder),
    /// Show a .ssplat file in the browser, with zoom and an overlay of its Gaussians
    View(View),
    /// Export the Gaussians of a .ssplat file for other programs
    Export(Export),
    /// Import Gaussians that were fitted elsewhere
    Import(Import),
    /// Print shell completions
    Completions(Completions),
    /// List the formats that this build reads and writes
    Formats,
    /// Print a manual page, or write all of them
    Man(Man),
}

const ENCODE_USAGE: &str = "\
ssplat encode [OPTIONS] <INPUT> <OUTPUT>
       ssplat encode [OPTIONS] <INPUT>... --out-dir <DIR>";

const DECODE_USAGE: &str = "\
ssplat decode [OPTIONS] <INPUT> <OUTPUT>
       ssplat decode [OPTIONS] <INPUT>... --out-dir <DIR>";

const ENCODE_EXAMPLES: &str = "\
Examples:
  ssplat encode photo.jpg photo.ssplat                 at the default quality
  ssplat encode photo.jpg photo.ssplat -q 85           better, and larger
  ssplat encode photo.png photo.ssplat --bytes 300     a placeholder
  ssplat encode photo.png photo.ssplat --ratio 200 --effort 9
  ssplat encode photo.png photo.ssplat --preview result.png    with measures
  ssplat encode photo.jpg photo.ssplat --max-side 1920 --keep-times
  ssplat encode *.jpg scans --recursive --out-dir small --update --skip-larger
  cat photo.png | ssplat encode - - > photo.ssplat

With --out-dir, all paths are inputs, and folders stand for their files. Small pictures are encoded in parallel, a \
picture that fails does not stop the others, and with --skip-existing a second run resumes where the first one \
stopped; with --update, it also replaces outputs that are older than their inputs. anim.gif becomes anim.ssplat, or \
anim.gif.ssplat if there is an anim.webp as well.

The file keeps the orientation, unless --auto-orient applies it to the pixels. Samples in 32-bit floats are clamped to \
0..1 and stored with 16 bits. Parts of the input that are lost (most of an EXIF block, XMP, further frames) are \
reported on standard error.

If neither size nor quality is given, the quality is 70. Where the picture without loss takes no more bytes than the \
quality, it is stored without loss, and a note says so. A size that is given is met, or the command fails.";

#[derive(Debug, ClapArgs)]
#[command(after_help = ENCODE_EXAMPLES, override_usage = ENCODE_USAGE)]
pub struct Encode {
    /// The picture, in a format of `ssplat formats`, and the .ssplat file to write; - for standard input or output
    #[arg(required = true, value_name = "PATH")]
    pub paths: Vec<PathBuf>,
    /// The file to write, instead of a second path
    #[arg(long, short, value_name = "FILE", conflicts_with = "out_dir")]
    pub output: Option<PathBuf>,
    #[command(flatten)]
    pub many: Many,
    #[command(flatten)]
    pub target: TargetArgs,
    /// Encode the intact part of a truncated JPEG, GIF or JPEG XL
    #[arg(long)]
    pub partial: bool,
    /// Apply the EXIF orientation to the pixels
    #[arg(long)]
    pub auto_orient: bool,
    /// Which metadata of the input the file keeps; it counts towards the size: needed (ICC profile and orientation),
    /// all (also the whole EXIF block, including time and location), icc, or none
    #[arg(help_heading = "Contents and encoding", long, value_name = "WHICH", default_value = "needed", hide_possible_values = true, value_parser = names::metadata_policy())]
    pub metadata: MetadataPolicy,
    /// Write the file even if its name has the extension of another format
    #[arg(long)]
    pub force: bool,
    /// Longest side in pixels; larger pictures are downscaled before encoding, in linear light
    #[arg(help_heading = "Contents and encoding", long, value_name = "PIXELS", value_parser = clap::value_parser!(u32).range(1..=1 << 20))]
    pub max_side: Option<u32>,
    /// Write no file if it would be larger than the input; a note says so, and the exit status is 0
    #[arg(long)]
    pub skip_larger: bool,
    /// Give the output the modification and access times of the input
    #[arg(long)]
    pub keep_times: bool,
    /// Print only errors
    #[arg(long)]
    pub quiet: bool,
    /// Encoding effort, 1 to 9
    #[arg(long, short, value_name = "LEVEL", default_value_t = 5, value_parser = clap::value_parser!(u8).range(1..=9))]
    pub effort: u8,
    /// Time limit for the whole command; uses a lower effort if the time is too short, and writes the best result so
    /// far
    #[arg(long, value_name = "SECONDS", value_parser = seconds)]
    pub time: Option<Duration>,
    /// Seed of the random number generator
    #[arg(help_heading = "Research", long, value_name = "N", default_value_t = 0)]
    pub seed: u64,
    /// Layout of the file
    #[arg(help_heading = "Research", long, default_value = "coded", value_parser = names::layout())]
    pub layout: Layout,
    /// How Gaussians blend [default: normalized]
    #[arg(help_heading = "Research", long, value_parser = names::blend())]
    pub blend: Option<Blend>,
    /// What to optimize for: iq (perceptual quality) or psnr (squared error) [default: iq; psnr with
    /// --psnr]
    #[arg(help_heading = "Research", long, value_parser = names::tune())]
    pub tune: Option<Tune>,
    /// Keep the colours of fully transparent pixels; by default a smooth continuation of the visible colours replaces
    /// them, which takes fewer bytes
    #[arg(help_heading = "Contents and encoding", long)]
    pub keep_hidden: bool,
    /// Whether the file has a detail layer, which codes the residual that the Gaussians leave: auto (if the file gains
    /// by it; screens, pages and drawings may have an exact layer instead), off, or the share of the bytes for the
    /// Gaussians, above 0 and below 1
    #[arg(long, value_name = "WHICH", default_value = "auto", value_parser = detail)]
    pub detail: Detail,
    /// Number of progressive levels, each of which costs 1 to 2 % of the bytes; a file that is truncated after a level
    /// decodes with --partial
    #[arg(help_heading = "Contents and encoding", long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u8).range(1..=8))]
    pub levels: u8,
    /// Whether the file contains a thumbnail, which counts towards its size: auto, none, or its largest size in bytes;
    /// auto gives files of at least 100 kB a thumbnail of a hundredth of their size, at most 4 kB
    #[arg(help_heading = "Contents and encoding", long, value_name = "WHICH", default_value = "auto", value_parser = thumbnail)]
    pub thumbnail: Thumbnail,
    /// Fit the picture in tiles with this side in pixels, so that memory does not grow with the picture: a multiple of
    /// 128, or 2048 if no side is given [default: above 33 megapixels, but with a GPU only above 268]
    #[arg(help_heading = "Contents and encoding", long, value_name = "SIDE", num_args = 0..=1, require_equals = true, default_missing_value = "2048")]
    pub tiles: Option<u32>,
    /// The device that fits the picture
    #[arg(help_heading = "Contents and encoding", long, default_value = "auto", value_parser = names::backend())]
    pub backend: Backend,
    /// Also decode the file, write the pixels here, and measure their quality
    #[arg(long, value_name = "PNG", conflicts_with = "out_dir")]
    pub preview: Option<PathBuf>,
    /// Print how much time each stage took, and what was left out
    #[arg(help_heading = "Research", long)]
    pub explain: bool,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}

/// What a batch does with outputs that exist already.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Existing {
    Refuse,
    Skip,
    /// Skip outputs that are no older than their inputs, and replace the others.
    Update,
    Replace,
}

/// Options for several inputs.
#[derive(Debug, ClapArgs)]
pub struct Many {
    /// Write into this folder; all paths are inputs, and a folder stands for its files
    #[arg(help_heading = "Several files", long, short = 'd', value_name = "DIR")]
    pub out_dir: Option<PathBuf>,
    /// Include subfolders
    #[arg(help_heading = "Several files", long, requires = "out_dir")]
    pub recursive: bool,
    /// Number of small pictures to process at a time [default: one per thread]
    #[arg(help_heading = "Several files", long, value_name = "N", requires = "out_dir", value_parser = count)]
    pub jobs: Option<NonZeroUsize>,
    /// Skip inputs whose outputs exist
    #[arg(help_heading = "Several files", long, requires = "out_dir", conflicts_with = "overwrite")]
    pub skip_existing: bool,
    /// Skip inputs whose outputs exist and are no older, and replace older outputs
    #[arg(help_heading = "Several files", long, requires = "out_dir", conflicts_with_all = ["overwrite", "skip_existing"])]
    pub update: bool,
    /// Replace outputs that exist; a single output is always replaced, but a read-only one only with this option
    #[arg(help_heading = "Several files", long)]
    pub overwrite: bool,
    /// Append a line of JSON for each input to this file
    #[arg(help_heading = "Several files", long, value_name = "JSONL", requires = "out_dir")]
    pub manifest: Option<PathBuf>,
}

impl Many {
    /// Creates the output for `path`, which must not replace any of `inputs`. A read-only file is replaced only with
    /// `--overwrite`.
    pub fn sink(&self, path: &Path, inputs: &[&Path]) -> Result<Sink, Failure> {
        Sink::replacing(path, inputs, if self.overwrite { ReadOnly::Replace } else { ReadOnly::Keep })
    }

    pub fn existing(&self) -> Existing {
        match (self.skip_existing, self.update, self.overwrite) {
            (true, ..) => Existing::Skip,
            (_, true, _) => Existing::Update,
            (.., true) => Existing::Replace,
            _ => Existing::Refuse,
        }
    }
}

/// Returns the input and the output of a command without `--out-dir`.
pub fn pair<'a>(paths: &'a [PathBuf], output: Option<&'a Path>) -> Result<(&'a Path, &'a Path), Failure> {
    match (paths, output) {
        ([input], Some(output)) => Ok((input, output)),
        ([input, output], None) => Ok((input, output)),
        ([input], None) => Err(Failure::usage(format!("{}: no output; name one, or use --out-dir", input.display()))),
        _ => Err(Failure::usage(format!("{} paths: several inputs need --out-dir", paths.len()))),
    }
}

/// The target of an encode: at most one of these.
#[derive(Debug, ClapArgs)]
#[group(multiple = false)]
pub struct TargetArgs {
    /// Perceptual quality (SSIMULACRA2): 30 low, 50 medium, 70 high (hard to tell from the original side by side), 90
    /// very high (hard to tell even when flipping between them); met within half a point [default: 70]
    #[arg(help_heading = "Size or quality (at most one)", long, short, value_name = "POINTS", value_parser = points)]
    pub quality: Option<f64>,
    /// Compression ratio: width x height x channels bytes divided by the bytes of the file
    #[arg(help_heading = "Size or quality (at most one)", long, short, value_name = "R", value_parser = positive)]
    pub ratio: Option<f64>,
    /// File size in bytes, or as 20k or 1.5M; never exceeded
    #[arg(help_heading = "Size or quality (at most one)", long, short, value_name = "N", value_parser = bytes)]
    pub bytes: Option<u64>,
    /// Number of Gaussians
    #[arg(help_heading = "Size or quality (at most one)", long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub gaussians: Option<u32>,
    /// PSNR; finds the smallest file that reaches it
    #[arg(help_heading = "Size or quality (at most one)", long, value_name = "DB", value_parser = positive)]
    pub psnr: Option<f64>,
    /// The picture itself: decoding gives the same samples. Colours of fully transparent pixels become black unless
    /// --keep-hidden is given
    #[arg(help_heading = "Size or quality (at most one)", long)]
    pub lossless: bool,
}

impl Encode {
    /// Creates the output for `path`, which must not replace any of `inputs`. A read-only file is replaced only with
    /// `--force` or `--overwrite`.
    pub fn sink(&self, path: &Path, inputs: &[&Path]) -> Result<Sink, Failure> {
        if self.force { Sink::replacing(path, inputs, ReadOnly::Replace) } else { self.many.sink(path, inputs) }
    }

    /// Returns the library's options for these arguments.
    pub fn options(&self) -> EncodeOptions {
        let mut o = EncodeOptions::default();
        let t = &self.target;
        let targets = [
            t.ratio.map(Target::Ratio),
            t.bytes.map(Target::Bytes),
            t.gaussians.map(Target::Gaussians),
            t.psnr.map(Target::Psnr),
            t.quality.map(Target::Quality),
            t.lossless.then_some(Target::Lossless),
        ];
        o.target = targets.into_iter().flatten().next().unwrap_or(Target::Quality(DEFAULT_QUALITY));
        o.effort = self.effort;
        o.time = self.time;
        o.seed = self.seed;
        o.layout = self.layout;
        o.blend = self.blend;
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
  ssplat decode photo.ssplat small.png --thumbnail 256    from the thumbnail
  ssplat decode photo.ssplat smaller.png --width 1000
  ssplat decode photo.ssplat detail.png --region 1000,800,512,512 --scale 2
  ssplat decode photo.ssplat - --format ppm | pnmtojpeg > photo.jpg
  ssplat decode cut-off.ssplat coarse.png --partial
  ssplat decode small --out-dir large --format jpg

PNG and PNM are written band by band, so memory does not grow with the picture.";

#[derive(Debug, ClapArgs)]
#[command(after_help = DECODE_EXAMPLES, override_usage = DECODE_USAGE)]
pub struct Decode {
    /// The .ssplat file and the picture to write, whose extension selects the format; - for standard input or output
    #[arg(required = true, value_name = "PATH")]
    pub paths: Vec<PathBuf>,
    #[command(flatten)]
    pub many: Many,
    /// The file to write, instead of a second path
    #[arg(long, short, value_name = "FILE", conflicts_with = "out_dir")]
    pub output: Option<PathBuf>,
    /// Output format, as an extension [default: that of the output, or png for standard output and --out-dir]
    #[arg(long, value_name = "EXT")]
    pub format: Option<String>,
    /// Composite pictures with alpha over this colour, given as six hexadecimal digits [default: ffffff for JPEG, else
    /// none]
    #[arg(long, value_name = "RRGGBB", value_parser = color)]
    pub background: Option<[u8; 3]>,
    /// Apply the EXIF orientation to the pixels
    #[arg(long)]
    pub auto_orient: bool,
    /// Print only errors
    #[arg(long)]
    pub quiet: bool,
    /// Render only this region: left, top, width and height in pixels of the picture
    #[arg(long, value_name = "X,Y,W,H", value_parser = region)]
    pub region: Option<[u32; 4]>,
    /// Output width in pixels; without --height, the aspect ratio is kept
    #[arg(long, value_name = "PIXELS", value_parser = clap::value_parser!(u32).range(1..=1 << 20), conflicts_with = "scale")]
    pub width: Option<u32>,
    /// Output height in pixels; without --width, the aspect ratio is kept
    #[arg(long, value_name = "PIXELS", value_parser = clap::value_parser!(u32).range(1..=1 << 20), conflicts_with = "scale")]
    pub height: Option<u32>,
    /// Render the picture so that it fits into a square with this side in pixels; uses the thumbnail in the file if it
    /// is large enough, which is faster but less exact
    #[arg(long, value_name = "PIXELS", value_parser = clap::value_parser!(u32).range(1..=1 << 20), conflicts_with_all = ["region", "width", "height", "scale", "backend", "layers"])]
    pub thumbnail: Option<u32>,
    /// Output pixels per pixel of the picture; below 1, the picture is low-pass filtered
    #[arg(long, value_name = "FACTOR", value_parser = positive)]
    pub scale: Option<f64>,
    /// The layers to render: both, the Gaussians alone, or the detail layer alone on grey
    #[arg(long, value_name = "WHICH", default_value = "both", value_parser = names::layers())]
    pub layers: Layers,
    /// The device that renders; use the CPU for files that you do not trust
    #[arg(long, default_value = "cpu", value_parser = names::render_backend())]
    pub backend: Backend,
    /// Render the intact parts of a truncated or damaged file, and report what is missing
    #[arg(long)]
    pub partial: bool,
    /// Give the output the modification and access times of the input
    #[arg(long)]
    pub keep_times: bool,
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
    /// Print JSON; with several files, one object per line, with the name as `file`
    #[arg(long)]
    pub json: bool,
}

const PLACEHOLDER_EXAMPLES: &str = "\
Examples:
  ssplat placeholder photo.jpg                    at most 300 bytes, as base64
  ssplat placeholder photo.jpg --bytes 100 --format uri
  ssplat placeholder photo.jpg --format html --alt Lighthouse --src photo.ssplat

web/placeholder.js renders such a file without WebAssembly; web/ssplat-img.js has the element <ssplat-img>. The pixels \
are rotated as the EXIF block says. Profile and EXIF block are left out.";

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
    /// The picture, in a format of `ssplat formats`; - for standard input
    pub input: PathBuf,
    /// Largest size of the file in bytes; base64 turns three bytes into four characters
    #[arg(long, value_name = "N", default_value_t = 300, value_parser = clap::value_parser!(u64).range(..=16 << 10))]
    pub bytes: u64,
    /// The form of the output
    #[arg(long, value_enum, default_value = "base64")]
    pub format: PlaceholderFormat,
    /// The `src` attribute of the element [default: the input's name]
    #[arg(long, value_name = "URL")]
    pub src: Option<String>,
    /// The `alt` attribute of the element
    #[arg(long, value_name = "TEXT")]
    pub alt: Option<String>,
    /// Encoding effort, 1 to 9
    #[arg(long, value_name = "LEVEL", default_value_t = 5, value_parser = clap::value_parser!(u8).range(1..=9))]
    pub effort: u8,
}

const VIEW_EXAMPLES: &str = "\
Examples:
  ssplat view photo.ssplat                       until Ctrl-C
  ssplat view                                    encode in the browser
  ssplat view photo.ssplat --original photo.png  with a slider between the two
  ssplat view photo.ssplat --html photo.html     one self-contained page

The page is served to this machine only, on a free port, with nothing but the viewer and the files named here. The \
files are read once; run the command again to see changes.";

#[derive(Debug, ClapArgs)]
#[command(after_help = VIEW_EXAMPLES)]
pub struct View {
    /// The .ssplat file; - for standard input. Without one the page asks for a picture and encodes it in the browser
    pub input: Option<PathBuf>,
    /// The original picture, for comparison, in a format that browsers support
    #[arg(long, value_name = "PICTURE", requires = "input")]
    pub original: Option<PathBuf>,
    /// Write the viewer and the file as one HTML page instead of serving them; - for standard output
    #[arg(long, value_name = "OUT", requires = "input")]
    pub html: Option<PathBuf>,
    /// Print the address of the page without opening a browser
    #[arg(long, conflicts_with = "html")]
    pub no_open: bool,
    /// End after so many seconds without a request, instead of at Ctrl-C; for desktops, which start the program
    /// without a terminal
    #[arg(long, value_name = "SECONDS", conflicts_with = "html", value_parser = clap::value_parser!(u64).range(1..))]
    pub idle: Option<u64>,
}

const COMPLETIONS_EXAMPLES: &str = "\
Examples:
  ssplat completions bash > ~/.local/share/bash-completion/completions/ssplat
  ssplat completions fish > ~/.config/fish/completions/ssplat.fish";

#[derive(Debug, ClapArgs)]
#[command(after_help = COMPLETIONS_EXAMPLES)]
pub struct Completions {
    /// The shell
    pub shell: clap_complete::Shell,
}

const MAN_EXAMPLES: &str = "\
Examples:
  ssplat man | man -l -                           the program
  ssplat man encode | man -l -                    a command
  ssplat man --out-dir ~/.local/share/man/man1    all of them, as man finds them";

#[derive(Debug, ClapArgs)]
#[command(after_help = MAN_EXAMPLES)]
pub struct Man {
    /// The command whose page is printed [default: the page of the program]
    pub command: Option<String>,
    /// Write the pages of the program and of all commands into this folder
    #[arg(long, short = 'd', value_name = "DIR", conflicts_with = "command")]
    pub out_dir: Option<PathBuf>,
}

const COMPARE_EXAMPLES: &str = "\
Examples:
  ssplat compare photo.png photo.ssplat
  ssplat compare photo.png photo.webp --json

If only one picture has colour or alpha, grey counts as equal red, green and blue, and missing alpha as opaque; if the \
depths differ, both are compared with 16 bits.

JSON keys: psnr in dB (at most 99), ssim and ms_ssim (null if a side is under 11 or 161 pixels, which is too small for \
them), ssimulacra2 (100 is best; pictures with a side below 64 pixels are mirrored), butteraugli (3-norm, 0 is best; \
null if a side is under 8 pixels, and above 16 million pixels).";

#[derive(Debug, ClapArgs)]
#[command(after_help = COMPARE_EXAMPLES)]
pub struct Compare {
    /// The original: a picture or a .ssplat file
    pub reference: PathBuf,
    /// The picture to compare with it: a picture or a .ssplat file
    pub test: PathBuf,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

const EXPORT_EXAMPLES: &str = "\
Examples:
  ssplat export photo.ssplat photo.npz      arrays for NumPy
  ssplat export photo.ssplat photo.ply      for viewers of 3D Gaussian Splatting

Means, scales and covariances are in pixels with pixel centres at +0.5, y down; rotations in radians, colours in \
encoded sRGB values, 0 to 1. The .npz holds means, scales, rotations, covariances, colors, background, size, blend, \
depth, layout and steps; the .csv holds the same as columns. Importing either restores the same integers. A .ply is \
flat in z, and viewers render it by opacity, so it shows the Gaussians rather than the picture; it can be imported as \
well. An .svg has an ellipse at one scale for each. Metadata is not exported.";

#[derive(Debug, ClapArgs)]
#[command(after_help = EXPORT_EXAMPLES)]
pub struct Export {
    /// The .ssplat file; - for standard input
    pub input: PathBuf,
    /// The file to write; - for standard output
    pub output: PathBuf,
    /// Output format [default: by extension]
    #[arg(long, value_enum)]
    pub format: Option<ExportFormat>,
}

const IMPORT_EXAMPLES: &str = "\
Examples:
  ssplat import photo.npz photo.ssplat
  ssplat import fit.npz fit.ssplat --size 768x512 --bytes 20000
  ssplat import points.ply fit.ssplat --size 768x512 --blend normalized

Reads the files of `ssplat export` except .svg, points of 3D Gaussian Splatting (.ply) that lie in one plane, archives with means, colors, and scales with rotations or covariances, and the \
parameters of GaussianImage (_xyz, _cholesky or _scaling and _rotation, _features_dc) and Image-GS (xy, scale, rot, \
feat), which do not state the size of the picture. These commands convert their checkpoints:
";

#[derive(Debug, ClapArgs)]
#[command(after_help = format!("{IMPORT_EXAMPLES}\n{}", foreign::HOW))]
pub struct Import {
    /// An .npz, .csv or .ply file; - for standard input
    pub input: PathBuf,
    /// The .ssplat file to write; - for standard output
    pub output: PathBuf,
    /// Input format [default: by extension]
    #[arg(long, value_enum)]
    pub format: Option<ImportFormat>,
    /// Width and height of the picture in pixels [default: as stated in the input]
    #[arg(long, value_name = "WxH", value_parser = parameters::size)]
    pub size: Option<[u32; 2]>,
    /// How the Gaussians blend [default: as stated in the input]
    #[arg(long, value_parser = names::blend())]
    pub blend: Option<Blend>,
    /// Precision of the integers, 0 to 9 [default: as they were stored, else 6]
    #[arg(long, value_name = "LEVEL", conflicts_with = "bytes", value_parser = clap::value_parser!(u8).range(0..=i64::from(ssplat::unstable::FINEST)))]
    pub precision: Option<u8>,
    /// Largest size of the file in bytes; uses the highest precision that fits
    #[arg(long, value_name = "N", value_parser = bytes)]
    pub bytes: Option<u64>,
    /// Layout of the file [default: as it was stored, else coded]
    #[arg(long, value_parser = names::layout())]
    pub layout: Option<Layout>,
}

/// Parses a whole number of at least 1.
fn count(text: &str) -> Result<NonZeroUsize, String> {
    text.parse().map_err(|_| "not a whole number of at least 1".into())
}

/// Parses a number of bytes, or of thousands or millions of bytes.
fn bytes(text: &str) -> Result<u64, String> {
    let (number, unit) = match text.strip_suffix(['k', 'K']) {
        Some(number) => (number, 1e3),
        None => text.strip_suffix('M').map_or((text, 1.0), |number| (number, 1e6)),
    };
    let found = match unit {
        1.0 => number.parse().ok(),
        _ => number.parse::<f64>().ok().map(|n| n * unit).filter(|n| (0.0..1e18).contains(n)).map(|n| n as u64),
    };
    found.ok_or_else(|| "not a number of bytes such as 20000, 20k or 1.5M".into())
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
        bytes => bytes.parse().map(Thumbnail::Bytes).map_err(|_| "not auto, none or a number of bytes".into()),
    }
}

fn detail(text: &str) -> Result<Detail, String> {
    match text {
        "auto" => Ok(Detail::Auto),
        "off" => Ok(Detail::Off),
        share => match share.parse() {
            Ok(share) if share > 0.0 && share < 1.0 => Ok(Detail::GaussianShare(share)),
            _ => Err("not auto, off or a share above 0 and below 1".into()),
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

    /// clap wraps paragraphs to the terminal; a line break within one would wrap it twice.
    #[test]
    fn texts_after_the_options_have_whole_paragraphs_and_short_examples() {
        use clap::CommandFactory;
        let program = Args::command();
        for command in program.get_subcommands().chain([&program]) {
            let text = command.get_after_help().map(ToString::to_string).unwrap_or_default();
            for (line, next) in text.lines().zip(text.lines().skip(1).chain([""])) {
                let is_example = line.starts_with("  ");
                assert!(!is_example || line.chars().count() <= 80, "{}: {line:?}", command.get_name());
                let ends = line.is_empty() || next.is_empty() || next.starts_with("  ");
                assert!(is_example || ends, "{}: {line:?} is followed by {next:?}", command.get_name());
            }
        }
    }
}
