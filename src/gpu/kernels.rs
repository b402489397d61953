//! Builds the shaders as pipelines, with their bindings and their dispatch.

use super::scene::Uniforms;

/// Access of a shader to a storage buffer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Access {
    Read,
    Write,
}

use Access::{Read, Write};

/// A shader before it is built: everything that can be checked without a device.
#[derive(Debug, Clone, Copy)]
pub(super) struct Spec {
    /// The entry point; the file is named after the stage.
    pub entry: &'static str,
    /// Files that follow `common.wgsl`, in this order.
    pub parts: &'static [&'static str],
    /// Storage buffers at bindings 1, 2, …
    pub bindings: &'static [Access],
    /// Threads of a workgroup.
    pub threads: u32,
}

const COMMON: &str = include_str!("../../shaders/common.wgsl");
const SCAN: &str = include_str!("../../shaders/scan.wgsl");
const TILE: &str = include_str!("../../shaders/tile.wgsl");
const PIXEL: &str = include_str!("../../shaders/pixel.wgsl");
const PAIR: &str = include_str!("../../shaders/pair.wgsl");

impl Spec {
    /// Returns the complete shader source.
    pub(super) fn source(&self) -> String {
        std::iter::once(&COMMON).chain(self.parts).copied().collect::<Vec<_>>().join("\n")
    }
}

macro_rules! kernels {
    ($($(#[$doc:meta])* $name:ident: [$($part:expr),+], [$($access:expr),+], $threads:expr;)+) => {
        /// All pipelines, built once for a device.
        #[derive(Debug)]
        pub(super) struct Kernels {
            $($(#[$doc])* pub $name: Kernel,)+
        }

        impl Kernels {
            pub(super) const SPECS: &[Spec] = &[$(Spec {
                entry: stringify!($name),
                parts: &[$($part),+],
                bindings: &[$($access),+],
                threads: $threads,
            },)+];

            /// Builds all pipelines; call it within a scope.
            pub(super) fn new(device: &wgpu::Device) -> Self {
                let mut specs = Self::SPECS.iter();
                Kernels { $($name: Kernel::new(device, specs.next().expect("one for each")),)+ }
            }
        }
    };
}

kernels! {
    project: [include_str!("../../shaders/project.wgsl")], [Read, Write], 64;
    bin: [include_str!("../../shaders/bin.wgsl")], [Read, Write, Write, Write], 64;
    scan_sum: [SCAN], [Write, Write, Write, Write], 256;
    scan_top: [SCAN], [Write, Write, Write, Write], 256;
    scan_spread: [SCAN], [Write, Write, Write, Write], 256;
    sort: [include_str!("../../shaders/sort.wgsl")], [Read, Read, Write, Read], 64;
    render: [TILE, include_str!("../../shaders/render.wgsl")], [Read, Read, Read, Read, Write, Read], 256;
    forward: [TILE, PIXEL, include_str!("../../shaders/forward.wgsl")],
        [Read, Read, Read, Read, Read, Write, Write, Write], 256;
    backward: [PAIR, include_str!("../../shaders/backward.wgsl")], [Read, Read, Read, Read, Read, Read, Write], 64;
    importance: [PAIR, PIXEL, include_str!("../../shaders/importance.wgsl")],
        [Read, Read, Read, Read, Read, Read, Write, Read], 64;
    gather: [include_str!("../../shaders/gather.wgsl")], [Read, Read, Read, Read, Read, Write], 64;
    adam: [include_str!("../../shaders/adam.wgsl")], [Write, Read, Write, Write, Write], 64;
    residual: [PIXEL, include_str!("../../shaders/residual.wgsl")], [Read, Read, Write, Read], 64;
    blur: [include_str!("../../shaders/blur.wgsl")], [Read, Write], 64;
    halve: [include_str!("../../shaders/halve.wgsl")], [Read, Write], 64;
    find_peaks: [include_str!("../../shaders/peaks.wgsl")], [Read, Write, Write, Read], 64;
    relocate: [include_str!("../../shaders/relocate.wgsl")], [Read, Write, Write, Write], 64;
}

/// A pipeline.
#[derive(Debug)]
pub(super) struct Kernel {
    pipeline: wgpu::ComputePipeline,
    layout: wgpu::BindGroupLayout,
    entry: &'static str,
    threads: u32,
}

/// Maximum number of workgroups along a dimension that every device supports.
const MAX_GROUPS: u64 = 65_535;

impl Kernel {
    fn new(device: &wgpu::Device, spec: &Spec) -> Self {
        let entry = |binding: u32, ty: wgpu::BufferBindingType, dynamic: bool| wgpu::BindGroupLayoutEntry {
            binding,
            visibility: wgpu::ShaderStages::COMPUTE,
            ty: wgpu::BindingType::Buffer { ty, has_dynamic_offset: dynamic, min_binding_size: None },
            count: None,
        };
        let mut entries = vec![entry(0, wgpu::BufferBindingType::Uniform, true)];
        for (k, access) in spec.bindings.iter().enumerate() {
            let ty = wgpu::BufferBindingType::Storage { read_only: *access == Read };
            entries.push(entry(k as u32 + 1, ty, false));
        }
        let label = Some(spec.entry);
        let layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label, entries: &entries });
        let pipeline_layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label,
            bind_group_layouts: &[Some(&layout)],
            ..Default::default()
        });
        let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label,
            source: wgpu::ShaderSource::Wgsl(spec.source().into()),
        });
        let pipeline = device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label,
            layout: Some(&pipeline_layout),
            module: &module,
            entry_point: Some(spec.entry),
            compilation_options: Default::default(),
            cache: None,
        });
        Kernel { pipeline, layout, entry: spec.entry, threads: spec.threads }
    }

    /// Binds `uniforms` and the storage buffers in the order of the shader.
    pub(super) fn bind(
        &self,
        device: &wgpu::Device,
        uniforms: &wgpu::Buffer,
        buffers: &[&wgpu::Buffer],
    ) -> wgpu::BindGroup {
        let scene = wgpu::BufferBinding {
            buffer: uniforms,
            offset: 0,
            size: wgpu::BufferSize::new(size_of::<Uniforms>() as u64),
        };
        let mut entries = vec![wgpu::BindGroupEntry { binding: 0, resource: wgpu::BindingResource::Buffer(scene) }];
        for (k, buffer) in buffers.iter().enumerate() {
            entries.push(wgpu::BindGroupEntry { binding: k as u32 + 1, resource: buffer.as_entire_binding() });
        }
        device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(self.entry),
            layout: &self.layout,
            entries: &entries,
        })
    }

    /// Runs one thread for each of `count` items, with the uniforms at index `slot`.
    pub(super) fn each(&self, pass: &mut wgpu::ComputePass<'_>, bound: &wgpu::BindGroup, slot: u32, count: u64) {
        self.groups(pass, bound, slot, count.div_ceil(u64::from(self.threads)));
    }

    /// Runs `groups` workgroups.
    pub(super) fn groups(&self, pass: &mut wgpu::ComputePass<'_>, bound: &wgpu::BindGroup, slot: u32, groups: u64) {
        if groups == 0 {
            return;
        }
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, bound, &[slot * Uniforms::STRIDE]);
        let [x, y] = fold(groups);
        pass.dispatch_workgroups(x, y, 1);
    }
}

/// Returns a two-dimensional dispatch of at least `groups` workgroups.
pub(super) fn fold(groups: u64) -> [u32; 2] {
    let rows = groups.div_ceil(MAX_GROUPS);
    [groups.div_ceil(rows) as u32, rows as u32]
}
