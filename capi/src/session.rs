//! A decoder's state, and decoding to rows of pixels; safe code only.

use std::fmt::Display;
use std::fs::File;
use std::io::{ErrorKind, Read};
use std::path::Path;

use image::metadata::Orientation;
use ssplat::{
    Channels, Damage, Depth, FormatError, Limit, Limits, Metadata, MissingParts, Reader, Rect, Renderer, Samples,
    SsplatImage, View,
};

use crate::failure::{Failure, Outcome, ssplat_status};
use crate::format::{Sample, ssplat_format};

/// The first bytes of every file.
const MAGIC: &[u8; 4] = b"\x89SSP";

/// Bytes of a file that are read at once.
const SMALLEST_READ: usize = 1 << 14;
const LARGEST_READ: usize = 1 << 24;

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
    image: Option<SsplatImage>,
    missing: MissingParts,
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
        let name = path.display();
        let mut file = File::open(path).map_err(|e| failed(&name, e))?;
        self.open_source(&name, |room| {
            loop {
                match file.read(room) {
                    Err(e) if e.kind() == ErrorKind::Interrupted => {}
                    done => return done,
                }
            }
        })
    }

    /// Opens the file that `read` hands out in pieces; `name` is its name in messages.
    pub fn open_source(
        &mut self,
        name: &dyn Display,
        mut read: impl FnMut(&mut [u8]) -> std::io::Result<usize>,
    ) -> Outcome<()> {
        self.close();
        let (allowed, mut bytes) = (self.limits.alloc.max(MAGIC.len() as u64), Vec::new());
        loop {
            let start = bytes.len();
            // Of other files, which may be endless, only the start is read.
            let step = if start < MAGIC.len() { MAGIC.len() - start } else { start.clamp(SMALLEST_READ, LARGEST_READ) };
            let step = step.min((allowed - start as u64).saturating_add(1).try_into().unwrap_or(usize::MAX));
            grow(&mut bytes, step)?;
            bytes.resize(start + step, 0);
            let count = read(&mut bytes[start..]).map_err(|e| failed(name, e))?;
            bytes.truncate(start + count);
            if bytes.len() as u64 > allowed {
                let message = format!("{name}: the file has more than the {allowed} bytes of the limit alloc");
                return Err(Failure::new(ssplat_status::Limit, message));
            }
            if count == 0 || bytes.len() >= MAGIC.len() && !bytes.starts_with(MAGIC) {
                return self.hold(bytes);
            }
        }
    }

    /// Opens a file without bytes, for [`append`](Session::append).
    pub fn begin(&mut self) {
        self.close();
        self.bytes = Some(Vec::new());
    }

    /// Adds bytes to the end of the file. It is closed if they cannot be the start of a file.
    pub fn append(&mut self, more: &[u8]) -> Outcome<()> {
        let Some(bytes) = &mut self.bytes else { return Err(closed()) };
        let total = bytes.len() as u64 + more.len() as u64;
        if total > self.limits.alloc {
            let (limit, requested, allowed) = (Limit::Alloc, total, self.limits.alloc);
            self.close();
            return Err(ssplat::Error::LimitExceeded { limit, requested, allowed }.into());
        }
        grow(bytes, more.len())?;
        bytes.extend_from_slice(more);
        (self.image, self.missing) = (None, MissingParts::default());
        match Reader::new(bytes, &self.limits) {
            Ok(_) | Err(ssplat::Error::Format(FormatError::CutOff { .. })) => Ok(()),
            Err(error) => {
                self.close();
                Err(error.into())
            }
        }
    }

    fn hold(&mut self, bytes: Vec<u8>) -> Outcome<()> {
        Reader::new(&bytes, &self.limits)?;
        self.bytes = Some(bytes);
        Ok(())
    }

    /// Closes the file.
    pub fn close(&mut self) {
        (self.bytes, self.image, self.missing) = (None, None, MissingParts::default());
    }

    fn bytes(&self) -> Outcome<&[u8]> {
        self.bytes.as_deref().ok_or_else(closed)
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
            gaussians: reader.gaussian_count(),
            orientation: orientation.unwrap_or(Orientation::NoTransforms).to_exif(),
        })
    }

    /// What the last picture lacks.
    pub fn missing(&self) -> Outcome<MissingParts> {
        self.bytes().map(|_| self.missing)
    }

    pub fn metadata(&self) -> Outcome<Metadata> {
        Ok(self.reader()?.metadata()?)
    }

    /// Reads the whole picture, so that drawing any part of it need not read the file.
    pub fn preload(&mut self) -> Outcome<()> {
        self.image = None;
        let image = self.reader()?.damage(self.damage).read()?;
        self.missing = image.missing();
        self.image = Some(image);
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

    /// Draws `view` in `format`.
    pub fn draw(&mut self, view: &View, format: ssplat_format, watch: Watch<'_>, sink: Sink<'_>) -> Outcome<()> {
        go_on(watch, 0.0)?;
        let group = (PIXELS_AT_ONCE / (BAND_ROWS * u64::from(view.width()))).max(1) as u32;
        let (channels, depth) = (self.reader()?.channels(), format.depth());
        format.check(channels)?;
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
            let mut image = self.reader()?.damage(self.damage).read_for(view)?;
            go_on(watch, 0.0)?;
            image.limit_alloc(left)?;
            self.missing = image.missing();
            image.renderer(view)?
        };
        go_on(watch, 0.0)?;
        match depth {
            Depth::Eight => bands::<u8>(&renderer, group, format, watch, sink),
            Depth::Sixteen => bands::<u16>(&renderer, group, format, watch, sink),
        }
    }

    /// The size of the picture fitted into `within`.
    pub fn thumbnail_size(&self, within: [u32; 2]) -> Outcome<[u32; 2]> {
        let view = self.reader()?.view().fitted(within)?;
        Ok([view.width(), view.height()])
    }

    /// Draws the picture fitted into `within`, from the file's own thumbnail if that is large enough.
    pub fn thumbnail(&self, within: [u32; 2], format: ssplat_format, sink: Sink<'_>) -> Outcome<()> {
        format.check(self.reader()?.channels())?;
        let pixels = self.reader()?.damage(self.damage).thumbnail(within)?.pixels;
        let (channels, len) = (pixels.channels(), pixels.width() as usize * pixels.channels().count());
        match (pixels.samples(), format.depth()) {
            (Samples::U8(samples), Depth::Eight) => format.send(samples, len, channels, sink),
            (Samples::U16(samples), Depth::Sixteen) => format.send(samples, len, channels, sink),
            (Samples::U8(samples), Depth::Sixteen) => {
                let row = |row: &[u8]| row.iter().map(|&v| u16::from(v) * 257).collect::<Vec<_>>();
                samples.chunks_exact(len).for_each(|part| format.send(&row(part), len, channels, sink));
            }
            (Samples::U16(samples), Depth::Eight) => {
                let narrow = |v: u16| ((u32::from(v) * 255 + 32767) / 65535) as u8;
                let row = |row: &[u16]| row.iter().map(|&v| narrow(v)).collect::<Vec<_>>();
                samples.chunks_exact(len).for_each(|part| format.send(&row(part), len, channels, sink));
            }
        }
        Ok(())
    }
}

/// No file is open.
fn closed() -> Failure {
    Failure::new(ssplat_status::Closed, "no file has been opened")
}

/// A file that cannot be read.
fn failed(name: &dyn Display, error: std::io::Error) -> Failure {
    match error.kind() {
        ErrorKind::OutOfMemory => Failure::new(ssplat_status::Memory, error),
        _ => Failure::new(ssplat_status::Io, format_args!("{name}: {error}")),
    }
}

/// Makes room for so many more bytes.
fn grow(bytes: &mut Vec<u8>, more: usize) -> Outcome<()> {
    bytes.try_reserve(more).map_err(|e| Failure::new(ssplat_status::Memory, e))
}

/// Tells the callback how far the work is.
fn go_on(watch: Watch<'_>, done: f32) -> Outcome<()> {
    if watch(done) { Ok(()) } else { Err(Failure::new(ssplat_status::Cancelled, "cancelled by the callback")) }
}

/// Renders `group` bands at a time and hands out their rows.
fn bands<T: Sample>(
    renderer: &Renderer,
    group: u32,
    format: ssplat_format,
    watch: Watch<'_>,
    sink: Sink<'_>,
) -> Outcome<()> {
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
        format.send(&scratch, len, renderer.channels(), sink);
        go_on(watch, last as f32 / count as f32)?;
    }
    Ok(())
}
