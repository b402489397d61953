//! Renders views of a picture whose Gaussians stay in the memory of the device.

use super::device::Device;
use super::layer::Layer;
use super::lists::{Lists, MAX_BINDING, MAX_TILES, check_primitives};
#[cfg(test)]
use super::scene::Splat;
use super::scene::{Primitive, TILE, Uniforms, spaced};
use crate::budget::Budget;
use crate::decode::{SsplatImage, check_view};
use crate::error::{Error, GpuError, Result};
use crate::gaussian::{Channels, Gaussian, Gaussians, MAX_SCALE};
use crate::limits::Limits;
use crate::options::Layers;
use crate::parameter::{Limit, Parameter};
use crate::pixels::{Depth, Pixels, Samples};
use crate::raster::{self, ExactOverlay, Overlay, SamplesMut, View};
use crate::rect::Rect;
use std::sync::Arc;

/// Alignment of the rows of a texture copy, bytes.
const ROW_ALIGNMENT: u32 = wgpu::COPY_BYTES_PER_ROW_ALIGNMENT;

/// Work of a (Gaussian, tile) pair in pixels: a tile is always rendered as a whole.
const PAIR_WORK: u64 = (TILE * TILE) as u64;

/// A picture in the memory of a device, of which any view can be rendered.
#[derive(Debug)]
pub struct Renderer {
    device: Device,
    canvas: raster::Canvas,
    count: u32,
    limits: Limits,
    /// Memory account for pixels and additions.
    budget: Budget,
    /// The layers that were read and can be rendered.
    layers: Layers,
    /// The area that was read and can be rendered; `None` is the whole picture.
    area: Option<Rect>,
    /// Detail layer to add to the Gaussians.
    overlay: Option<Arc<Overlay>>,
    /// Exact layer, which the CPU draws over each band.
    exact: Option<ExactOverlay>,
    primitives: wgpu::Buffer,
    stage: Option<Canvas>,
    /// Rows of the output per band.
    band_rows: u32,
    /// Number of pairs of a band above which its lists must grow.
    capacity: u32,
}

/// The buffers for views of one shape.
#[derive(Debug)]
struct Canvas {
    shape: CanvasSize,
    uniforms: wgpu::Buffer,
    codes: wgpu::Buffer,
    additions: wgpu::Buffer,
    lists: Lists,
    render: wgpu::BindGroup,
}

/// Parameters on which the sizes of the buffers depend.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct CanvasSize {
    grid: Grid,
    band_rows: u32,
    capacity: u32,
}

/// Size of a view in samples and in output words.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Grid {
    /// Columns and rows of samples.
    width: u32,
    height: u32,
    /// Rows of samples per output row.
    down: u32,
    /// Words in a row of the codes.
    stride: u32,
    /// Bytes of additions per row; 0 without a layer.
    added: u64,
}

/// Layout of code values; the numbers are the modes of `render.wgsl`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Format {
    Rgba8 = 0,
    Bgra8 = 1,
    Rgba16 = 2,
}

impl Renderer {
    /// Copies `picture` to `device`.
    ///
    /// # Errors
    /// [`Error::LimitExceeded`] if `limits` do not allow its primitives; [`Error::Parameter`] if one of them is not
    /// finite or has a scale outside `0..=2²⁰`; [`Error::Gpu`] if the device fails or does not have enough memory.
    pub fn new(device: &Device, picture: &Gaussians, limits: &Limits) -> Result<Self> {
        let canvas =
            raster::Canvas { channels: picture.channels, blend: picture.blend, background: picture.background };
        let gaussians = (picture.list.len(), |i: usize| picture.list[i]);
        Renderer::on(device, &canvas, gaussians, limits, &Budget::of(limits))
    }

    /// Copies the layers of `opened` that were read to `device`; each view then selects [layers](View::layers) of them.
    /// The file may be dropped afterwards; rendering reserves memory from its account ([`Limits::alloc`]). The
    /// additions of a detail layer are computed on the CPU when a view is rendered.
    ///
    /// # Errors
    /// As [`Renderer::new`], with the limits of `opened`.
    pub fn of(device: &Device, opened: &SsplatImage) -> Result<Self> {
        let (layers, area, limits, budget) = opened.render_context();
        let splats = &opened.splats;
        let quantizer = splats.quantizer();
        let gaussians = (splats.gaussians.len(), |i: usize| quantizer.dequantize(&splats.gaussians[i]));
        let overlay = splats.overlay().map(Arc::new);
        let exact = splats.exact_overlay();
        Ok(Renderer {
            layers,
            area,
            overlay,
            exact,
            ..Renderer::on(device, &splats.canvas(), gaussians, limits, budget)?
        })
    }

    fn on(
        device: &Device,
        canvas: &raster::Canvas,
        (length, gaussian): (usize, impl Fn(usize) -> Gaussian),
        limits: &Limits,
        budget: &Budget,
    ) -> Result<Self> {
        let count = length as u64;
        Limits::check(Limit::Gaussians, count, limits.gaussians)?;
        check_primitives(count)?;
        if !canvas.background.iter().all(|v| v.is_finite()) {
            return Err(Error::Parameter {
                parameter: Parameter::Background,
                problem: format!("{:?}", canvas.background),
            });
        }
        let _held = budget.reserve(count * size_of::<Primitive>() as u64)?;
        let mut primitives = Vec::with_capacity(length);
        for i in 0..length {
            let g = gaussian(i);
            let sound = g.mean.iter().chain([&g.rotation]).chain(&g.color).all(|v| v.is_finite())
                && g.scale.iter().all(|&s| s > 0.0 && s <= MAX_SCALE);
            if !sound {
                return Err(Error::Parameter {
                    parameter: Parameter::Gaussians,
                    problem: format!("number {i} is not finite or has a scale outside 0..=1048576: {g:?}"),
                });
            }
            primitives.push(Primitive {
                mean: g.mean,
                log_scale: g.scale.map(f32::ln),
                // The shader's sine is most precise near 0.
                rotation: g.rotation.rem_euclid(std::f32::consts::PI),
                color: g.color,
            });
        }
        let buffer = device.scoped(|| {
            let buffer = device.storage("primitives", count * size_of::<Primitive>() as u64);
            device.write(&buffer, &primitives);
            buffer
        })?;
        Ok(Renderer {
            device: device.clone(),
            canvas: *canvas,
            count: count as u32,
            limits: limits.clone(),
            budget: budget.clone(),
            layers: Layers::Both,
            area: None,
            overlay: None,
            exact: None,
            primitives: buffer,
            stage: None,
            band_rows: u32::MAX,
            capacity: (count as u32).saturating_mul(24).max(1 << 16).min((MAX_BINDING / 4) as u32),
        })
    }

    /// Renders `view` and copies the pixels back to the host.
    ///
    /// # Errors
    /// [`Error::LimitExceeded`] if the pixels, the additions of a detail layer, the (Gaussian, tile) pairs or their
    /// work exceed the limits; rendering stops before the band that exceeds them. [`Error::Parameter`] if the view
    /// shows parts or layers of the picture that were not read. [`Error::Gpu`] if the device fails, or if the Gaussians
    /// of a single row of tiles do not fit into a list.
    pub fn render(&mut self, view: &View, depth: Depth) -> Result<Pixels> {
        let count = self.canvas.channels.count();
        let samples = u64::from(view.width()) * u64::from(view.height()) * count as u64;
        let _held = self.budget.reserve(samples * depth.bytes() as u64)?;
        // Indices of the picture's channels among red, green, blue and alpha.
        let picked: &[usize] = match self.canvas.channels {
            Channels::Grey => &[0],
            Channels::GreyAlpha => &[0, 3],
            Channels::Rgb => &[0, 1, 2],
            Channels::Rgba => &[0, 1, 2, 3],
        };
        let pixel = |bytes: &mut Vec<u8>, p: &[u8]| bytes.extend(picked.iter().map(|&k| p[k]));
        let samples = match depth {
            Depth::Eight => {
                let mut out = Vec::with_capacity(samples as usize);
                self.draw(view, Format::Rgba8, view.width(), |device, codes, words, _| {
                    for p in device.read(codes, words * 4)?.chunks_exact(4) {
                        pixel(&mut out, p);
                    }
                    Ok(())
                })?;
                Samples::U8(out)
            }
            Depth::Sixteen => {
                let mut out: Vec<u16> = Vec::with_capacity(samples as usize);
                self.draw(view, Format::Rgba16, 2 * view.width(), |device, codes, words, _| {
                    for p in device.read_as::<[u32; 2]>(codes, words as usize / 2)? {
                        let p = [p[0] as u16, (p[0] >> 16) as u16, p[1] as u16, (p[1] >> 16) as u16];
                        out.extend(picked.iter().map(|&k| p[k]));
                    }
                    Ok(())
                })?;
                Samples::U16(out)
            }
        };
        Pixels::new(view.width(), view.height(), self.canvas.channels, samples)
    }

    /// Renders `view` into `buffer`; see [`wgpu_30`](super::wgpu_30).
    pub(super) fn render_to_buffer(&mut self, view: &View, buffer: &wgpu::Buffer) -> Result<()> {
        let width = view.width();
        self.draw(view, Format::Rgba8, width, |device, codes, words, first| {
            let to = u64::from(first) * u64::from(width) * 4;
            device.scoped(|| {
                let (d, queue) = device.wgpu();
                let mut encoder = d.create_command_encoder(&Default::default());
                encoder.copy_buffer_to_buffer(codes, 0, buffer, to, words * 4);
                queue.submit([encoder.finish()]);
            })
        })
    }

    /// Renders `view` into the top left corner of `texture`; see [`wgpu_30`](super::wgpu_30).
    pub(super) fn render_to_texture(&mut self, view: &View, texture: &wgpu::Texture) -> Result<()> {
        use wgpu::TextureFormat as F;
        let format = match texture.format() {
            F::Rgba8Unorm | F::Rgba8UnormSrgb => Format::Rgba8,
            F::Bgra8Unorm | F::Bgra8UnormSrgb => Format::Bgra8,
            other => {
                return Err(Error::Parameter { parameter: Parameter::Texture, problem: format!("format {other:?}") });
            }
        };
        let (width, height) = (view.width(), view.height());
        if width > texture.width() || height > texture.height() {
            let problem = format!("{}×{} is smaller than the view", texture.width(), texture.height());
            return Err(Error::Parameter { parameter: Parameter::Texture, problem });
        }
        let stride = (width * 4).next_multiple_of(ROW_ALIGNMENT) / 4;
        self.draw(view, format, stride, |device, codes, words, first| {
            device.scoped(|| {
                let (d, queue) = device.wgpu();
                let mut encoder = d.create_command_encoder(&Default::default());
                let source = wgpu::TexelCopyBufferInfo {
                    buffer: codes,
                    layout: wgpu::TexelCopyBufferLayout {
                        offset: 0,
                        bytes_per_row: Some(stride * 4),
                        rows_per_image: None,
                    },
                };
                let target = wgpu::TexelCopyTextureInfo {
                    texture,
                    mip_level: 0,
                    origin: wgpu::Origin3d { x: 0, y: first, z: 0 },
                    aspect: wgpu::TextureAspect::All,
                };
                let rows = (words / u64::from(stride)) as u32;
                let size = wgpu::Extent3d { width, height: rows, depth_or_array_layers: 1 };
                encoder.copy_buffer_to_texture(source, target, size);
                queue.submit([encoder.finish()]);
            })
        })
    }

    /// Returns the height of the last view's bands in output rows, and the capacity of a band's lists in pairs.
    #[must_use]
    pub fn bands(&self) -> (u32, u32) {
        (self.band_rows, self.capacity)
    }

    /// Returns the splats of the last view.
    #[cfg(test)]
    pub(super) fn splats(&self) -> Result<Vec<Splat>> {
        let lists = &self.stage.as_ref().expect("something was drawn").lists;
        self.device.read_as(&lists.splats, self.count as usize)
    }

    /// Adds a detail layer, and starts with lists that are too short.
    #[cfg(test)]
    pub(super) fn adding(self, overlay: Arc<Overlay>) -> Self {
        Renderer { overlay: Some(overlay), capacity: 100, ..self }
    }

    /// Renders `view` band by band. `take` receives each complete band: its codes, their number in words and the
    /// band's first row.
    fn draw(
        &mut self,
        view: &View,
        format: Format,
        stride: u32,
        mut take: impl FnMut(&Device, &wgpu::Buffer, u64, u32) -> Result<()>,
    ) -> Result<()> {
        check_view(view, self.area.as_ref(), self.layers)?;
        let (canvas, count) = self.canvas.showing(view.shown(), self.count as usize);
        let mut layer = match self.overlay.as_ref().filter(|_| view.shown() != Layers::Gaussians) {
            Some(overlay) => Some(Layer::new(overlay, view, &self.limits)?),
            None => None,
        };
        let base = Uniforms {
            stride,
            detail: layer.is_some().into(),
            ..Uniforms::new(view, canvas.blend, canvas.channels, canvas.background, count as u32)
        };
        // Output rows in a tile.
        let tall = TILE / base.down;
        let added = layer.as_ref().map_or(0, Layer::row_memory);
        let grid = Grid { width: base.width, height: base.height, down: base.down, stride, added };
        let most = most_rows(&base, tall, layer.as_ref())?;
        if self.stage.as_ref().is_none_or(|s| s.shape.grid != grid) {
            self.band_rows = most.min(view.height().next_multiple_of(tall));
        }
        if let Some(layer) = &layer {
            layer.check(self.band_rows, &self.budget)?;
        }
        let max_pairs = MaxPairs {
            pairs: self.limits.tile_pairs,
            work: self.limits.max_work(u64::from(base.width) * u64::from(base.height), self.count.into()),
            all_work: self.limits.work,
            layer_work: layer.as_ref().map_or(0, Layer::work),
        };
        let mut first = 0;
        let mut pairs = 0u64;
        while first < view.height() {
            let most = self.band_rows.min(view.height() - first);
            let rows = layer.as_ref().map_or(most, |layer| layer.rows(first, most));
            self.prepare(grid)?;
            let stage = self.stage.as_ref().expect("just prepared");
            // A band with more pairs than the limit allows is not rendered.
            let left = u32::try_from(max_pairs.allowed() - pairs).unwrap_or(u32::MAX);
            let band = Uniforms { capacity: self.capacity.min(left), ..base }.band(first * base.down, rows * base.down);
            let additions = layer.as_mut().map(|layer| layer.additions(first..first + rows));
            self.submit(stage, &band, format, additions)?;
            let [found, missing, ..] = stage.lists.status(&self.device)?;
            if missing > 0 {
                max_pairs.check(pairs + u64::from(missing))?;
                self.grow_lists(missing, tall)?;
                continue;
            }
            pairs += u64::from(found);
            if let Some(exact) = self.exact.as_ref().filter(|_| view.shown() == Layers::Both) {
                exact.check(view, &self.limits, &self.budget)?;
                self.cover(exact, view, (format, stride), first..first + rows)?;
            }
            take(&self.device, &stage.codes, u64::from(rows) * u64::from(stride), first)?;
            first += rows;
        }
        Ok(())
    }

    /// Draws the exact layer over the codes of some rows, on the CPU.
    fn cover(
        &self,
        exact: &ExactOverlay,
        view: &View,
        (format, stride): (Format, u32),
        rows: std::ops::Range<u32>,
    ) -> Result<()> {
        let codes = &self.stage.as_ref().expect("just rendered").codes;
        let channels = self.canvas.channels;
        let words = rows.len() as u64 * u64::from(stride);
        let samples = rows.len() * view.width() as usize * channels.count();
        let _held = self.budget.reserve(words * 4 + 2 * samples as u64)?;
        // Positions of a pixel's samples among those of the codes: each channel of the picture, and where it is shown.
        let [red, blue] = if matches!(format, Format::Bgra8) { [2, 0] } else { [0, 2] };
        let places: &[(usize, usize)] = match channels {
            Channels::Grey => &[(0, red), (0, 1), (0, blue)],
            Channels::GreyAlpha => &[(0, red), (0, 1), (0, blue), (1, 3)],
            Channels::Rgb => &[(0, red), (1, 1), (2, blue)],
            Channels::Rgba => &[(0, red), (1, 1), (2, blue), (3, 3)],
        };
        /// Runs `draw` on the pixels of codes, and writes the result back.
        fn with_pixels<T: Copy + Default>(
            codes: &mut [T],
            (stride, width): (usize, usize),
            (count, places): (usize, &[(usize, usize)]),
            draw: impl FnOnce(&mut [T]),
        ) {
            let mut pixels = Vec::with_capacity(codes.len() / stride * width * count);
            for row in codes.chunks_exact(stride) {
                for code in row[..4 * width].chunks_exact(4) {
                    let value = |k: usize| places.iter().find(|place| place.0 == k).map_or(T::default(), |p| code[p.1]);
                    pixels.extend((0..count).map(value));
                }
            }
            draw(&mut pixels);
            let mut drawn = pixels.chunks_exact(count);
            for row in codes.chunks_exact_mut(stride) {
                for (code, pixel) in row[..4 * width].chunks_exact_mut(4).zip(&mut drawn) {
                    places.iter().for_each(|&(k, place)| code[place] = pixel[k]);
                }
            }
        }
        let (stride, width) = (stride as usize, view.width() as usize);
        let kind = (channels.count(), places);
        match format {
            Format::Rgba16 => {
                let mut values: Vec<u16> = self.device.read_as(codes, 2 * words as usize)?;
                with_pixels(&mut values, (2 * stride, width), kind, |out| {
                    exact.draw_over(view, rows, SamplesMut::U16(out));
                });
                self.device.write(codes, &values);
            }
            _ => {
                let mut values = self.device.read(codes, words * 4)?;
                with_pixels(&mut values, (4 * stride, width), kind, |out| {
                    exact.draw_over(view, rows, SamplesMut::U8(out));
                });
                self.device.write(codes, &values);
            }
        }
        Ok(())
    }

    /// Submits the commands that render `band` into the codes of `stage`, with the layer's `additions` to its pixels.
    fn submit(&self, stage: &Canvas, band: &Uniforms, format: Format, additions: Option<&[f32]>) -> Result<()> {
        let modes = [0, 1, format as u32].map(|mode| Uniforms { mode, ..*band });
        self.device.scoped(|| {
            let (d, queue) = self.device.wgpu();
            let kernels = self.device.kernels();
            self.device.write(&stage.uniforms, &spaced(&modes));
            if let Some(additions) = additions {
                self.device.write(&stage.additions, additions);
            }
            let mut encoder = d.create_command_encoder(&Default::default());
            encoder.clear_buffer(&stage.lists.status, 0, None);
            stage.lists.project(kernels, &mut encoder, 0, u64::from(self.count));
            stage.lists.fill(kernels, &mut encoder, 0, band);
            let mut pass = encoder.begin_compute_pass(&Default::default());
            kernels.render.groups(&mut pass, &stage.render, 2, band.tiles());
            drop(pass);
            queue.submit([encoder.finish()]);
        })
    }

    /// Makes the lists longer, or the bands lower if the lists have their maximum length. `tall` is the height of a
    /// tile in output rows. `missing` is the number of pairs of a band that did not fit, or a lower bound of it.
    fn grow_lists(&mut self, missing: u32, tall: u32) -> Result<()> {
        let most = (MAX_BINDING / 4) as u32;
        if self.capacity < most {
            self.capacity = (self.capacity.saturating_mul(2)).max(missing).min(most);
        } else if self.band_rows > tall {
            self.band_rows = (self.band_rows / 2).next_multiple_of(tall);
        } else {
            let what = "(Gaussian, tile) pairs in a row of tiles";
            return Err(GpuError::Overflow { what, requested: missing.into(), allowed: most.into() }.into());
        }
        Ok(())
    }

    /// Creates the buffers, unless those of the last view fit.
    fn prepare(&mut self, grid: Grid) -> Result<()> {
        let shape = CanvasSize { grid, band_rows: self.band_rows, capacity: self.capacity };
        if self.stage.as_ref().is_some_and(|s| s.shape == shape) {
            return Ok(());
        }
        let device = &self.device;
        let tiles = u64::from(grid.width.div_ceil(TILE)) * u64::from((shape.band_rows * grid.down).div_ceil(TILE));
        let stage = device.scoped(|| {
            use wgpu::BufferUsages as U;
            let uniforms = device.buffer("uniforms", 3 * u64::from(Uniforms::STRIDE), U::UNIFORM | U::COPY_DST);
            let codes = device.storage("codes", u64::from(grid.stride) * u64::from(shape.band_rows) * 4);
            let additions = device.storage("additions", grid.added * u64::from(shape.band_rows));
            let lists = Lists::new(device, &uniforms, &self.primitives, self.count.into(), tiles, shape.capacity);
            let buffers = [&lists.splats, &lists.starts, &lists.sorted, &lists.status, &codes, &additions];
            let render = device.kernels().render.bind(device.wgpu().0, &uniforms, &buffers);
            Canvas { shape, uniforms, codes, additions, lists, render }
        })?;
        self.stage = Some(stage);
        Ok(())
    }
}

/// Returns the maximum number of output rows of a band: whole rows of tiles of `tall` rows each whose codes fit into a
/// binding, or as many rows as additions are held for.
fn most_rows(base: &Uniforms, tall: u32, layer: Option<&Layer>) -> Result<u32> {
    let row = u64::from(base.stride) * u64::from(tall) * 4;
    let most = (MAX_BINDING / row).min(MAX_TILES / u64::from(base.tiles_x)) as u32 * tall;
    if most == 0 {
        let (what, requested) = ("bytes in a row of tiles", row);
        return Err(GpuError::Overflow { what, requested, allowed: MAX_BINDING }.into());
    }
    layer.map_or(Ok(most), |layer| Ok(most.min(layer.most_rows()?)))
}

/// Limits of the (Gaussian, tile) pairs of a view.
struct MaxPairs {
    pairs: u64,
    /// Work of all pairs.
    work: u64,
    /// Work of the pairs and the layer.
    all_work: u64,
    layer_work: u64,
}

impl MaxPairs {
    /// Returns the number of pairs that the limits allow.
    fn allowed(&self) -> u64 {
        self.pairs.min(self.work.min(self.all_work - self.layer_work) / PAIR_WORK)
    }

    /// # Errors
    /// [`Error::LimitExceeded`] if the limits do not allow this number of pairs.
    fn check(&self, pairs: u64) -> Result<()> {
        Limits::check(Limit::TilePairs, pairs, self.pairs)?;
        let work = pairs.saturating_mul(PAIR_WORK);
        Limits::check(Limit::Work, work, self.work)?;
        Limits::check(Limit::Work, work.saturating_add(self.layer_work), self.all_work)
    }
}
