//! A decoder's state, and decoding to rows of RGBA; safe code only.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use image::metadata::Orientation;
use ssplat::{
    Channels, Damage, Depth, Limit, Limits, Metadata, Reader, Rect, Renderer, Samples, SamplesMut, SplatImage, View,
};

use crate::failure::{Failure, Outcome, ssplat_status};

/// The first bytes of every file.
const MAGIC: &[u8; 4] = b"\x89SSP";

/// Output pixels that are rendered between two looks at the callback, unless a band has more.
const PIXELS_AT_ONCE: u64 = 1 << 20;

/// Most rows of a band.
const BAND_ROWS: u64 = 128;

/// Takes the share that is done; whether to go on.
pub type Watch<'a> = &'a mut dyn FnMut(f32) -> bool;

/// Takes rows of output, from the top; each has the same number of bytes.
pub type Sink<'a> = &'a mut dyn FnMut(&[u8]);

/// A region and an output size; zeros stand for the whole picture and for the region's own size.
#[derive(Debug, Clone, Copy, Default)]
pub struct Wanted {
    pub region: [u32; 4],
    pub size: [u32; 2],
}

/// Facts about an opened file.
pub struct Facts {
    pub size: [u32; 2],
    pub channels: Channels,
    pub depth: Depth,
    pub gaussians: u32,
    pub orientation: u8,
}

/// Everything that a decoder holds.
#[derive(Default)]
pub struct Session {
    pub limits: Limits,
    pub damage: Damage,
    bytes: Option<Vec<u8>>,
    /// The whole picture, once it has been preloaded.
    image: Option<SplatImage>,
}

impl Session {
    /// Opens the file that `bytes` are; the former file is closed even if this fails.
    pub fn open(&mut self, bytes: &[u8]) -> Outcome<()> {
        self.close();
        let mut copy = Vec::new();
        copy.try_reserve_exact(bytes.len()).map_err(|e| Failure::new(ssplat_status::Memory, e))?;
        copy.extend_from_slice(bytes);
        self.hold(copy)
    }

    /// Opens the file at `path`, which may have no more bytes than decoding may allocate.
    pub fn open_path(&mut self, path: &Path) -> Outcome<()> {
        self.close();
        let failed = |e: std::io::Error| match e.kind() {
            std::io::ErrorKind::OutOfMemory => Failure::new(ssplat_status::Memory, e),
            _ => Failure::new(ssplat_status::Io, format_args!("{}: {e}", path.display())),
        };
        let allowed = self.limits.alloc;
        let mut bytes = Vec::new();
        let mut file = File::open(path).map_err(failed)?;
        // Of other files, which may be endless, only the start is read.
        file.by_ref().take(MAGIC.len() as u64).read_to_end(&mut bytes).map_err(failed)?;
        if !bytes.starts_with(MAGIC) {
            return self.hold(bytes);
        }
        let allowed = allowed.max(bytes.len() as u64);
        file.take((allowed - bytes.len() as u64).saturating_add(1)).read_to_end(&mut bytes).map_err(failed)?;
        if bytes.len() as u64 > allowed {
            let message = format!("{}: the file has more than the {allowed} bytes of the limit alloc", path.display());
            return Err(Failure::new(ssplat_status::Limit, message));
        }
        self.hold(bytes)
    }

    fn hold(&mut self, bytes: Vec<u8>) -> Outcome<()> {
        Reader::new(&bytes, &self.limits)?;
        self.bytes = Some(bytes);
        Ok(())
    }

    /// Closes the file.
    pub fn close(&mut self) {
        (self.bytes, self.image) = (None, None);
    }

    fn bytes(&self) -> Outcome<&[u8]> {
        self.bytes.as_deref().ok_or_else(|| Failure::new(ssplat_status::Closed, "no file has been opened"))
    }

    fn reader(&self) -> Outcome<Reader<'_>> {
        Ok(Reader::new(self.bytes()?, &self.limits)?)
    }

    pub fn facts(&self) -> Outcome<Facts> {
        let reader = self.reader()?;
        // A file of which only the start is there may end before its metadata.
        let exif = reader.metadata().ok().and_then(|metadata| metadata.exif);
        let orientation = exif.and_then(|exif| Orientation::from_exif_chunk(&exif));
        Ok(Facts {
            size: [reader.width(), reader.height()],
            channels: reader.channels(),
            depth: reader.depth(),
            gaussians: reader.primitives(),
            orientation: orientation.unwrap_or(Orientation::NoTransforms).to_exif(),
        })
    }

    pub fn metadata(&self) -> Outcome<Metadata> {
        Ok(self.reader()?.metadata()?)
    }

    /// Reads the whole picture, so that drawing any part of it need not read the file.
    pub fn preload(&mut self) -> Outcome<()> {
        self.image = None;
        self.image = Some(self.reader()?.read(self.damage)?);
        Ok(())
    }

    /// Returns the view that is wanted.
    pub fn view(&self, wanted: &Wanted) -> Outcome<View> {
        let mut view = self.reader()?.view();
        let [x, y, width, height] = wanted.region;
        if wanted.region != [0; 4] {
            view = view.crop(Rect::new(x, y, width, height))?;
        }
        Ok(match wanted.size {
            [0, 0] => view,
            [width, height] => view.resized(width, height)?,
        })
    }

    /// Draws `view` as RGBA of `depth`, in the byte order of the machine.
    pub fn draw(&mut self, view: &View, depth: Depth, watch: Watch<'_>, sink: Sink<'_>) -> Outcome<()> {
        go_on(watch, 0.0)?;
        let group = (PIXELS_AT_ONCE / (BAND_ROWS * u64::from(view.width()))).max(1) as u32;
        let channels = self.reader()?.channels();
        let rows = (u64::from(group) * BAND_ROWS).min(u64::from(view.height()));
        let scratch = rows * u64::from(view.width()) * (channels.count() * depth.bytes()) as u64;
        let allowed = self.limits.alloc;
        let left = allowed.checked_sub(scratch).ok_or(ssplat::Error::LimitExceeded {
            limit: Limit::Alloc,
            requested: scratch,
            allowed,
        })?;
        let renderer = if let Some(image) = &mut self.image {
            image.limit_alloc(left)?;
            image.renderer(view)?
        } else {
            let mut image = self.reader()?.read_for(view, self.damage)?;
            go_on(watch, 0.0)?;
            image.limit_alloc(left)?;
            image.renderer(view)?
        };
        go_on(watch, 0.0)?;
        match depth {
            Depth::Eight => bands::<u8>(&renderer, group, watch, sink),
            Depth::Sixteen => bands::<u16>(&renderer, group, watch, sink),
        }
    }

    /// The size of the picture fitted into `within`.
    pub fn thumbnail_size(&self, within: [u32; 2]) -> Outcome<[u32; 2]> {
        let view = self.reader()?.view().fitted(within)?;
        Ok([view.width(), view.height()])
    }

    /// Draws the picture fitted into `within`, from the file's own thumbnail if that is large enough.
    pub fn thumbnail(&self, within: [u32; 2], depth: Depth, sink: Sink<'_>) -> Outcome<()> {
        let pixels = self.reader()?.thumbnail(within)?.pixels;
        let (channels, len) = (pixels.channels(), pixels.width() as usize * pixels.channels().count());
        match (pixels.samples(), depth) {
            (Samples::U8(samples), Depth::Eight) => send(samples, len, channels, sink),
            (Samples::U16(samples), Depth::Sixteen) => send(samples, len, channels, sink),
            (Samples::U8(samples), Depth::Sixteen) => {
                let row = |row: &[u8]| row.iter().map(|&v| u16::from(v) * 257).collect::<Vec<_>>();
                samples.chunks_exact(len).for_each(|part| send(&row(part), len, channels, sink));
            }
            (Samples::U16(samples), Depth::Eight) => {
                let narrow = |v: u16| ((u32::from(v) * 255 + 32767) / 65535) as u8;
                let row = |row: &[u16]| row.iter().map(|&v| narrow(v)).collect::<Vec<_>>();
                samples.chunks_exact(len).for_each(|part| send(&row(part), len, channels, sink));
            }
        }
        Ok(())
    }
}

/// Tells the callback how far the work is.
fn go_on(watch: Watch<'_>, done: f32) -> Outcome<()> {
    if watch(done) { Ok(()) } else { Err(Failure::new(ssplat_status::Cancelled, "cancelled by the callback")) }
}

/// Renders `group` bands at a time and hands out their rows.
fn bands<T: Sample>(renderer: &Renderer, group: u32, watch: Watch<'_>, sink: Sink<'_>) -> Outcome<()> {
    let (count, len) = (renderer.bands(), renderer.row_len());
    let mut scratch = Vec::new();
    for first in (0..count).step_by(group as usize) {
        let last = first.saturating_add(group).min(count);
        let rows = renderer.band_rows(last - 1).end - renderer.band_rows(first).start;
        let needed = rows as usize * len;
        let more = needed.saturating_sub(scratch.len());
        scratch.try_reserve_exact(more).map_err(|e| Failure::new(ssplat_status::Memory, e))?;
        scratch.resize(needed, T::default());
        renderer.render_bands(first..last, T::samples(&mut scratch));
        send(&scratch, len, renderer.channels(), sink);
        go_on(watch, last as f32 / count as f32)?;
    }
    Ok(())
}

/// A sample of 8 or 16 bits.
trait Sample: Default + bytemuck::Pod {
    const OPAQUE: Self;

    fn samples(out: &mut [Self]) -> SamplesMut<'_>;
}

impl Sample for u8 {
    const OPAQUE: u8 = u8::MAX;

    fn samples(out: &mut [u8]) -> SamplesMut<'_> {
        SamplesMut::U8(out)
    }
}

impl Sample for u16 {
    const OPAQUE: u16 = u16::MAX;

    fn samples(out: &mut [u16]) -> SamplesMut<'_> {
        SamplesMut::U16(out)
    }
}

/// Hands out rows of `len` samples as RGBA.
fn send<T: Sample>(samples: &[T], len: usize, channels: Channels, sink: Sink<'_>) {
    let mut rgba = Vec::with_capacity(len / channels.count() * 4);
    for row in samples.chunks_exact(len) {
        rgba.clear();
        for pixel in row.chunks_exact(channels.count()) {
            rgba.extend_from_slice(&match *pixel {
                [grey] => [grey, grey, grey, T::OPAQUE],
                [grey, alpha] => [grey, grey, grey, alpha],
                [red, green, blue] => [red, green, blue, T::OPAQUE],
                [red, green, blue, alpha, ..] => [red, green, blue, alpha],
                [] => [T::OPAQUE; 4],
            });
        }
        sink(bytemuck::cast_slice(&rgba));
    }
}
