//! Renders views of valid files, any part at any size: within the memory limit, or with a typed error. Parts have the
//! pixels of the whole.
#![no_main]

use arbitrary::{Arbitrary, Unstructured};
use libfuzzer_sys::fuzz_target;
use peak_alloc::PeakAlloc;
use ssplat::unstable::bitstream::splats::Layout;
use ssplat::unstable::bitstream::to_bytes;
use ssplat::unstable::{DecodeOptions, decode};
use ssplat::{Damage, Limits, PixelSource, Reader, Rect};
use ssplat_fuzz::{Legal, SLACK};

#[global_allocator]
static ALLOCATOR: PeakAlloc = PeakAlloc;

/// Derivation of a view from the previous one.
#[derive(Debug)]
enum Step {
    Crop([u32; 4]),
    Resize([u32; 2]),
}

#[derive(Debug)]
struct Input {
    region: Option<[u32; 4]>,
    size: Option<[u32; 2]>,
    steps: Vec<Step>,
    within: [u32; 2],
    /// Number of Gaussians of the first of two levels.
    level: Option<u8>,
    /// Sides of the picture, if it is not a small one.
    large: Option<[u32; 2]>,
    legal: Legal,
}

/// Returns a side: mostly small, sometimes any value.
fn side(u: &mut Unstructured<'_>) -> arbitrary::Result<u32> {
    match u.int_in_range(0..=7u8)? {
        0 => u.arbitrary(),
        1 => u.int_in_range(0..=2000),
        2 => Ok(1 << u.int_in_range(0..=21u32)?),
        _ => u.int_in_range(0..=320),
    }
}

fn sides<const N: usize>(u: &mut Unstructured<'_>) -> arbitrary::Result<[u32; N]> {
    let mut sides = [0; N];
    for s in &mut sides {
        *s = side(u)?;
    }
    Ok(sides)
}

fn some<T>(
    u: &mut Unstructured<'_>,
    of: impl Fn(&mut Unstructured<'_>) -> arbitrary::Result<T>,
) -> arbitrary::Result<Option<T>> {
    if u.arbitrary()? { of(u).map(Some) } else { Ok(None) }
}

impl<'a> Arbitrary<'a> for Input {
    fn arbitrary(u: &mut Unstructured<'a>) -> arbitrary::Result<Self> {
        let (region, size) = (some(u, sides)?, some(u, sides)?);
        let count = u.int_in_range(0..=6)?;
        let step = |u: &mut Unstructured<'a>| -> arbitrary::Result<Step> {
            if u.arbitrary()? { sides(u).map(Step::Crop) } else { sides(u).map(Step::Resize) }
        };
        let steps = (0..count).map(|_| step(u)).collect::<arbitrary::Result<_>>()?;
        let (within, level, large) = (sides(u)?, some(u, |u| u.int_in_range(0..=255))?, some(u, sides)?);
        Ok(Input { region, size, steps, within, level, large, legal: Legal::arbitrary(u)? })
    }
}

fn limits() -> Limits {
    let mut limits = Limits::default();
    (limits.alloc, limits.work, limits.tile_pairs) = (24 << 20, 1 << 28, 1 << 18);
    limits
}

/// Runs `f` and checks its allocations against the limit.
fn measured(f: impl FnOnce()) {
    ALLOCATOR.reset_peak_usage();
    let before = ALLOCATOR.current_usage();
    f();
    let peak = (ALLOCATOR.peak_usage() - before) as u64;
    assert!(peak <= limits().alloc + 4 * SLACK, "{peak} bytes allocated");
}

fuzz_target!(|input: Input| {
    let mut splats = input.legal.0;
    if let Some([width, height]) = input.large {
        // Keeps positions inside.
        splats.width = splats.width.max(width.clamp(1, 1 << 20));
        splats.height = splats.height.max(height.clamp(1, 1 << 20));
    }
    let count = splats.gaussians.len() as u32;
    if let Some(level) = input.level
        && count > 1
    {
        let first = 1 + u32::from(level) % (count - 1);
        (splats.layout, splats.levels) = (Layout::Coded, vec![first, count - first]);
    }
    let Ok(bytes) = to_bytes(&splats) else { return };
    let mut options = DecodeOptions::default();
    (options.limits, options.region, options.size) = (limits(), input.region.map(Rect::from), input.size);
    measured(|| drop(decode(&bytes, &options)));
    measured(|| drop(Reader::new(&bytes, &limits()).and_then(|reader| reader.thumbnail(input.within))));
    options.damage = Damage::Accept;
    measured(|| drop(decode(&bytes, &options)));
    measured(|| {
        let Ok(opened) = Reader::new(&bytes, &limits()).and_then(|reader| reader.read()) else { return };
        let mut view = opened.view();
        for step in &input.steps {
            let next = match *step {
                Step::Crop([x, y, width, height]) => view.crop(Rect::new(x, y, width, height)),
                Step::Resize([width, height]) => view.resized(width, height),
            };
            view = next.unwrap_or(view);
        }
        drop(opened.render(&view));
    });
    let (Some(region), None) = (input.region, input.size) else { return };
    (options.damage, options.region) = (Damage::Refuse, None);
    let Ok(whole) = decode(&bytes, &options) else { return };
    options.region = Some(region.into());
    let Ok(part) = decode(&bytes, &options) else {
        let [x, y, width, height] = region.map(u64::from);
        let is_outside = x + width > splats.width.into() || y + height > splats.height.into();
        assert!(width == 0 || height == 0 || is_outside, "a part of what was drawn is refused");
        return;
    };
    assert!(whole.pixels.part(region.into()).expect("a part of it") == part.pixels, "a part is not that of the whole");
});
