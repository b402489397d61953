//! Constructs the files that cost the most to decode for their size: for several picture sizes, as many Gaussians of
//! an expensive kind as the default limits allow, as many groups, and detail layers of empty and of the densest tiles.
//! Prints the CPU seconds of a decode on one thread, with the best and with plain instructions, and its peak memory.
//!
//!
//! ```sh
//! cargo run --release -p ssplat-lab --example worst_file -- [SIDE... [-- KIND...]]
//! ```

use std::error::Error;
use std::fs;
use std::process::Command;
use std::sync::Arc;
use std::time::Duration;

use nix::sys::resource::{UsageWho, getrusage};
use ssplat::unstable::bitstream::lattice::MAX_ANGLES_CODED;
use ssplat::unstable::bitstream::splats::{Layout, PackedGaussian, PackedSplats, Steps};
use ssplat::unstable::bitstream::{DetailHead, DetailLayer, Maker, to_bytes};
use ssplat::unstable::{DecodeOptions, decode};
use ssplat::{Blend, Channels, Depth, Limits};
use ssplat::{Renderer, View};

type Result<T> = std::result::Result<T, Box<dyn Error>>;

const KINDS: [&str; 13] = [
    "wide",
    "corner",
    "upright",
    "edge",
    "level",
    "tiny groups",
    "tiny groups, large codebook",
    "layer of empty tiles",
    "layer of dense tiles, blocks of 4",
    "layer of dense tiles, blocks of 32",
    "layer of dense tiles, large levels",
    "edge, layer of dense tiles",
    DISTORTED,
];
/// The layer gets a third of the limits, so that the rest is left for an extremely distorted view.
const DISTORTED: &str = "layer of dense tiles, distorted view";

fn main() -> Result<()> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    // For internal use: a process for each decode, so that its memory can be measured.
    if let [first, path, kind] = &args[..]
        && first == "--decode"
    {
        return measure(&fs::read(path)?, kind == DISTORTED);
    }
    let mut parts = args.split(|a| a == "--");
    let sides = parts
        .next()
        .filter(|sides| !sides.is_empty())
        .map_or(vec!["64".into(), "1024".into(), "16384".into()], <[_]>::to_vec);
    let kinds: Vec<&str> = parts.next().map_or(KINDS.to_vec(), |kinds| kinds.iter().map(String::as_str).collect());
    let file = tempfile::NamedTempFile::new()?;
    println!("| picture | Gaussians | how many | file, bytes | CPU s | plain, CPU s | peak MB |");
    println!("|---|---|--:|--:|--:|--:|--:|");
    for side in sides {
        for &kind in &kinds {
            let splats = match kind {
                "tiny groups" => tiny_groups(side.parse()?, 1),
                "tiny groups, large codebook" => tiny_groups(side.parse()?, 1 << 16),
                "layer of empty tiles" => layered(side.parse()?, 1, [0, 3], (0, 1))?,
                "layer of dense tiles, blocks of 4" => layered(side.parse()?, 1, [0, 0], (MAX_LEVELS, 1))?,
                "layer of dense tiles, blocks of 32" => layered(side.parse()?, 1, [3, 3], (MAX_LEVELS, 1))?,
                "layer of dense tiles, large levels" => layered(side.parse()?, 1, [0, 0], (MAX_LEVELS, i16::MAX))?,
                DISTORTED => layered(side.parse()?, 3, [0, 0], (MAX_LEVELS, i16::MAX))?,
                "edge, layer of dense tiles" => layered(side.parse()?, 2, [0, 0], (MAX_LEVELS, i16::MAX))?,
                _ => worst(side.parse()?, kind, 1),
            };
            let bytes = to_bytes(&splats)?;
            fs::write(file.path(), &bytes)?;
            let figures = |instructions: &[(&str, &str)]| -> Result<[String; 2]> {
                let mut decode = Command::new(std::env::current_exe()?);
                decode.arg("--decode").arg(file.path()).arg(kind).env("RAYON_NUM_THREADS", "1");
                let output = decode.envs(instructions.iter().copied()).output()?;
                if !output.status.success() {
                    return Err(String::from_utf8_lossy(&output.stderr).into());
                }
                let text = String::from_utf8(output.stdout)?;
                let (seconds, peak) = text.trim().split_once(' ').ok_or("no figures")?;
                Ok([seconds.into(), peak.into()])
            };
            let ([seconds, peak], [plain, _]) = (figures(&[])?, figures(&[("SSPLAT_SIMD", "plain")])?);
            let (count, length) = (splats.gaussians.len(), bytes.len());
            println!("| {side} × {side} | {kind} | {count} | {length} | {seconds} | {plain} | {peak} |");
        }
    }
    Ok(())
}

/// Returns as many Gaussians of a kind as a `part`th of the limits allows, within 3 % and up to two million.
fn worst(side: u32, kind: &str, part: u64) -> PackedSplats {
    let mut limits = Limits::default();
    limits.work /= part;
    let is_allowed = |count| {
        let picture = picture(side, kind, count).to_gaussians();
        Renderer::new(&picture, &View::new(picture.width, picture.height), &limits).is_ok()
    };
    const MOST: u32 = 1 << 21;
    let (mut good, mut bad) = (1, MOST);
    while bad - good > 1 + good / 32 {
        let middle = if bad < MOST { (good + bad) / 2 } else { (good * 2).min(MOST - 1) };
        if is_allowed(middle) { good = middle } else { bad = middle }
    }
    picture(side, kind, good)
}

/// Returns `count` Gaussians of a kind.
fn picture(side: u32, kind: &str, count: u32) -> PackedSplats {
    // Cells of 16 pixels have their centres on the edges of strips, and those of 8 in the middle of one.
    let log = if kind == "edge" { 4 } else { 3 };
    let (cells, tiles) = (side.div_ceil(1 << log), side.div_ceil(128));
    let gaussians = (0..count).map(|i| {
        let (x, y, major, minor, angle) = match kind {
            // Gaussians that cover everything.
            "wide" => (cells / 2, cells / 2, 120, 120, 0),
            // Gaussians around a corner of four tiles.
            "corner" => (i % tiles * 16, i / tiles % tiles * 16, 32, 32, 0),
            // Gaussians along a row of all strips.
            "level" => (cells / 2, i % cells, 120, 0, 0),
            // Gaussians so thin that each row takes an exponential.
            _ => (i % cells, cells / 2, 120, 0, MAX_ANGLES_CODED / 2),
        };
        // Random values, because the format does not allow as many primitives in fewer bytes.
        let luma = (i.wrapping_mul(0x9e37_79b9) >> 29) as i16;
        PackedGaussian { x, y, major, minor, angle, color: [luma, 0, 0, 0] }
    });
    PackedSplats {
        width: side,
        height: side,
        channels: Channels::Rgba,
        depth: Depth::Eight,
        blend: Blend::Normalized,
        layout: Layout::Coded,
        // Eighths of an octave above ¼ pixel.
        steps: Steps { scale: 0, angle: 0, position: 0, coarsest: log as i8, range: 0, luma: 6, chroma: 2 },
        background: [0; 4],
        codebook: None,
        gaussians: gaussians.collect(),
        levels: Vec::new(),
        detail: None,
        exact: None,
        metadata: Default::default(),
    }
}

/// Returns two million Gaussians in as many groups as possible: 4096 clusters that are too large for one group, each
/// alone in a square that is halved repeatedly, with a single Gaussian in each half. Each group starts with new
/// models, and those of a codebook are larger the more `colors` it has.
fn tiny_groups(side: u32, colors: u32) -> PackedSplats {
    // Cells of 1/64 pixel, and the binary logarithm of a cluster's square.
    let log = side.ilog2();
    let gaussians = (0..64 * 64).flat_map(|cluster| {
        let corner = [cluster % 64, cluster / 64].map(|c| c << log);
        let color = |i: u32| color_of((cluster * 541 + i) % colors);
        let at = move |x: u32, y: u32, i: u32| {
            let [x, y] = [corner[0] + x, corner[1] + y];
            PackedGaussian { x, y, major: 0, minor: 0, angle: 0, color: color(i) }
        };
        let many = (0..513).map(move |i| at(0, 0, i));
        let alone = (0..log).flat_map(move |k| [at(1 << k, 0, 513 + 2 * k), at(0, 1 << k, 514 + 2 * k)]);
        many.chain(alone).collect::<Vec<_>>()
    });
    PackedSplats {
        width: side,
        height: side,
        channels: Channels::GreyAlpha,
        depth: Depth::Eight,
        blend: Blend::Normalized,
        layout: Layout::Coded,
        steps: Steps { scale: 0, angle: 0, position: 0, coarsest: -6, range: 0, luma: 6, chroma: 2 },
        background: [0; 4],
        codebook: Some((0..colors).map(color_of).collect()),
        gaussians: gaussians.collect(),
        levels: Vec::new(),
        detail: None,
        exact: None,
        metadata: Default::default(),
    }
}

/// Maximum number of levels in a layer, at 600 of [`Limits::work`] each, minus one percent.
const MAX_LEVELS: u64 = (3 << 34) / 600 / 100 * 99;

/// Returns a picture without Gaussians, or with as many narrow ones as a `part`th of the limits allows, and a layer.
/// Each of its tiles has one level, and the first ones as many as possible, up to a `part`th of `most` in total. Block
/// sizes are within `sizes`.
fn layered(side: u32, part: u64, sizes: [u8; 2], (most, level): (u64, i16)) -> Result<PackedSplats> {
    // Grey if more channels would exceed the limits.
    let channels = if side > 8192 { Channels::Grey } else { Channels::Rgb };
    let mut splats = if part == 1 { picture(side, "edge", 0) } else { worst(side, "edge", part) };
    splats.channels = channels;
    splats.gaussians.iter_mut().for_each(|p| p.color[1..].fill(0));
    let mut head = DetailHead::PLAIN;
    head.sizes = [sizes; 2];
    let tiles = u64::from(side.div_ceil(128)).pow(2);
    let pixels = 16 * tiles * 128 * 128 * channels.count() as u64 / 600;
    let mut levels = Levels { left: (most / part).saturating_sub(tiles + pixels), tile: usize::MAX, level };
    splats.detail = Some(Arc::new(DetailLayer::made(head, channels, [side; 2], &mut levels)?));
    Ok(splats)
}

/// Levels of one magnitude while there are any `left`, then one in each tile.
struct Levels {
    left: u64,
    tile: usize,
    level: i16,
}

impl Maker for Levels {
    fn class(&mut self, _: usize, _: [usize; 2]) -> u8 {
        0
    }

    fn is_divided(&mut self, _: usize, _: usize, _: [usize; 2], _: usize) -> bool {
        true
    }

    fn levels(&mut self, tile: usize, _: usize, _: [usize; 2], size: usize) -> Vec<(u8, u8, i16)> {
        let (is_first, side) = (std::mem::replace(&mut self.tile, tile) != tile, 4u8 << size);
        let count = u64::from(side) * u64::from(side);
        if self.left < count {
            return if is_first { vec![(0, 0, 1)] } else { Vec::new() };
        }
        self.left -= count;
        let level = if self.left.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 63 == 0 { self.level } else { -self.level };
        (0..side).flat_map(|v| (0..side).map(move |u| (u, v, level))).collect()
    }
}

/// Returns one of 65 536 colours of two channels.
fn color_of(i: u32) -> [i16; 4] {
    [(i >> 8) as i16 - 128, (i & 255) as i16 - 128, 0, 0]
}

/// Decodes once, and prints seconds and megabytes.
fn measure(bytes: &[u8], is_distorted: bool) -> Result<()> {
    let mut options = DecodeOptions::default();
    if is_distorted {
        // A view with as many pixels as the picture, enlarged along one axis and reduced along the other by as much as
        // the limits allow.
        let reader = ssplat::Reader::new(bytes, &Limits::default())?;
        let (width, height) = (reader.width(), reader.height());
        let views = (0..12).rev().map(|k| [width.saturating_mul(1 << k), (height >> k).max(1)]);
        for size in views {
            options.size = Some(size);
            if decode(bytes, &options).is_ok() {
                break;
            }
        }
    }
    let before = cpu_time()?;
    decode(bytes, &options)?;
    let seconds = (cpu_time()? - before).as_secs_f64();
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let peak = status.lines().find_map(|l| l.strip_prefix("VmHWM:")?.split_whitespace().next()?.parse::<f64>().ok());
    let peak = peak.map_or("?".into(), |kilobytes| format!("{:.0}", kilobytes / 1024.0));
    println!("{seconds:.1} {peak}");
    Ok(())
}

fn cpu_time() -> Result<Duration> {
    let usage = getrusage(UsageWho::RUSAGE_SELF)?;
    let micros = |t: nix::sys::time::TimeVal| t.tv_sec() as u64 * 1_000_000 + t.tv_usec() as u64;
    Ok(Duration::from_micros(micros(usage.user_time()) + micros(usage.system_time())))
}
