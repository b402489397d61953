//! Checks the options of an encode.

use super::primitive_count::MAX_PRIMITIVES;
use super::tiles::TILE_SIDES;
use crate::bitstream::splats::Layout;
use crate::effort::MAX_EFFORT;
use crate::error::{Error, Result};
use crate::limits::Limits;
use crate::options::{Detail, EncodeOptions};
use crate::parameter::{Limit, Parameter};
use crate::target::Target;

/// Checks that every option is within its range, and that decoders with default limits read the metadata.
pub(crate) fn check(options: &EncodeOptions) -> Result<()> {
    let bad = |parameter, problem| Err(Error::Parameter { parameter, problem });
    Limits::check(Limit::Metadata, options.stored_lengths().sum(), Limits::default().metadata)?;
    if !(1..=MAX_EFFORT).contains(&options.effort) {
        return bad(Parameter::Effort, format!("{} is outside 1..={MAX_EFFORT}", options.effort));
    }
    if !(1..=8).contains(&options.levels) {
        return bad(Parameter::Levels, format!("{} is outside 1..=8", options.levels));
    }
    if options.levels > 1 && options.layout != Layout::Coded {
        return bad(Parameter::Levels, "levels above 1 need the coded layout".into());
    }
    if let Some(side) = options.tiles.filter(|s| !TILE_SIDES.contains(s) || !s.is_multiple_of(*TILE_SIDES.start())) {
        let (least, most) = TILE_SIDES.into_inner();
        return bad(Parameter::Tiles, format!("{side} is not a multiple of {least} within {least}..={most}"));
    }
    match options.detail {
        Detail::GaussianShare(share) if !(share > 0.0 && share < 1.0) => {
            return bad(Parameter::Detail, format!("a share of {share} is not between 0 and 1"));
        }
        Detail::GaussianShare(_) if options.layout != Layout::Coded => {
            return bad(Parameter::Detail, "only the coded layout has a detail layer".into());
        }
        Detail::GaussianShare(_) if matches!(options.target, Target::Gaussians(_)) => {
            return bad(Parameter::Detail, "a file of a number of Gaussians has no detail layer".into());
        }
        _ => {}
    }
    match options.target {
        Target::Ratio(r) if !(r.is_finite() && r > 0.0) => {
            bad(Parameter::Ratio, format!("{r} is not a positive number"))
        }
        Target::Psnr(p) if !(p.is_finite() && p > 0.0) => bad(Parameter::Psnr, format!("{p} is not a positive number")),
        #[cfg(feature = "quality-hook")]
        Target::Quality(q) if !(0.0..=100.0).contains(&q) => bad(Parameter::Quality, format!("{q} is outside 0..=100")),
        Target::Gaussians(n) if u64::from(n) > MAX_PRIMITIVES => {
            bad(Parameter::Gaussians, format!("{n} is over {MAX_PRIMITIVES}"))
        }
        _ => Ok(()),
    }
}
