//! SSIMULACRA2, a perceptual measure of the difference between two pictures.

#[cfg(feature = "quality")]
mod computed;
mod measurable;
#[cfg(any(test, not(feature = "quality")))]
#[cfg_attr(
    any(test, not(feature = "unstable")),
    allow(
        dead_code,
        reason = "only `unstable` exports the function that provides a score, and only without `quality`"
    )
)]
mod provided;

#[cfg(feature = "quality")]
pub(crate) use computed::Reference;
#[cfg(all(feature = "quality", any(test, feature = "unstable")))]
pub use computed::linear_light;
#[cfg(feature = "quality")]
pub use computed::ssimulacra2;
#[cfg(all(not(feature = "quality"), feature = "unstable"))]
pub use provided::provide_score;
#[cfg(not(feature = "quality"))]
pub(crate) use provided::{Reference, is_provided, ssimulacra2};

/// Returns whether this program measures scores.
#[cfg(feature = "quality")]
pub(crate) fn is_provided() -> bool {
    true
}
