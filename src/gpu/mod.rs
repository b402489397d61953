//! Rendering and fitting on a GPU through `wgpu`: Vulkan, Metal and Direct3D 12. Browsers are not supported: opening a
//! device and reading results are blocking calls.
//!
//! Results are bit-identical from run to run on one device, and within one code value of the definition in
//! `raster/reference.rs`. The module needs no more than `wgpu::Limits::default()`; large pictures are rendered and
//! fitted in bands of rows. [`Limits`](crate::Limits) apply as on the CPU. Decode files from untrusted sources on the
//! CPU nevertheless, because they should not reach a GPU driver.
//!
//! ```no_run
//! use ssplat::gpu::{Adapters, Device, Renderer};
//! use ssplat::{Depth, Limits, Reader};
//!
//! let opened = Reader::open("photo.ssplat", &Limits::default())?.read()?;
//! let device = Device::open(Adapters::Hardware)?;
//! let mut renderer = Renderer::of(&device, &opened)?;
//! let pixels = renderer.render(&opened.view(), Depth::Eight)?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod device;
mod fit;
#[cfg(test)]
#[path = "../../tests/internal/gpu/fits.rs"]
mod fit_tests;
#[cfg(any(test, feature = "unstable"))]
mod fitted;
mod kernels;
#[cfg(test)]
#[path = "../../tests/internal/gpu/large.rs"]
mod large;
mod layer;
mod lists;
mod peaks;
mod renderer;
mod scene;
mod source;
#[cfg(test)]
#[path = "../../tests/internal/gpu/kernels.rs"]
pub(crate) mod tests;
#[cfg(test)]
#[path = "../../tests/internal/gpu/twin/mod.rs"]
mod twin;
pub mod wgpu_30;
mod workspace;

pub use device::{Adapters, Device};
pub(crate) use fit::Fitter;
#[cfg(any(test, feature = "unstable"))]
pub use fitted::{Fitted, Look, fit};
pub use renderer::Renderer;
