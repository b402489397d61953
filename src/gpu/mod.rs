//! Drawing and fitting on a GPU, by way of `wgpu`: Vulkan, Metal, Direct3D 12 and the browser's WebGPU.
//!
//! Results are bit-identical from run to run on one device, and within one code value of the definition in
//! `raster/reference.rs`. Nothing here needs more than `wgpu::Limits::default()`; large pictures are drawn and fitted
//! in bands of rows. [`Limits`](crate::Limits) hold as on the CPU. Decode untrusted files on the CPU all the same: they
//! should not reach a GPU driver.
//!
//! ```no_run
//! use ssplat::gpu::{Adapters, Device, Renderer};
//! use ssplat::{Depth, Limits, Image};
//!
//! let opened = Image::from_bytes(&std::fs::read("photo.ssplat")?, &Limits::default())?;
//! let device = Device::open(Adapters::Hardware)?;
//! let mut renderer = Renderer::of(&device, &opened)?;
//! let pixels = renderer.render(&opened.view(), Depth::Eight)?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod device;
mod fit;
mod fitted;
mod kernels;
#[cfg(test)]
mod large;
mod layer;
mod lists;
mod peaks;
mod renderer;
mod scene;
mod source;
#[cfg(test)]
pub(crate) mod tests;
#[cfg(test)]
mod twin;
mod workspace;

pub use device::{Adapters, Device};
pub(crate) use fit::Fitter;
#[cfg(any(test, feature = "unstable"))]
pub use fitted::{Fitted, Look, fit};
pub use renderer::Renderer;
/// The crate that drives the device, in the version that [`Device::from_wgpu`] takes. A new minor version of this crate may
/// need a newer one.
pub use wgpu;
