//! A picture that is read in parts, without its constant channels.

use super::grid::Window;
use crate::encode::channels::{ConstantChannels, narrowed};
use crate::encode::skipped::SkipReason;
use crate::error::Result;
use crate::gaussian::Channels;
use crate::pixel_source::PixelSource;
use crate::pixels::{Depth, Pixels};
use crate::rect::Rect;

/// A picture with only some of its channels.
pub(super) struct Narrowed<'a> {
    source: &'a dyn PixelSource,
    channels: Channels,
}

impl<'a> Narrowed<'a> {
    /// Reads `tiles`, which together cover the picture of `source`, until no channel can be constant any more. Returns
    /// the picture without its constant channels, and the name of these channels, if there are any. Calls `on_progress`
    /// for each tile.
    pub(super) fn new(
        source: &'a dyn PixelSource,
        tiles: &[Window],
        mut on_progress: impl FnMut() -> Result<()>,
    ) -> Result<(Self, Option<SkipReason>)> {
        let all = source.channels();
        let mut constant: Option<ConstantChannels> = None;
        for tile in tiles {
            let to_fit = |constant: ConstantChannels| constant.to_fit(all);
            if all == Channels::Grey || constant.is_some_and(|s| to_fit(s).is_none()) {
                break;
            }
            on_progress()?;
            let found = ConstantChannels::of(&source.part(tile.core.bounds())?);
            constant = Some(constant.map_or(found, |s| s.and(found)));
        }
        let (channels, removed) = match constant.and_then(|s| s.to_fit(all)) {
            Some((channels, removed)) => (channels, Some(removed)),
            None => (all, None),
        };
        Ok((Narrowed { source, channels }, removed))
    }
}

impl PixelSource for Narrowed<'_> {
    fn width(&self) -> u32 {
        self.source.width()
    }

    fn height(&self) -> u32 {
        self.source.height()
    }

    fn channels(&self) -> Channels {
        self.channels
    }

    fn depth(&self) -> Depth {
        self.source.depth()
    }

    fn part(&self, area: Rect) -> Result<Pixels> {
        let pixels = self.source.part(area)?;
        Ok(if pixels.channels() == self.channels { pixels } else { narrowed(&pixels, self.channels) })
    }
}
