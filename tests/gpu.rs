//! Compares the GPU with the definition and with the CPU, through the public interface only.
//!
//! Any adapter is suitable, including software renderers. Without an adapter these tests are ignored, or fail with
//! `SSPLAT_REQUIRE_GPU=1`.

mod adapter;
mod scenes;
mod synthetic;
mod waves;

use scenes::{codes, scene};
use ssplat::View;
use ssplat::gpu::{Adapters, Device, Renderer, wgpu_30};
use ssplat::unstable::EncodeOptions;
use ssplat::unstable::bitstream::{DetailHead, to_bytes};
use ssplat::unstable::raster::reference;
use ssplat::{
    Backend, Blend, Channels, Depth, Detail, Error, Gaussian, Gaussians, GpuError, Layers, Limit, Limits, Parameter,
    Pixels, Reader, Rect, Samples, SsplatImage, Target, Tune,
};
use std::ops::ControlFlow;

fn main() {
    adapter::run(&[
        ("renders_are_within_one_code_value_of_the_definition", renders_are_within_one_code_value),
        ("sixteen_bits_are_as_near_as_floats_are", sixteen_bits),
        ("needles_of_the_encoder_are_within_one_code_value", needles),
        ("regions_and_sizes_are_those_of_the_cpu", regions_and_sizes),
        ("reduced_views_are_low_passed_as_on_the_cpu", reduced),
        ("files_of_two_layers_are_drawn_as_on_the_cpu", two_layers),
        ("a_layer_costs_rows_of_memory_and_its_work", layers_within_limits),
        ("a_part_that_was_read_is_all_that_is_drawn", parts),
        ("a_second_run_gives_the_same_bits", same_bits),
        ("bands_give_the_same_bits_as_one", bands),
        ("textures_and_buffers_hold_the_same_codes", textures_and_buffers),
        ("a_picture_without_primitives_is_its_background", empty),
        ("bad_primitives_are_the_callers_fault", bad_primitives),
        ("limits_hold_on_the_gpu", limits),
        ("hardware_only_never_opens_software", hardware_only),
        ("a_lost_device_is_a_typed_error", lost),
        ("an_encoder_asked_for_the_gpu_uses_it_or_fails", encoder),
        ("tiles_are_fitted_on_the_gpu_as_well_as_on_the_cpu", tiles),
    ]);
}

fn encoder(device: &Device) {
    let pixels: Vec<u8> = (0..48 * 40 * 3).map(|i| (i * 7 % 251) as u8).collect();
    let pixels = Pixels::new(48, 40, Channels::Rgb, Samples::U8(pixels)).unwrap();
    let mut options = EncodeOptions::default();
    (options.target, options.effort, options.backend) = (Target::Gaussians(40), 2, Backend::Gpu);
    let encoded = ssplat::unstable::encode(&pixels, &options).unwrap();
    let chosen = &encoded.report.chosen;
    assert_eq!((chosen.backend, &*chosen.device), (Backend::Gpu, device.name()), "{chosen}");
    // On the CPU, three seeds reach 20.5, 22.1 and 22.6 dB, and the mean colour alone 10.9. The margin is 2.5 dB.
    assert!(encoded.report.gaussians > 30 && encoded.report.psnr > 18.0, "{:?}", encoded.report);
    assert_eq!(ssplat::unstable::encode(&pixels, &options).unwrap().bytes, encoded.bytes, "a second run");
    options.tune = Some(Tune::Psnr);
    let tuned = ssplat::unstable::encode(&pixels, &options).unwrap();
    assert_eq!(tuned.report.chosen.backend, Backend::Gpu);
    assert_ne!(tuned.bytes, encoded.bytes, "all errors weigh as by default");
}

fn tiles(device: &Device) {
    // Two tiles, because software Vulkan takes half a minute for each fit of a tile.
    let pixels = waves::picture(200, 100, Channels::Rgb);
    // One of the two is encoded twice, to compare its bytes.
    for (target, detail, is_repeated) in
        [(Target::Bytes(330), Detail::Off, false), (Target::Bytes(720), Detail::GaussianShare(0.5), true)]
    {
        let mut options = EncodeOptions::default();
        (options.target, options.effort, options.tiles, options.detail) = (target, 2, Some(128), detail);
        let [gpu, cpu] = [Backend::Gpu, Backend::Cpu].map(|backend| {
            options.backend = backend;
            ssplat::unstable::encode(&pixels, &options).unwrap()
        });
        let chosen = &gpu.report.chosen;
        assert_eq!((chosen.backend, &*chosen.device), (Backend::Gpu, device.name()), "{chosen}");
        assert_eq!(cpu.report.chosen.backend, Backend::Cpu);
        assert_ne!(gpu.bytes, cpu.bytes, "{detail:?}");
        options.backend = Backend::Gpu;
        if is_repeated {
            assert_eq!(ssplat::unstable::encode(&pixels, &options).unwrap().bytes, gpu.bytes, "a second run");
        }
        let difference = gpu.report.psnr - cpu.report.psnr;
        eprintln!("{detail:?}: CPU {:.2} dB, GPU {difference:+.2}", cpu.report.psnr);
        // Single fits of as many primitives scatter by 0.2 dB.
        assert!(difference.abs() < 0.5, "{detail:?}: {difference}");
    }
}

fn render(device: &Device, picture: &Gaussians, view: &View, depth: Depth) -> Vec<u16> {
    let mut renderer = Renderer::new(device, picture, &Limits::default()).unwrap();
    codes(renderer.render(view, depth).unwrap().into_samples())
}

/// Returns the largest difference to the definition, in code values.
fn worst(device: &Device, picture: &Gaussians, view: &View, depth: Depth) -> u16 {
    let want = reference::filtered(picture, view);
    let drawn = render(device, picture, view, depth);
    assert_eq!(drawn.len(), want.len());
    let (count, alpha) = (picture.channels.count(), picture.channels.alpha());
    let is_reduced = view.step().iter().any(|&step| step > 1.0);
    let off = |(i, &d): (usize, &u16)| {
        let off = d.abs_diff(reference::code(want[i], depth));
        // In a reduced view, the tolerance for colours of nearly transparent pixels is larger.
        let alpha = alpha.filter(|&k| is_reduced && k != i % count).map_or(1.0, |k| want[i - i % count + k]);
        (f64::from(off) * (16.0 * alpha).min(1.0)).ceil() as u16
    };
    drawn.iter().enumerate().map(off).max().unwrap_or(0)
}

fn renders_are_within_one_code_value(device: &Device) {
    for channels in [Channels::Grey, Channels::GreyAlpha, Channels::Rgb, Channels::Rgba] {
        for blend in [Blend::Normalized, Blend::Sum] {
            let picture = scene(100, 75, 250, channels, blend, 1);
            let worst = worst(device, &picture, &View::new(picture.width, picture.height), Depth::Eight);
            assert!(worst <= 1, "{channels:?} {blend:?}: {worst}");
        }
    }
}

/// Tolerance for f32 in 16-bit code values: an eighth of an 8-bit code value. Where the weights vanish, the division
/// amplifies errors of f32.
const TOLERANCE_16_BIT: u16 = 32;

fn sixteen_bits(device: &Device) {
    let picture = scene(61, 83, 200, Channels::Rgba, Blend::Normalized, 1);
    let worst = worst(device, &picture, &View::new(picture.width, picture.height), Depth::Sixteen);
    assert!(worst <= TOLERANCE_16_BIT, "{worst}");
}

fn needles(device: &Device) {
    for blend in [Blend::Normalized, Blend::Sum] {
        let mut picture = scene(120, 90, 60, Channels::Rgb, blend, 1);
        for g in &mut picture.list {
            // The maximum aspect of the encoder.
            g.scale = [60.0, 0.6];
        }
        let worst = worst(device, &picture, &View::new(picture.width, picture.height), Depth::Eight);
        assert!(worst <= 1, "{blend:?}: {worst}");
    }
}

fn regions_and_sizes(device: &Device) {
    let picture = scene(160, 110, 400, Channels::Rgb, Blend::Normalized, 1);
    let full = View::new(picture.width, picture.height);
    let region = full.crop(Rect::new(37, 21, 90, 70)).unwrap();
    let views = [
        region,
        full.resized(333, 229).unwrap(),
        region.resized(400, 311).unwrap().crop(Rect::new(111, 99, 128, 65)).unwrap(),
    ];
    for view in views {
        let cpu = ssplat::Renderer::new(&picture, &view, &Limits::default()).unwrap();
        let cpu = codes(cpu.render(Depth::Eight).unwrap().into_samples());
        let gpu = render(device, &picture, &view, Depth::Eight);
        // Each is within one of the definition.
        let worst = cpu.iter().zip(&gpu).map(|(a, b)| a.abs_diff(*b)).max().unwrap();
        assert!(worst <= 1, "{view:?}: {worst}");
    }
}

fn reduced(device: &Device) {
    let mut picture = scene(160, 110, 400, Channels::Rgb, Blend::Normalized, 1);
    for g in &mut picture.list[..20] {
        // The maximum aspect of the encoder; the variance that the low-pass filter adds to one axis hides the last
        // digits of the other.
        g.scale = [60.0, 0.6];
    }
    let full = View::new(picture.width, picture.height);
    let reduced = |view: View, width, height| view.resized(width, height).unwrap();
    let region = full.crop(Rect::new(37, 21, 90, 70)).unwrap();
    for (view, of) in [
        (reduced(full, 80, 55), "half"),
        (reduced(full, 97, 71), "not a whole number of pixels"),
        (reduced(full, 33, 21), "four samples and five pixels"),
        // 8 samples per side, 2.5 pixels apart, with a low-pass filter for the detail between them.
        (reduced(full, 8, 5), "a twentieth"),
        (reduced(full, 1, 1), "one pixel"),
        (reduced(full, 160, 6), "one axis"),
        (reduced(full, 9, 200), "one axis, the other enlarged"),
        (reduced(region, 43, 29).crop(Rect::new(3, 5, 37, 20)).unwrap(), "a crop of a region"),
    ] {
        for (blend, channels) in
            [(Blend::Normalized, Channels::Rgb), (Blend::Sum, Channels::Rgb), (Blend::Normalized, Channels::Rgba)]
        {
            (picture.blend, picture.channels) = (blend, channels);
            for (depth, most) in [(Depth::Eight, 1), (Depth::Sixteen, TOLERANCE_16_BIT)] {
                let worst = worst(device, &picture, &view, depth);
                assert!(worst <= most, "{of}, {blend:?}, {channels:?}, {depth:?}: {worst}");
            }
        }
    }
}

/// A file with levels in most blocks of its detail layer.
fn layered(channels: Channels, depth: Depth, blend: Blend, size: [u32; 2]) -> Vec<u8> {
    use synthetic::{Levels, Scene, scene, with_layer};
    let mut head = DetailHead::SEEN;
    (head.step, head.alpha) = (700, channels.alpha().is_some());
    let mut ground = scene(&Scene { channels, size, count: 400, seed: 71, ..Scene::default() });
    (ground.depth, ground.blend) = (depth, blend);
    to_bytes(&with_layer(ground, head, Levels::new(71))).unwrap()
}

fn opened(bytes: &[u8]) -> SsplatImage {
    Reader::new(bytes, &Limits::default()).unwrap().read().unwrap()
}

/// Returns the largest difference between the GPU's and the CPU's rendering of `view`, in code values, and whether the
/// layer is visible in it.
fn apart(device: &Device, opened: &SsplatImage, view: &View) -> (u16, bool) {
    let draw = |view: &View| codes(opened.render(view).unwrap().into_samples());
    let cpu = draw(view);
    let depth = opened.splats().depth;
    let (count, alpha) = (opened.splats().channels.count(), opened.splats().channels.alpha());
    let gpu = codes(Renderer::of(device, opened).unwrap().render(view, depth).unwrap().into_samples());
    assert_eq!(cpu.len(), gpu.len());
    let alone = draw(&view.layers(Layers::Gaussians));
    let is_reduced = view.step().iter().any(|&step| step > 1.0);
    let off = |(i, (a, b)): (usize, (&u16, &u16))| {
        // In a reduced view, the tolerance for colours of nearly transparent pixels is larger.
        let alpha = alpha.filter(|&k| is_reduced && k != i % count);
        let share = alpha.map_or(1.0, |k| f64::from(alone[i - i % count + k]) / f64::from(depth.max()));
        (f64::from(a.abs_diff(*b)) * (16.0 * share).min(1.0)).ceil() as u16
    };
    (cpu.iter().zip(&gpu).enumerate().map(off).max().unwrap(), alone != cpu)
}

fn two_layers(device: &Device) {
    // 256 rows of additions at a time, between edges of tiles; the second picture is twice as wide as that.
    let sizes = [[530, 300], [1100, 600]];
    let full = View::new(530, 300);
    let region = full.crop(Rect::new(201, 150, 300, 140)).unwrap();
    let resized = |view: View, width, height| view.resized(width, height).unwrap();
    let views = [
        (full, "whole"),
        (region, "a region across edges of tiles"),
        (resized(full, 265, 150), "half"),
        (resized(full, 97, 41), "not a whole number of pixels"),
        (resized(full, 11, 7), "samples far apart"),
        (resized(full, 777, 431), "enlarged"),
        (resized(full, 61, 700), "reduced along one axis, enlarged along the other"),
        (resized(region, 500, 211).crop(Rect::new(100, 50, 300, 100)).unwrap(), "a crop of a region"),
    ];
    for (channels, depth, blend) in [
        (Channels::Rgb, Depth::Eight, Blend::Normalized),
        (Channels::Rgba, Depth::Eight, Blend::Sum),
        (Channels::Grey, Depth::Sixteen, Blend::Sum),
        (Channels::GreyAlpha, Depth::Sixteen, Blend::Normalized),
    ] {
        let bytes = layered(channels, depth, blend, sizes[0]);
        // Each is within so much of the definition.
        let most = if depth == Depth::Eight { 1 } else { 2 * TOLERANCE_16_BIT };
        for (view, of) in &views {
            for layers in [Layers::Both, Layers::Detail] {
                let (off, is_seen) = apart(device, &opened(&bytes), &view.layers(layers));
                assert!(off <= most && is_seen, "{of}, {channels:?}, {depth:?}, {blend:?}, {layers:?}: {off}");
            }
            let (off, is_seen) = apart(device, &opened(&bytes), &view.layers(Layers::Gaussians));
            assert!(off <= most && !is_seen, "{of}, Gaussians alone: {off}");
        }
    }
    let bytes = layered(Channels::Rgba, Depth::Eight, Blend::Normalized, sizes[1]);
    let full = View::new(1100, 600);
    for view in [full, full.crop(Rect::new(30, 100, 1000, 480)).unwrap(), resized(full, 1000, 700)] {
        let (off, is_seen) = apart(device, &opened(&bytes), &view);
        assert!(off <= 1 && is_seen, "{view:?}: {off}");
    }
    let mut renderer = Renderer::of(device, &opened(&bytes)).unwrap();
    let whole = codes(renderer.render(&full, Depth::Eight).unwrap().into_samples());
    assert_eq!(renderer.bands().0, 256, "rows of a band");
    // One renderer renders one view after the other.
    let part =
        codes(renderer.render(&full.crop(Rect::new(0, 250, 1100, 9)).unwrap(), Depth::Eight).unwrap().into_samples());
    assert!(part == whole[250 * 4400..259 * 4400]);
}

fn layers_within_limits(device: &Device) {
    let bytes = layered(Channels::Rgb, Depth::Eight, Blend::Normalized, [530, 300]);
    let view = View::new(530, 300);
    for (layers, is_refused) in [(Layers::Both, true), (Layers::Gaussians, false)] {
        let view = view.layers(layers);
        let mut file = opened(&bytes);
        // Enough for the pixels and the integers, but not for the additions to 300 rows.
        file.limit_alloc(2_500_000).unwrap();
        let drawn = Renderer::of(device, &file).unwrap().render(&view, Depth::Eight);
        let refused = matches!(drawn, Err(Error::LimitExceeded { limit: Limit::Alloc, .. }));
        assert!(refused == is_refused && drawn.is_ok() != is_refused, "{layers:?}: {drawn:?}");
        // Less than the layer needs, but more than the Gaussians need.
        let mut limits = Limits::default();
        limits.work = 1 << 27;
        let file = Reader::new(&bytes, &limits).unwrap().read().unwrap();
        let drawn = Renderer::of(device, &file).unwrap().render(&view, Depth::Eight);
        let refused = matches!(drawn, Err(Error::LimitExceeded { limit: Limit::Work, .. }));
        assert!(refused == is_refused && drawn.is_ok() != is_refused, "{layers:?}: {drawn:?}");
    }
}

fn parts(device: &Device) {
    let bytes = layered(Channels::Rgb, Depth::Eight, Blend::Normalized, [530, 300]);
    let whole = View::new(530, 300);
    let region = whole.crop(Rect::new(10, 20, 100, 50)).unwrap();
    let file = Reader::new(&bytes, &Limits::default()).unwrap().read_for(&region).unwrap();
    let mut renderer = Renderer::of(device, &file).unwrap();
    renderer.render(&region, Depth::Eight).unwrap();
    let refused = renderer.render(&whole, Depth::Eight);
    assert!(matches!(refused, Err(Error::Parameter { parameter: Parameter::View, .. })), "{refused:?}");
}

fn same_bits(device: &Device) {
    let picture = scene(128, 128, 1500, Channels::Rgb, Blend::Normalized, 1);
    let view = View::new(picture.width, picture.height);
    let mut renderer = Renderer::new(device, &picture, &Limits::default()).unwrap();
    let first = renderer.render(&view, Depth::Sixteen).unwrap();
    for _ in 0..3 {
        assert_eq!(renderer.render(&view, Depth::Sixteen).unwrap(), first);
    }
    assert_eq!(render(device, &picture, &view, Depth::Sixteen), codes(first.into_samples()));
}

fn bands(device: &Device) {
    // A row of 16-bit codes takes 8 bytes per pixel, so that 16 rows of a megapixel each fill a binding. Without and
    // with two rows of samples per output row.
    for height in [20, 40] {
        let picture = scene(1 << 20, height, 40, Channels::Grey, Blend::Sum, 1);
        let view = View::new(picture.width, picture.height).resized(1 << 20, 20).unwrap();
        let mut renderer = Renderer::new(device, &picture, &Limits::default()).unwrap();
        let whole = codes(renderer.render(&view, Depth::Sixteen).unwrap().into_samples());
        assert_eq!(renderer.bands().0, 16, "rows of a band");
        let part = render(device, &picture, &view.crop(Rect::new(0, 10, 4096, 10)).unwrap(), Depth::Sixteen);
        let row = 1 << 20;
        let same = (0..10)
            .all(|y| part[y * 4096..][..4096].iter().zip(&whole[(y + 10) * row..]).all(|(a, b)| a.abs_diff(*b) <= 1));
        assert!(same, "{height}");
    }
}

fn textures_and_buffers(device: &Device) {
    let picture = scene(70, 40, 120, Channels::GreyAlpha, Blend::Normalized, 1);
    let view = View::new(picture.width, picture.height);
    let (d, queue) = wgpu_30::device_and_queue(device);
    let mut renderer = Renderer::new(device, &picture, &Limits::default()).unwrap();
    let want: Vec<u8> = codes(renderer.render(&view, Depth::Eight).unwrap().into_samples())
        .chunks_exact(2)
        .flat_map(|p| [p[0] as u8, p[0] as u8, p[0] as u8, p[1] as u8])
        .collect();
    let usage = wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::COPY_SRC;
    let buffer =
        |size| d.create_buffer(&wgpu::BufferDescriptor { label: None, size, usage, mapped_at_creation: false });
    let plain = buffer(70 * 40 * 4);
    wgpu_30::render_to_buffer(&mut renderer, &view, &plain).unwrap();
    assert_eq!(read(device, &plain), want);
    for format in [wgpu::TextureFormat::Rgba8UnormSrgb, wgpu::TextureFormat::Bgra8Unorm] {
        let texture = d.create_texture(&wgpu::TextureDescriptor {
            label: None,
            size: wgpu::Extent3d { width: 80, height: 40, depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format,
            usage: wgpu::TextureUsages::COPY_DST | wgpu::TextureUsages::COPY_SRC,
            view_formats: &[],
        });
        wgpu_30::render_to_texture(&mut renderer, &view, &texture).unwrap();
        let copy = buffer(512 * 40);
        let mut encoder = d.create_command_encoder(&Default::default());
        encoder.copy_texture_to_buffer(
            texture.as_image_copy(),
            wgpu::TexelCopyBufferInfo {
                buffer: &copy,
                layout: wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(512), rows_per_image: None },
            },
            wgpu::Extent3d { width: 80, height: 40, depth_or_array_layers: 1 },
        );
        queue.submit([encoder.finish()]);
        let bytes = read(device, &copy);
        for (row, want) in bytes.chunks_exact(512).zip(want.chunks_exact(280)) {
            for (p, w) in row.chunks_exact(4).zip(want.chunks_exact(4)) {
                let swapped = [w[2], w[1], w[0], w[3]];
                assert_eq!(p, if format == wgpu::TextureFormat::Bgra8Unorm { &swapped[..] } else { w });
            }
        }
    }
    let small = buffer(16);
    assert!(matches!(
        wgpu_30::render_to_buffer(&mut renderer, &view, &small),
        Err(Error::Gpu(GpuError::Validation { .. }))
    ));
    // The device still works after a refused call.
    wgpu_30::render_to_buffer(&mut renderer, &view, &plain).unwrap();
}

fn read(device: &Device, buffer: &wgpu::Buffer) -> Vec<u8> {
    let (d, queue) = wgpu_30::device_and_queue(device);
    let (sender, receiver) = std::sync::mpsc::channel();
    wgpu::util::DownloadBuffer::read_buffer(d, queue, &buffer.slice(..), move |r| {
        sender.send(r.unwrap().to_vec()).unwrap()
    });
    d.poll(wgpu::PollType::wait_indefinitely()).unwrap();
    receiver.recv().unwrap()
}

fn empty(device: &Device) {
    let mut picture = scene(20, 20, 1, Channels::Rgb, Blend::Normalized, 1);
    picture.list.clear();
    assert_eq!(render(device, &picture, &View::new(picture.width, picture.height), Depth::Eight)[..3], [102, 179, 51]);
}

fn bad_primitives(device: &Device) {
    let picture = scene(20, 20, 3, Channels::Rgb, Blend::Normalized, 1);
    let spoil: [fn(&mut Gaussian); 4] = [
        |g| g.mean[0] = f32::NAN,
        |g| g.scale[1] = 0.0,
        |g| g.scale[0] = f32::INFINITY,
        |g| g.color[2] = f32::NEG_INFINITY,
    ];
    for spoil in spoil {
        let mut picture = picture.clone();
        spoil(&mut picture.list[1]);
        let made = Renderer::new(device, &picture, &Limits::default());
        assert!(matches!(made, Err(Error::Parameter { parameter: Parameter::Gaussians, .. })), "{made:?}");
    }
}

fn limits(device: &Device) {
    let picture = scene(128, 128, 300, Channels::Rgb, Blend::Normalized, 1);
    let mut limits = Limits::default();
    limits.gaussians = 299;
    assert!(matches!(
        Renderer::new(device, &picture, &limits),
        Err(Error::LimitExceeded { limit: Limit::Gaussians, .. })
    ));
    let mut limits = Limits::default();
    limits.tile_pairs = 300;
    let drawn = Renderer::new(device, &picture, &limits)
        .unwrap()
        .render(&View::new(picture.width, picture.height), Depth::Eight);
    assert!(matches!(drawn, Err(Error::LimitExceeded { limit: Limit::TilePairs, .. })), "{drawn:?}");
    // The 256 pixels of each pair count, in all bands together. With a limit one below the total, the last band is not
    // rendered.
    let view = View::new(picture.width, picture.height);
    let within = |work: u64| {
        let mut limits = Limits::default();
        limits.work = work;
        Renderer::new(device, &picture, &limits).unwrap().render(&view, Depth::Eight)
    };
    let (mut refused, mut enough) = (0, 1 << 37);
    while enough - refused > 1 {
        let work = (refused + enough) / 2;
        match within(work) {
            Ok(_) => enough = work,
            Err(Error::LimitExceeded { limit: Limit::Work, requested, allowed }) => {
                assert!(requested > allowed && allowed == work, "{requested} of {allowed}");
                refused = work;
            }
            Err(e) => panic!("{e}"),
        }
    }
    assert_eq!(enough % 256, 0);
    let unlimited = Renderer::new(device, &picture, &Limits::default()).unwrap().render(&view, Depth::Eight);
    assert_eq!(within(enough).unwrap(), unlimited.unwrap());
    let mut limits = Limits::default();
    limits.alloc = 128 * 128 * 3 - 1;
    let drawn = Renderer::new(device, &picture, &limits)
        .unwrap()
        .render(&View::new(picture.width, picture.height), Depth::Eight);
    assert!(matches!(drawn, Err(Error::LimitExceeded { limit: Limit::Alloc, .. })), "{drawn:?}");
}

fn hardware_only(device: &Device) {
    match Device::open(Adapters::Hardware) {
        Ok(opened) => assert!(!opened.is_software()),
        Err(e) => {
            assert!(device.is_software());
            assert!(matches!(e, Error::Gpu(GpuError::SoftwareOnly { .. })), "{e}");
        }
    }
}

fn lost(_: &Device) {
    // A separate device, because a lost one cannot be recovered.
    let device = Device::open(Adapters::Any).unwrap();
    let picture = scene(32, 32, 30, Channels::Rgb, Blend::Normalized, 1);
    let mut renderer = Renderer::new(&device, &picture, &Limits::default()).unwrap();
    wgpu_30::device_and_queue(&device).0.destroy();
    let drawn = renderer.render(&View::new(picture.width, picture.height), Depth::Eight);
    assert!(matches!(drawn, Err(Error::Gpu(GpuError::Lost { .. }))), "{drawn:?}");
    // During a fit.
    let device = Device::open(Adapters::Any).unwrap();
    let pixels = Pixels::new(48, 40, Channels::Grey, Samples::U8((0..48 * 40).map(|i| (i % 251) as u8).collect()));
    let fitted = ssplat::gpu::fit(&device, &pixels.unwrap(), Blend::Normalized, 40, 60, 0, &mut |look| {
        if look.step() == 30 {
            wgpu_30::device_and_queue(&device).0.destroy();
        }
        Ok(ControlFlow::Continue(()))
    });
    assert!(matches!(fitted, Err(Error::Gpu(GpuError::Lost { .. }))), "{fitted:?}");
}
