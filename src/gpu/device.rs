//! Selection and use of a GPU, and conversion of its failures to errors.

use std::sync::{Arc, Mutex, PoisonError};

use super::kernels::Kernels;
use crate::error::{Error, GpuError, Result};

/// Adapters that may be selected.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
pub enum Adapters {
    /// Hardware only.
    #[default]
    Hardware,
    /// Hardware, or a software renderer if there is no hardware. A software renderer is slower than this crate's CPU
    /// code.
    Any,
}

/// An opened GPU. Clones share the device.
#[derive(Debug, Clone)]
pub struct Device {
    inner: Arc<Inner>,
}

#[derive(Debug)]
struct Inner {
    device: wgpu::Device,
    queue: wgpu::Queue,
    kernels: Kernels,
    name: String,
    reason: String,
    software: bool,
    /// Reason for the loss of the device, once it is lost.
    lost: Arc<Mutex<Option<String>>>,
}

impl Device {
    /// Opens the best adapter: discrete GPUs before integrated before virtual ones, and software renderers last and
    /// only if allowed. The environment variables of `wgpu` (such as `WGPU_BACKEND`) restrict the choice.
    ///
    /// # Errors
    /// [`GpuError::NoAdapter`] if there is none, [`GpuError::SoftwareOnly`] if `adapters` excludes all of them,
    /// [`GpuError::Refused`] if the driver does not open the adapter.
    #[doc(alias = "adapter")]
    pub fn open(adapters: Adapters) -> Result<Self> {
        let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle_from_env());
        let mut found: Vec<(wgpu::Adapter, wgpu::AdapterInfo)> =
            pollster::block_on(instance.enumerate_adapters(wgpu::Backends::all()))
                .into_iter()
                .map(|a| {
                    let info = a.get_info();
                    (a, info)
                })
                .collect();
        // Equally ranked adapters keep the driver's order.
        found.sort_by_key(|(_, info)| rank(info.device_type));
        let names: Vec<String> = found.iter().map(|(_, info)| describe(info)).collect();
        let Some((adapter, info)) = found.into_iter().next() else {
            return Err(GpuError::NoAdapter.into());
        };
        let software = info.device_type == wgpu::DeviceType::Cpu;
        if software && adapters == Adapters::Hardware {
            return Err(GpuError::SoftwareOnly { name: info.name }.into());
        }
        let reason = match names.len() {
            1 => "the only adapter".to_owned(),
            n => format!("the first of {n} adapters: {}", names.join(", ")),
        };
        let request = wgpu::DeviceDescriptor { label: Some("ssplat"), ..Default::default() };
        let (device, queue) = pollster::block_on(adapter.request_device(&request))
            .map_err(|e| GpuError::Refused { problem: e.to_string() })?;
        // Ignore uncaptured errors; the next scope or poll reports them.
        device.on_uncaptured_error(Arc::new(|_| ()));
        Device::with(device, queue, names.into_iter().next().unwrap_or_default(), reason, software)
    }

    /// Uses a device that the program has opened.
    pub(super) fn from_wgpu(device: wgpu::Device, queue: wgpu::Queue) -> Result<Self> {
        let info = device.adapter_info();
        let software = info.device_type == wgpu::DeviceType::Cpu;
        Device::with(device, queue, describe(&info), "given by the program".to_owned(), software)
    }

    fn with(device: wgpu::Device, queue: wgpu::Queue, name: String, reason: String, software: bool) -> Result<Self> {
        let lost = Arc::new(Mutex::new(None));
        let note = Arc::clone(&lost);
        device.set_device_lost_callback(move |reason, message| {
            let mut lost = note.lock().unwrap_or_else(PoisonError::into_inner);
            lost.get_or_insert(format!("{reason:?}: {message}"));
        });
        let kernels = scoped(&device, || Kernels::new(&device))?;
        Ok(Device { inner: Arc::new(Inner { device, queue, kernels, name, reason, software, lost }) })
    }

    /// Returns the adapter's name, type and backend, such as `NVIDIA H100 (discrete, Vulkan)`.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.inner.name
    }

    /// Returns the reason for selecting this adapter.
    #[must_use]
    pub fn reason(&self) -> &str {
        &self.inner.reason
    }

    /// Returns whether the adapter is a software renderer.
    #[must_use]
    pub fn is_software(&self) -> bool {
        self.inner.software
    }

    /// Returns the device and its queue.
    pub(crate) fn wgpu(&self) -> (&wgpu::Device, &wgpu::Queue) {
        (&self.inner.device, &self.inner.queue)
    }

    pub(super) fn kernels(&self) -> &Kernels {
        &self.inner.kernels
    }

    /// Runs `work` and returns errors of the device during `work`.
    pub(super) fn scoped<T>(&self, work: impl FnOnce() -> T) -> Result<T> {
        let result = scoped(&self.inner.device, work);
        if result.is_err() {
            // A loss is reported once the work submitted before it is done. It causes all other failures.
            let _ = self.inner.device.poll(wgpu::PollType::wait_indefinitely());
        }
        self.check_lost()?;
        result
    }

    fn check_lost(&self) -> Result<()> {
        match &*self.inner.lost.lock().unwrap_or_else(PoisonError::into_inner) {
            Some(problem) => Err(GpuError::Lost { problem: problem.clone() }.into()),
            None => Ok(()),
        }
    }

    /// Waits until all submitted work is done.
    pub(super) fn wait(&self) -> Result<()> {
        let waited = self.inner.device.poll(wgpu::PollType::wait_indefinitely());
        self.check_lost()?;
        waited.map(|_| ()).map_err(|e| GpuError::Lost { problem: e.to_string() }.into())
    }

    /// Creates a buffer of `size` bytes, rounded up to a multiple of 4 and to one item of any type, because empty
    /// buffers cannot be bound.
    ///
    /// Call it within a scope, which reports running out of memory.
    pub(super) fn buffer(&self, label: &str, size: u64, usage: wgpu::BufferUsages) -> wgpu::Buffer {
        let size = size.next_multiple_of(4).max(64);
        self.inner.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            size,
            usage,
            mapped_at_creation: false,
        })
    }

    /// Creates a storage buffer that supports copying from and to it.
    pub(super) fn storage(&self, label: &str, size: u64) -> wgpu::Buffer {
        use wgpu::BufferUsages as U;
        self.buffer(label, size, U::STORAGE | U::COPY_DST | U::COPY_SRC)
    }

    /// Writes `data` to the start of `buffer`, before the next submission.
    pub(super) fn write<T: bytemuck::Pod>(&self, buffer: &wgpu::Buffer, data: &[T]) {
        if !data.is_empty() {
            self.inner.queue.write_buffer(buffer, 0, bytemuck::cast_slice(data));
        }
    }

    /// Reads the first `size` bytes of `buffer` (a multiple of 4), after all submitted work.
    pub(super) fn read(&self, buffer: &wgpu::Buffer, size: u64) -> Result<Vec<u8>> {
        if size == 0 {
            return Ok(Vec::new());
        }
        let (sender, receiver) = std::sync::mpsc::channel();
        let staging = self.scoped(|| {
            let staging = self.buffer("staging", size, wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST);
            let mut encoder = self.inner.device.create_command_encoder(&Default::default());
            encoder.copy_buffer_to_buffer(buffer, 0, &staging, 0, size);
            self.inner.queue.submit([encoder.finish()]);
            staging.map_async(wgpu::MapMode::Read, .., move |result| {
                // The receiver is gone only if this function has failed before.
                let _ = sender.send(result);
            });
            staging
        })?;
        self.wait()?;
        let lost = |problem: String| Error::from(GpuError::Lost { problem });
        receiver.recv().map_err(|e| lost(e.to_string()))?.map_err(|e| lost(e.to_string()))?;
        let view = staging.get_mapped_range(0..size).map_err(|e| lost(e.to_string()))?;
        Ok(view.to_vec())
    }

    /// Reads `count` values of type `T`, as [`Device::read`] does.
    pub(super) fn read_as<T: bytemuck::Pod>(&self, buffer: &wgpu::Buffer, count: usize) -> Result<Vec<T>> {
        Ok(bytemuck::pod_collect_to_vec(&self.read(buffer, (count * size_of::<T>()) as u64)?))
    }
}

fn rank(kind: wgpu::DeviceType) -> u8 {
    match kind {
        wgpu::DeviceType::DiscreteGpu => 0,
        wgpu::DeviceType::IntegratedGpu => 1,
        wgpu::DeviceType::VirtualGpu => 2,
        wgpu::DeviceType::Other => 3,
        wgpu::DeviceType::Cpu => 4,
    }
}

fn describe(info: &wgpu::AdapterInfo) -> String {
    let kind = match info.device_type {
        wgpu::DeviceType::DiscreteGpu => "discrete",
        wgpu::DeviceType::IntegratedGpu => "integrated",
        wgpu::DeviceType::VirtualGpu => "virtual",
        wgpu::DeviceType::Other => "of unknown kind",
        wgpu::DeviceType::Cpu => "software",
    };
    format!("{} ({kind}, {:?})", info.name, info.backend)
}

/// Runs `work` and converts errors that the device reports.
fn scoped<T>(device: &wgpu::Device, work: impl FnOnce() -> T) -> Result<T> {
    let memory = device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
    let internal = device.push_error_scope(wgpu::ErrorFilter::Internal);
    let validation = device.push_error_scope(wgpu::ErrorFilter::Validation);
    let result = work();
    let errors = [validation.pop(), internal.pop(), memory.pop()].map(pollster::block_on);
    cause(errors).map_or(Ok(result), |e| Err(e.into()))
}

/// Returns the error of one unit of work, from the errors of its scopes: validation, internal, memory.
pub(super) fn cause(errors: [Option<wgpu::Error>; 3]) -> Option<GpuError> {
    // Running out of memory makes later calls invalid, so it is the cause.
    errors.into_iter().flatten().next_back().map(|error| match error {
        wgpu::Error::OutOfMemory { source } => GpuError::OutOfMemory { problem: source.to_string() },
        wgpu::Error::Validation { description, .. } | wgpu::Error::Internal { description, .. } => {
            GpuError::Validation { problem: description }
        }
    })
}
