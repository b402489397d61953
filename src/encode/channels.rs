//! Removes constant channels (opaque alpha, grey stored as RGB) before the fit, and restores them in the integers,
//! where the coded layout stores a constant in almost no bytes. The file keeps the caller's channels.

use super::skipped::SkipReason;
use crate::bitstream::splats::PackedSplats;
use crate::gaussian::{Blend, Channels};
use crate::pixels::{Pixels, Samples};

/// A picture without its constant channels.
#[derive(Debug)]
pub(super) struct Narrow {
    pub pixels: Pixels,
    /// The channels that were removed.
    pub removed: SkipReason,
}

/// Channels of a picture that are constant or follow from other channels.
#[derive(Debug, Clone, Copy)]
pub(super) struct ConstantChannels {
    grey: bool,
    opaque: bool,
}

impl ConstantChannels {
    /// Finds the constant channels of `pixels`.
    pub(super) fn of(pixels: &Pixels) -> Self {
        let channels = pixels.channels();
        let (grey, opaque) = match pixels.samples() {
            Samples::U8(v) => (is_grey(v, channels), is_opaque(v, channels, u8::MAX)),
            Samples::U16(v) => (is_grey(v, channels), is_opaque(v, channels, u16::MAX)),
        };
        ConstantChannels { grey, opaque }
    }

    /// Returns the channels that are constant in both parts.
    pub(super) fn and(self, other: Self) -> Self {
        ConstantChannels { grey: self.grey && other.grey, opaque: self.opaque && other.opaque }
    }

    /// Returns which channels of a picture of `channels` must be fitted, and the name of the others. Returns `None` if
    /// all must be fitted.
    pub(super) fn to_fit(self, channels: Channels) -> Option<(Channels, SkipReason)> {
        let color = channels.count() >= 3 && !self.grey;
        let alpha = channels.alpha().is_some() && !self.opaque;
        match (color, alpha) {
            (true, false) if channels == Channels::Rgba => Some((Channels::Rgb, SkipReason::Alpha)),
            (false, true) if channels == Channels::Rgba => Some((Channels::GreyAlpha, SkipReason::Color)),
            (false, false) if channels == Channels::Rgba => Some((Channels::Grey, SkipReason::ColorAndAlpha)),
            (false, false) if channels == Channels::Rgb => Some((Channels::Grey, SkipReason::Color)),
            (false, false) if channels == Channels::GreyAlpha => Some((Channels::Grey, SkipReason::Alpha)),
            _ => None,
        }
    }
}

/// Removes alpha if all pixels are opaque, and colour if all pixels are grey. Returns `None` if all channels are
/// needed.
pub(super) fn narrow(pixels: &Pixels) -> Option<Narrow> {
    let (to, removed) = ConstantChannels::of(pixels).to_fit(pixels.channels())?;
    Some(Narrow { pixels: narrowed(pixels, to), removed })
}

/// Returns `pixels` with only the channels of `to`.
pub(super) fn narrowed(pixels: &Pixels, to: Channels) -> Pixels {
    let samples = match pixels.samples() {
        Samples::U8(v) => Samples::U8(selected(v, pixels.channels(), to)),
        Samples::U16(v) => Samples::U16(selected(v, pixels.channels(), to)),
    };
    Pixels::new(pixels.width(), pixels.height(), to, samples).expect("as many samples as the size says")
}

fn is_grey<T: PartialEq>(samples: &[T], channels: Channels) -> bool {
    channels.count() < 3 || samples.chunks_exact(channels.count()).all(|p| p[0] == p[1] && p[1] == p[2])
}

fn is_opaque<T: PartialEq>(samples: &[T], channels: Channels, white: T) -> bool {
    channels.alpha().is_none_or(|a| samples.chunks_exact(channels.count()).all(|p| p[a] == white))
}

fn selected<T: Copy>(samples: &[T], from: Channels, to: Channels) -> Vec<T> {
    let pixels = samples.chunks_exact(from.count());
    pixels
        .flat_map(|p| (0..to.count()).map(move |k| if to.alpha() == Some(k) { p[from.count() - 1] } else { p[k] }))
        .collect()
}

/// Converts the integers of a narrow picture to those of `channels` with the same colours. Grey has no chroma, and
/// opaque alpha is the smallest integer whose value is at least 1.
pub(super) fn widen(splats: &PackedSplats, channels: Channels) -> PackedSplats {
    let from = splats.channels;
    let mut wide = PackedSplats { channels, ..splats.clone() };
    let opaque = (1.0 / wide.quantizer().color_steps()[3]).ceil() as i16;
    let put = |c: [i16; 4], opaque: i16| {
        let mut out = [0; 4];
        let colors = from.count() - usize::from(from.alpha().is_some());
        out[..colors].copy_from_slice(&c[..colors]);
        if let Some(a) = channels.alpha() {
            out[a] = from.alpha().map_or(opaque, |a| c[a]);
        }
        out
    };
    wide.background = put(splats.background, opaque);
    // With the sum blend, the background alone is already opaque.
    let each = match splats.blend {
        Blend::Normalized => opaque,
        Blend::Sum => 0,
    };
    for g in &mut wide.gaussians {
        g.color = put(g.color, each);
    }
    // The order of the colours does not change, because only constants are inserted.
    for c in wide.codebook.iter_mut().flatten() {
        *c = put(*c, each);
    }
    wide
}
