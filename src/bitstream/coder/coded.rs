//! The coded layout: adaptive entropy coding, in one piece or in groups (spec §8).

use super::attributes::{Attributes, GroupContext, Palette, spacing};
use super::kd::{Counts, Extent, by_key, squares};
use super::model::{Field, SIGNED_NODES};
use super::neighbours::Buckets;
use super::range::{Coder, Decoder, Encoder, Meter};
use crate::bitstream::broken::Broken;
use crate::bitstream::bytes::Bytes;
use crate::bitstream::coder::range::ONE_READER;
use crate::bitstream::header::{Coloring, Header};
use crate::bitstream::palette::{index_of, push_ascending, sorted_codebook, to_i16};
use crate::bitstream::region::{Place, Region};
use crate::bitstream::report::{Detail, Tally};
use crate::bitstream::rules::Rules;
use crate::bitstream::splats::{PackedGaussian, PackedSplats, Steps};
use crate::error::Result;

/// Appends the payload of a file without groups.
pub(crate) fn put(splats: &PackedSplats, out: &mut Vec<u8>) -> Result<()> {
    let book = sorted_codebook(splats);
    let group = Group::new(splats, book.as_deref())?;
    let mut encoder = Encoder::default();
    put_palette(&mut encoder, &group.palette);
    let region = group.rules.region();
    let mut sorted = splats.gaussians.clone();
    sort(&mut sorted, &group.rules, region);
    group.code(&mut encoder, region, Some(&sorted), sorted.len() as u32)?;
    out.extend(encoder.finish());
    Ok(())
}

/// Reads the payload of a file without groups into `splats`.
pub(crate) fn read(bytes: &mut Bytes<'_>, header: &Header, splats: &mut PackedSplats, tally: &mut Tally) -> Result<()> {
    let payload = bytes.rest();
    if tally.detail == Detail::Parts && !ONE_READER {
        let mut decoder = Decoder::new(payload)?;
        read_stream(&mut decoder, header, splats)?;
        decoder.finish()?;
    } else {
        let mut meter = metered(Decoder::new(payload)?, tally.detail);
        read_stream(&mut meter, header, splats)?;
        meter.coder.finish()?;
        tally.add(meter);
    }
    tally.part("coded stream", payload.len());
    Ok(())
}

/// Returns a decoder that counts bits as `detail` requires.
pub(crate) fn metered(decoder: Decoder<'_>, detail: Detail) -> Meter<Decoder<'_>> {
    match detail {
        Detail::Parts => Meter::silent(decoder),
        Detail::Fields => Meter::new(decoder),
    }
}

fn read_stream<C: Coder>(coder: &mut C, header: &Header, splats: &mut PackedSplats) -> Result<()> {
    (splats.background, splats.codebook) = read_palette(coder, header)?;
    let group = Group::new(splats, splats.codebook.as_deref())?;
    group.rules.palette(splats)?;
    splats.gaussians = group.code(coder, group.rules.region(), None, header.gaussians)?;
    Ok(())
}

/// Sorts a group into the order of the file: coarse squares first, in the order of the halves, then by shape, position
/// and colour.
pub(crate) fn sort(gaussians: &mut [PackedGaussian], rules: &Rules, region: Region) {
    gaussians.sort_by_cached_key(|p| (rules.place(p, region), order(p)));
}

/// Returns the sort key within a square.
fn order(p: &PackedGaussian) -> (u8, u8, u16, u32, u32, [i16; 4]) {
    (p.major, p.minor, p.angle, p.x, p.y, p.color)
}

/// Parameters shared by all groups of a picture.
#[derive(Debug)]
pub(crate) struct Group<'a> {
    pub rules: Rules,
    steps: Steps,
    palette: Palette<'a>,
}

impl<'a> Group<'a> {
    /// # Errors
    /// [`Error::Parameter`](crate::Error::Parameter) if a Gaussian's colour is not in the codebook.
    pub(crate) fn new(splats: &PackedSplats, book: Option<&'a [[i16; 4]]>) -> Result<Self> {
        if let Some(book) = book {
            splats.gaussians.iter().try_for_each(|p| index_of(book, p.color).map(drop))?;
        }
        let palette = Palette { channels: splats.channels, background: splats.background, book };
        Ok(Group { rules: Rules::of(splats), steps: splats.steps, palette })
    }

    /// Codes `count` Gaussians of `region`. When writing, they must be sorted.
    pub(crate) fn code<C: Coder>(
        &self,
        coder: &mut C,
        region: Region,
        sorted: Option<&[PackedGaussian]>,
        count: u32,
    ) -> Result<Vec<PackedGaussian>, Broken> {
        let rules = &self.rules;
        let mut given: Vec<Place> = sorted.unwrap_or_default().iter().map(|p| rules.place(p, region)).collect();
        given.sort_by_cached_key(|p| by_key(p, &region));
        let (grid, finest) = (rules.grid(), rules.finest());
        let side = [0, 1].map(|k| (grid[k] - region.corner[k]).min(1 << region.log[k]));
        let cells = spacing(side, count);
        let extent = Extent { grid, region, coarsest: rules.range(), spacing: cells };
        let spacing = cells + 16 * i64::from(finest);
        let squares = squares(coder, &mut Counts::new(), &extent, &given, count)?;
        coder.account("position");
        coder.gaussian();
        let mut buckets = Buckets::new(count, region.corner, side);
        let scene = GroupContext { rules, palette: self.palette, steps: self.steps, grid, spacing };
        let mut attributes = Attributes::new(&scene);
        let mut out: Vec<PackedGaussian> = Vec::with_capacity(count as usize);
        let mut last = None;
        for (i, square) in squares.iter().enumerate() {
            let given = sorted.map_or_else(PackedGaussian::default, |s| s[i]);
            let p = attributes.code(coder, &scene, &mut buckets, square, &given)?;
            coder.gaussian();
            // Squares are ascending by construction; the order within a square is checked.
            if last == Some(square) && out.last().is_some_and(|before| order(before) > order(&p)) {
                return Err(Broken { field: "order of Gaussians", value: i as u64 });
            }
            last = Some(square);
            out.push(p);
        }
        Ok(out)
    }
}

/// Codes background and codebook before a single stream.
fn put_palette(coder: &mut Encoder, palette: &Palette<'_>) {
    let mut field = palette_field();
    for k in 0..palette.channels.count() {
        field.signed(coder, usize::from(k > 0), palette.background[k].into());
    }
    let Some(book) = palette.book else { return };
    coder.raw(16, book.len() as u32 - 1);
    let mut last = palette.background;
    for color in book {
        for k in 0..palette.channels.count() {
            field.signed(coder, 2 + k, i32::from(color[k]) - i32::from(last[k]));
        }
        last = *color;
    }
}

type PaletteRead = ([i16; 4], Option<Vec<[i16; 4]>>);

fn read_palette<C: Coder>(coder: &mut C, header: &Header) -> Result<PaletteRead> {
    let (mut field, channels) = (palette_field(), header.channels.count());
    let mut background = [0i16; 4];
    for (k, b) in background.iter_mut().enumerate().take(channels) {
        *b = to_i16("background", field.signed(coder, usize::from(k > 0), 0).into())?;
    }
    coder.account("background");
    if header.coloring == Coloring::Direct {
        return Ok((background, None));
    }
    let mut book = Vec::new();
    let count = coder.raw(16, 0) + 1;
    let mut last = background;
    for _ in 0..count {
        let mut color = [0i16; 4];
        for k in 0..channels {
            let step = field.signed(coder, 2 + k, 0);
            color[k] = to_i16("codebook", i64::from(last[k]) + i64::from(step))?;
        }
        push_ascending(&mut book, color)?;
        last = color;
    }
    coder.account("codebook");
    Ok((background, Some(book)))
}

fn palette_field() -> Field {
    Field::new(SIGNED_NODES, 6, 60)
}
