//! A picture that is read in parts, without its constant channels.

use super::grid::Window;
use crate::encode::channels::{Silent, narrowed};
use crate::encode::skipped::SkipReason;
use crate::error::Result;
use crate::gaussian::Channels;
use crate::pixel_source::PixelSource;
use crate::pixels::{Depth, Pixels};

/// A picture with only some of its channels.
pub(super) struct Narrowed<'a> {
    source: &'a dyn PixelSource,
    channels: Channels,
}

impl<'a> Narrowed<'a> {
    /// Reads `tiles`, which together cover the picture of `source`, until no channel can be constant any more. Returns
    /// the picture without its constant channels, and the name of these channels, if there are any. Calls `show` for
    /// each tile.
    pub(super) fn new(
        source: &'a dyn PixelSource,
        tiles: &[Window],
        mut show: impl FnMut() -> Result<()>,
    ) -> Result<(Self, Option<SkipReason>)> {
        let all = source.channels();
        let mut silent: Option<Silent> = None;
        for tile in tiles {
            let rest = |silent: Silent| silent.rest(all);
            if all == Channels::Grey || silent.is_some_and(|s| rest(s).is_none()) {
                break;
            }
            show()?;
            let found = Silent::of(&source.part(tile.core.bounds())?);
            silent = Some(silent.map_or(found, |s| s.and(found)));
        }
        let (channels, what) = match silent.and_then(|s| s.rest(all)) {
            Some((channels, what)) => (channels, Some(what)),
            None => (all, None),
        };
        Ok((Narrowed { source, channels }, what))
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

    fn part(&self, area: [u32; 4]) -> Result<Pixels> {
        let pixels = self.source.part(area)?;
        Ok(if pixels.channels() == self.channels { pixels } else { narrowed(&pixels, self.channels) })
    }
}
