//! Opened files: integers and metadata, from which any view can be rendered any number of times.

use std::borrow::Cow;
use std::fs::File;
use std::io::Read;
use std::path::Path;
use std::sync::Arc;

use super::Decoded;
use crate::parameter::Parameter;

use crate::bitstream::header::Header;
use crate::bitstream::report::Tally;
use crate::bitstream::splats::{Metadata, PackedGaussian, PackedSplats};
use crate::bitstream::{MissingParts, Reading, read_rest};
use crate::budget::{Budget, Reservation};
use crate::error::{Error, FormatError, Result};
use crate::gaussian::{Channels, Gaussian, Gaussians};
use crate::limits::Limits;
use crate::options::{Damage, Layers};
use crate::pixels::{Depth, Pixels};
use crate::raster::{Canvas, ExactOverlay, Overlay, Renderer, SamplesMut, View};
use crate::rect::Rect;

/// A file of which only the header has been read. It returns the size and the channels of the picture before memory is
/// allocated for them.
///
/// A reader serves any number of parts of one file, also from several threads at a time. [`Limits::alloc`] bounds the
/// memory of all that has been read from it and is still in use.
///
/// ```no_run
/// use ssplat::{Limits, Reader, Rect};
///
/// // Tiles of a map; each reads what it needs from the bytes in memory.
/// let reader = Reader::open("map.ssplat", &Limits::default())?;
/// for x in [0, 256, 512] {
///     let tile = reader.view().crop(Rect::new(x, 0, 256, 256))?;
///     let pixels = reader.read_for(&tile)?.render(&tile)?;
/// }
///
/// // The whole picture within 256 × 256 pixels, from the thumbnail of the file if it has one.
/// let small = reader.thumbnail([256, 256])?;
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct Reader<'a> {
    pub(super) header: Header,
    /// Bytes that follow the header.
    rest: Cow<'a, [u8]>,
    limits: Limits,
    budget: Budget,
    damage: Damage,
}

/// A file that has been read and can be rendered any number of times.
///
/// It holds the integers of the picture, not the bytes of the file. [`Limits::alloc`] bounds the memory of the
/// integers and of everything that is rendered from them at the same time.
///
/// ```
/// use ssplat::{Channels, Encoder, Limits, Pixels, Reader, Rect, Samples, SamplesMut};
///
/// # let samples = (0..64 * 48 * 3).map(|i| (i / 3 % 64 * 2 + i / 192) as u8).collect();
/// # let pixels = Pixels::new(64, 48, Channels::Rgb, Samples::U8(samples))?;
/// # let bytes = Encoder::new().bytes(300).effort(1).encode(&pixels)?.bytes;
/// let opened = Reader::new(&bytes, &Limits::default())?.read()?;
/// let whole = opened.view();
/// let icc = opened.metadata().icc.as_deref();
///
/// // The left half, at twice the size.
/// let half = whole.crop(Rect::new(0, 0, 32, 48))?.resized(64, 96)?;
/// let enlarged = opened.render(&half)?;
/// assert_eq!((enlarged.width(), enlarged.height()), (64, 96));
///
/// // A pan over the picture: every frame is drawn into the same memory.
/// let mut frame = vec![0; 16 * 16 * 3];
/// for x in 0..48 {
///     opened.render_into(&whole.crop(Rect::new(x, 8, 16, 16))?, SamplesMut::U8(&mut frame))?;
/// }
///
/// // Row by row, for a writer that needs no more: the view is sorted into tiles once and drawn band by band.
/// let renderer = opened.renderer(&whole)?;
/// for band in 0..renderer.bands() {
///     let mut rows = vec![0; renderer.band_rows(band).len() * renderer.row_len()];
///     renderer.render_bands(band..band + 1, SamplesMut::U8(&mut rows));
/// }
/// # assert!(icc.is_none());
/// # Ok::<(), ssplat::Error>(())
/// ```
#[derive(Debug)]
pub struct SsplatImage {
    pub(crate) splats: PackedSplats,
    missing: MissingParts,
    /// The area that was read and can be rendered; `None` is the whole picture.
    area: Option<Rect>,
    /// The layers that were read.
    layers: Layers,
    limits: Limits,
    budget: Budget,
    /// Memory reserved for the integers.
    #[expect(dead_code, reason = "held until the integers are gone")]
    integers: Reservation,
    /// Memory reserved for the metadata, and for the layers, which renderers hold as well.
    kept: Reservation,
}

impl<'a> Reader<'a> {
    /// Reads the header of the file `bytes`.
    ///
    /// # Errors
    /// [`Error::Format`] if the bytes do not begin with a header, [`Error::UnsupportedVersion`] for another version,
    /// [`Error::LimitExceeded`] if a side of the picture or the number of its Gaussians exceeds `limits`.
    #[doc(alias = "parse")]
    pub fn new(bytes: &'a [u8], limits: &Limits) -> Result<Self> {
        let mut rest = bytes;
        let header = read_header(&mut rest, limits)?;
        Ok(Reader::with_header(header, rest.into(), limits))
    }

    /// Returns a reader of a file whose header has been read; `rest` are the bytes that follow it.
    pub(crate) fn with_header(header: Header, rest: Cow<'a, [u8]>, limits: &Limits) -> Self {
        Reader { header, rest, limits: limits.clone(), budget: Budget::of(limits), damage: Damage::Refuse }
    }

    /// Sets what happens to files that are truncated or damaged. The default is [`Damage::Refuse`].
    #[must_use]
    #[doc(alias("partial", "lenient"))]
    pub fn damage(mut self, damage: Damage) -> Self {
        self.damage = damage;
        self
    }

    /// Returns the width of the picture, pixels.
    #[must_use]
    pub fn width(&self) -> u32 {
        self.header.width
    }

    /// Returns the height of the picture, pixels.
    #[must_use]
    pub fn height(&self) -> u32 {
        self.header.height
    }

    /// Returns the channels of the picture.
    #[must_use]
    pub fn channels(&self) -> Channels {
        self.header.channels
    }

    /// Returns the number of bits per sample of the picture.
    #[must_use]
    #[doc(alias = "bit_depth")]
    pub fn depth(&self) -> Depth {
        self.header.depth
    }

    /// Returns the number of Gaussians.
    #[must_use]
    #[doc(alias("gaussians", "splats"))]
    pub fn gaussian_count(&self) -> u32 {
        self.header.gaussians
    }

    /// Returns everything that the header states.
    #[cfg(feature = "unstable")]
    #[must_use]
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// Returns the view of the whole picture at its own size.
    #[must_use]
    pub fn view(&self) -> View {
        View::new(self.header.width, self.header.height)
    }

    /// Reads the ICC profile, the EXIF block and the thumbnail, without reading the picture. Each has its own
    /// checksum; damaged ones are dropped and named in [`Metadata::damaged`].
    ///
    /// # Errors
    /// [`Error::Format`] for sections that cannot be read, [`Error::LimitExceeded`] if the metadata exceed
    /// [`Limits::metadata`].
    #[doc(alias("icc", "exif"))]
    pub fn metadata(&self) -> Result<Metadata> {
        let reading = Reading { limits: &self.limits, budget: &self.budget, layers: Layers::Both };
        let described = reading.described(&self.header, &self.rest);
        described.map_err(|error| reading.explained(&self.header, &self.rest, Damage::Accept, error))
    }

    /// Renders the picture at the largest size that fits into `within` (width and height in pixels), keeping its aspect
    /// ratio. The picture is never enlarged.
    ///
    /// If the file contains a thumbnail of at least this size, only the thumbnail and the metadata are read. This
    /// takes half a millisecond whatever the picture's size, but the thumbnail's error is larger than the picture's.
    /// Otherwise the picture is read and rendered. The result has the picture's ICC profile and EXIF block in both
    /// cases.
    ///
    /// # Errors
    /// As [`read`](Reader::read), and [`SsplatImage::render`]; [`Error::Parameter`] if a side of `within` is 0.
    #[doc(alias = "preview")]
    pub fn thumbnail(&self, within: [u32; 2]) -> Result<Decoded> {
        super::thumbnail::thumbnail(self, within)
    }

    /// Returns the limits.
    pub(super) fn limits(&self) -> &Limits {
        &self.limits
    }

    /// Reads the whole picture.
    ///
    /// # Errors
    /// [`Error::Format`] for a file that cannot be read, and [`Error::LimitExceeded`] if reading would take too much
    /// memory. With [`Damage::Accept`], truncated and damaged groups are not errors.
    pub fn read(&self) -> Result<SsplatImage> {
        self.read_part(None, Layers::Both)
    }

    /// Reads the part of the picture that is visible in `view`, and the layers that it shows. For a small part of a
    /// large file, this is much less than everything. The result can only render this view and parts of it, with the
    /// same [layers](View::layers). With [`Damage::Accept`], the whole picture is read.
    ///
    /// # Errors
    /// As [`Reader::read`], and [`Error::LimitExceeded`] if the pixels of `view` alone would take too much memory.
    #[doc(alias("region", "crop"))]
    pub fn read_for(&self, view: &View) -> Result<SsplatImage> {
        let samples = u64::from(view.width()) * u64::from(view.height()) * self.header.channels.count() as u64;
        // Do not read a picture whose pixels do not fit into the limits.
        self.budget.check(samples * self.header.depth.bytes() as u64)?;
        self.read_part(Some(view.area()), view.shown())
    }

    fn read_part(&self, area: Option<Rect>, layers: Layers) -> Result<SsplatImage> {
        let Reader { header, rest, limits, budget, damage } = self;
        let reading = Reading { limits, budget, layers };
        let read = match damage {
            Damage::Accept => reading.intact(header, rest).map(|(splats, missing)| (splats, missing, None)),
            Damage::Refuse => reading
                .whole(header, rest, area.as_ref(), &mut Tally::default())
                .map(|(splats, _)| (splats, MissingParts::default(), area)),
        };
        let (splats, missing, area) = read.map_err(|error| reading.explained(header, rest, *damage, error))?;
        let book = splats.codebook.as_ref().map_or(0, |book| size_of_val(&book[..]));
        let layer = splats.detail.as_ref().map_or(0, |layer| layer.memory())
            + splats.exact.as_ref().map_or(0, |layer| layer.memory());
        let integers = budget.reserve((size_of::<PackedGaussian>() * splats.gaussians.len() + book) as u64)?;
        let Metadata { damaged, .. } = &splats.metadata;
        let carried: usize = splats.metadata.sections().map(|(_, contents)| contents.len()).sum();
        let kept = budget.reserve((carried + size_of_val(&damaged[..])) as u64 + layer)?;
        let (limits, budget) = (limits.clone(), budget.clone());
        Ok(SsplatImage { splats, missing, area, limits, budget, layers, integers, kept })
    }
}

impl Reader<'static> {
    /// Reads all bytes of `source`, up to its end. After the header, no more bytes are read than `limits` allow in
    /// memory.
    ///
    /// # Errors
    /// As [`Reader::new`], [`Error::Io`] from `source`, and [`Error::LimitExceeded`] if there are too many bytes.
    pub fn from_read(mut source: impl Read, limits: &Limits) -> Result<Self> {
        let header = read_header(&mut source, limits)?;
        let rest = read_rest(source, limits)?;
        Ok(Reader::with_header(header, rest.into(), limits))
    }

    /// Reads all bytes of the file at `path`, as [`from_read`](Reader::from_read) does.
    ///
    /// # Errors
    /// As [`from_read`](Reader::from_read); the message of an [`Error::Io`] names the path.
    pub fn open(path: impl AsRef<Path>, limits: &Limits) -> Result<Self> {
        let path = path.as_ref();
        let file = File::open(path).map_err(|e| Error::at(path, e))?;
        Reader::from_read(file, limits).map_err(|e| match e {
            Error::Io(e) => Error::at(path, e),
            e => e,
        })
    }
}

impl SsplatImage {
    /// Returns the view of the whole picture at its own size, with the layers that were read.
    #[must_use]
    pub fn view(&self) -> View {
        View::new(self.splats.width, self.splats.height).layers(self.layers)
    }

    /// Returns the integers that were read.
    #[cfg(feature = "unstable")]
    #[must_use]
    pub fn splats(&self) -> &PackedSplats {
        &self.splats
    }

    /// Returns the ICC profile, the EXIF block, the thumbnail, and the names of damaged sections.
    #[must_use]
    pub fn metadata(&self) -> &Metadata {
        &self.splats.metadata
    }

    /// Returns counts of the parts that could not be read. All are 0 unless [`Damage::Accept`] was set.
    #[must_use]
    pub fn missing(&self) -> MissingParts {
        self.missing
    }

    /// Returns the Gaussians that were read, with the values that the formulas of the specification give for their
    /// integers (spec §5.1). They come in the order of the file, level by level. A detail layer is not part of them.
    ///
    /// # Errors
    /// [`Error::LimitExceeded`] if they would take too much memory.
    #[doc(alias("splats", "export"))]
    pub fn gaussians(&self) -> Result<Gaussians> {
        self.budget.check((size_of::<Gaussian>() * self.splats.gaussians.len()) as u64)?;
        Ok(self.splats.to_gaussians())
    }

    /// Returns a renderer of `view`. It does not borrow the opened file.
    ///
    /// # Errors
    /// As [`Renderer::new`], and [`Error::Parameter`] if the view shows parts or layers of the picture that were not
    /// read.
    pub fn renderer(&self, view: &View) -> Result<Renderer> {
        check_view(view, self.area.as_ref(), self.layers)?;
        self.splats.renderer_within(view, &self.limits, &self.budget)
    }

    /// Returns what a renderer needs in addition to the integers: the layers and the area that were read, the limits
    /// and the memory account.
    #[cfg(feature = "gpu")]
    pub(crate) fn render_context(&self) -> (Layers, Option<Rect>, &Limits, &Budget) {
        (self.layers, self.area, &self.limits, &self.budget)
    }

    /// Renders `view` with the channels and the depth of the file.
    ///
    /// # Errors
    /// As [`SsplatImage::renderer`], and [`Error::LimitExceeded`] if the pixels would take too much memory.
    #[doc(alias("draw", "rasterize", "decode"))]
    pub fn render(&self, view: &View) -> Result<Pixels> {
        self.renderer(view)?.render(self.splats.depth)
    }

    /// Renders `view` into `out`, row by row with interleaved channels, at the bit depth of `out`. Reusing the memory
    /// of `out` for several pictures saves the time of allocating it.
    ///
    /// # Errors
    /// As [`SsplatImage::renderer`].
    ///
    /// # Panics
    /// If `out` does not have exactly width × height × channels samples.
    // Inlined, so that a program that uses one depth does not contain the kernels of the other.
    #[inline(always)]
    pub fn render_into(&self, view: &View, out: SamplesMut<'_>) -> Result<()> {
        self.renderer(view)?.render_into(out);
        Ok(())
    }

    /// Returns the metadata and drops the integers.
    #[must_use]
    pub fn into_metadata(self) -> Metadata {
        self.splats.metadata
    }

    /// Returns the metadata and the reservation of their memory and that of the layers, and drops the integers.
    pub(crate) fn into_metadata_and_memory(self) -> (Metadata, Reservation) {
        (self.splats.metadata, self.kept)
    }

    /// Replaces [`Limits::alloc`] by a total of `alloc` bytes, which includes the memory already held.
    ///
    /// # Errors
    /// [`Error::LimitExceeded`] if more than `alloc` bytes are already held; the old limit is kept in this case.
    pub fn limit_alloc(&mut self, alloc: u64) -> Result<()> {
        self.budget.allow(alloc)?;
        self.limits.alloc = alloc;
        Ok(())
    }
}

/// Reads the header, before whose end there is nothing to decode.
fn read_header(source: &mut impl Read, limits: &Limits) -> Result<Header> {
    Header::read(source, limits).map_err(|error| match error {
        Error::Format(FormatError::Truncated { offset: bytes, .. }) => {
            FormatError::CutOff { bytes, of: None, partial: false }.into()
        }
        error => error,
    })
}

/// Checks that `view` shows nothing outside `area`, if only that area was read, and no other layers than were read.
pub(crate) fn check_view(view: &View, area: Option<&Rect>, layers: Layers) -> Result<()> {
    if layers != Layers::Both && view.shown() != layers {
        let problem = format!("{view:?} shows other layers than {layers:?}, which were read");
        return Err(Error::Parameter { parameter: Parameter::View, problem });
    }
    if area.is_some_and(|area| !area.holds(&view.area())) {
        let problem = format!("{view:?} shows more than the part of the picture that was read");
        return Err(Error::Parameter { parameter: Parameter::View, problem });
    }
    Ok(())
}

impl PackedSplats {
    /// Returns a renderer of `view`. Gaussians are computed one by one, whereas
    /// [`to_gaussians`](PackedSplats::to_gaussians) holds all of them in memory.
    ///
    /// # Errors
    /// As [`Renderer::new`].
    #[cfg(any(feature = "encode", test, feature = "unstable"))]
    pub fn renderer(&self, view: &View, limits: &Limits) -> Result<Renderer> {
        self.renderer_within(view, limits, &Budget::of(limits))
    }

    /// Returns a renderer, as [`renderer`](PackedSplats::renderer) does, with memory from `budget`.
    fn renderer_within(&self, view: &View, limits: &Limits, budget: &Budget) -> Result<Renderer> {
        let (canvas, count) = self.canvas().showing(view.shown(), self.gaussians.len());
        let quantizer = self.quantizer();
        let gaussian = |i: usize| quantizer.dequantize(&self.gaussians[i]);
        let renderer = Renderer::of(&canvas, (count, gaussian), view, limits, budget)?;
        let renderer = match self.overlay().filter(|_| view.shown() != Layers::Gaussians) {
            Some(overlay) => renderer.with(overlay, limits)?,
            None => renderer,
        };
        match self.exact_overlay().filter(|_| view.shown() == Layers::Both) {
            Some(exact) => renderer.with_exact(exact, limits),
            None => Ok(renderer),
        }
    }

    /// Returns the canvas onto which the Gaussians are rendered.
    pub(crate) fn canvas(&self) -> Canvas {
        let background = self.quantizer().dequantize_color(self.background);
        Canvas { channels: self.channels, blend: self.blend, background }
    }

    /// Returns the exact layer to draw over the rest, if the file has one.
    pub(crate) fn exact_overlay(&self) -> Option<ExactOverlay> {
        let layer = self.exact.as_ref()?;
        Some(ExactOverlay::new(Arc::clone(layer), self.channels, [self.width, self.height]))
    }

    /// Returns the detail layer to add to the Gaussians, if the file has one.
    pub(crate) fn overlay(&self) -> Option<Overlay> {
        let layer = self.detail.as_ref()?;
        Some(Overlay::new(Arc::clone(layer), self.channels, [self.width, self.height]))
    }
}
