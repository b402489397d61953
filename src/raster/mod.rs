//! Renders Gaussians to pixels, within one 8-bit code value of [`mod@reference`] (spec §5). It does not know the file
//! format.
//!
//! A [`View`] selects the area to render and the size of the output; a [`Renderer`] renders it. The output is
//! bit-identical for any number of threads, any instruction set and any division of a view into parts: tiles are
//! anchored to the view's grid, and nothing that is computed for a tile depends on what is rendered around it.
//!
//! ```
//! use ssplat::{Blend, Channels, Depth, Gaussian, Gaussians, Limits, Rect, Renderer, View};
//!
//! let picture = Gaussians {
//!     width: 64,
//!     height: 48,
//!     channels: Channels::Rgb,
//!     depth: Depth::Eight,
//!     blend: Blend::Normalized,
//!     background: [0.5, 0.5, 0.5, 0.0],
//!     list: vec![Gaussian { mean: [32.0, 24.0], scale: [9.0, 3.0], rotation: 0.5, color: [1.0, 0.2, 0.0, 0.0] }],
//! };
//! let whole = View::new(picture.width, picture.height);
//! let region = whole.crop(Rect::new(16, 8, 32, 32))?;
//! let pixels = Renderer::new(&picture, &region, &Limits::default())?.render(Depth::Eight)?;
//! assert_eq!((pixels.width(), pixels.height()), (32, 32));
//! # Ok::<(), ssplat::Error>(())
//! ```

mod bins;
mod exact;
mod kernel;
mod overlay;
mod project;
#[cfg(any(test, feature = "unstable"))]
pub mod reference;
mod renderer;
mod samples;
mod view;

pub(crate) use exact::ExactOverlay;
#[cfg(feature = "gpu")]
pub(crate) use overlay::Additions;
pub(crate) use overlay::Overlay;
pub(crate) use renderer::Canvas;
pub use renderer::Renderer;
pub use samples::SamplesMut;
pub use view::View;
