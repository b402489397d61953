//! Functions that take or return types of `wgpu` 30. No other public item of the crate has types of `wgpu`.
//!
//! This module is exempt from semantic versioning: a minor release that moves to another version of `wgpu` replaces it by
//! a module that is named after that version.

use super::{Device, Renderer};
use crate::error::Result;
use crate::raster::View;

pub use wgpu;

/// Uses a device that the program has opened, so that a [`Renderer`] can render into the program's buffers and textures.
/// The device needs no features, and the limits `wgpu::Limits::default()`.
///
/// # Errors
/// [`GpuError::Validation`](crate::GpuError::Validation) if a shader cannot be built on it.
pub fn device(device: wgpu::Device, queue: wgpu::Queue) -> Result<Device> {
    Device::from_wgpu(device, queue)
}

/// Returns the device and queue of `wgpu`, for programs that create their own buffers and textures.
#[must_use]
pub fn device_and_queue(device: &Device) -> (&wgpu::Device, &wgpu::Queue) {
    device.wgpu()
}

/// Renders `view` into `buffer` as red, green, blue and straight alpha, 8 bits each, row after row. The pixels stay on
/// the device.
///
/// # Errors
/// As [`Renderer::render`]; [`GpuError::Validation`](crate::GpuError::Validation) if the buffer is shorter than four
/// bytes per pixel, belongs to another device or does not allow copying to it.
pub fn render_to_buffer(renderer: &mut Renderer, view: &View, buffer: &wgpu::Buffer) -> Result<()> {
    renderer.render_to_buffer(view, buffer)
}

/// Renders `view` into the top left corner of `texture`, with straight alpha. The pixels stay on the device.
///
/// The texture must belong to the same `wgpu` device, allow copying to it (`COPY_DST`) and have one of the formats
/// `Rgba8Unorm`, `Rgba8UnormSrgb`, `Bgra8Unorm` and `Bgra8UnormSrgb`. Values are encoded sRGB, so that sampling the `Srgb`
/// formats returns linear light.
///
/// # Errors
/// As [`Renderer::render`]; [`Error::Parameter`](crate::Error::Parameter) for another format or a texture smaller than the
/// view.
pub fn render_to_texture(renderer: &mut Renderer, view: &View, texture: &wgpu::Texture) -> Result<()> {
    renderer.render_to_texture(view, texture)
}
