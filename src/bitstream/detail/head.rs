//! Contents of the detail layer's section: the parameters from which the values of levels follow (spec §11.1).

use super::model::CLASSES;
use crate::bitstream::broken::Broken;
use crate::bitstream::bytes::{Bytes, put_varint};
use crate::error::Result;
use crate::gaussian::Channels;

/// Parameters from which the values of levels follow.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub struct DetailHead {
    /// `1..=65535`: the quantizer step of luma, grey and alpha at frequency 0, in 1/64 of an 8-bit code value.
    pub step: u16,
    /// `1..=255`: the steps of orange and green chroma relative to that of luma, in sixteenths.
    pub chroma: [u8; 2],
    /// Growth of the steps with frequency: for luma, grey and alpha, and for chroma.
    pub slopes: [u8; 2],
    /// Sizes of the smallest and the largest block, `0..=3` for sides of 4 to 32: for luma, grey and alpha, and for
    /// chroma.
    pub sizes: [[u8; 2]; 2],
    /// `0..=15`: offset of reconstructed values towards 0, in 1/32 of a step: for levels of magnitude 1, and for
    /// larger ones.
    pub biases: [u8; 2],
    /// `1..=8`: number of step classes from which superblocks choose; with 1, all have the same steps.
    pub classes: u8,
    /// Whether alpha has a plane of its own. If not, the layer does not change alpha.
    pub alpha: bool,
}

/// Length and checksum of the Gaussians' bytes, as stored in the detail layer's section.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Spans {
    /// Bytes of the payload; the layer follows it.
    pub payload: u64,
    /// CRC-32 of header and payload, so that the Gaussians can be shown before the layer has arrived.
    pub checksum: u32,
}

impl DetailHead {
    /// The preset for the lowest squared error.
    pub const PLAIN: DetailHead = DetailHead {
        step: 640,
        chroma: [39, 32],
        slopes: [0, 0],
        sizes: [[0, 3], [2, 3]],
        biases: [2, 4],
        classes: 1,
        alpha: false,
    };
    /// The preset for perceptual quality.
    pub const SEEN: DetailHead =
        DetailHead { chroma: [64, 32], slopes: [48, 48], biases: [0, 2], classes: 4, ..DetailHead::PLAIN };

    /// Returns the sizes of the smallest and the largest block of a kind of planes.
    pub(crate) fn sizes(&self, kind: usize) -> [usize; 2] {
        self.sizes[usize::from(kind == 1)].map(usize::from)
    }
}

// Bits of the flags.
const CHROMA: u8 = 1;
const SLOPES: u8 = 2;
const SIZES: u8 = 4;
const BIASES: u8 = 8;
const CLASS_COUNT: u8 = 16;
const ALPHA: u8 = 32;
const PRESET: u8 = 64;
const RESERVED: u8 = 128;

fn broken(field: &'static str, value: u64) -> Broken {
    Broken { field, value }
}

/// Reads the contents of the section.
pub(crate) fn read(contents: &[u8], offset: u64) -> Result<(DetailHead, Spans)> {
    let mut bytes = Bytes::new(contents, offset);
    let spans = Spans { payload: bytes.varint("payload length")?, checksum: bytes.u32("payload checksum")? };
    let step = bytes.u16("detail step")?;
    let [flags] = bytes.array("detail flags")?;
    if flags & RESERVED != 0 {
        return Err(broken("detail flags", flags.into()).into());
    }
    let mut head = if flags & PRESET == 0 { DetailHead::PLAIN } else { DetailHead::SEEN };
    (head.step, head.alpha) = (step, flags & ALPHA != 0);
    if flags & CHROMA != 0 {
        head.chroma = bytes.array("chroma steps")?;
    }
    if flags & SLOPES != 0 {
        head.slopes = bytes.array("step slopes")?;
    }
    if flags & SIZES != 0 {
        let [sizes] = bytes.array("block sizes")?;
        head.sizes = [[sizes & 3, sizes >> 2 & 3], [sizes >> 4 & 3, sizes >> 6]];
    }
    if flags & BIASES != 0 {
        let [biases] = bytes.array("biases")?;
        head.biases = [biases & 15, biases >> 4];
    }
    if flags & CLASS_COUNT != 0 {
        [head.classes] = bytes.array("step classes")?;
    }
    check(&head)?;
    bytes.finish()?;
    // Only one encoding of the contents is valid; otherwise the integers would not determine the file.
    if self::contents(&head, spans) != contents {
        return Err(broken("detail flags", flags.into()).into());
    }
    Ok((head, spans))
}

/// Checks the parameters against the format.
pub(crate) fn check(head: &DetailHead) -> Result<(), Broken> {
    if head.step == 0 {
        return Err(broken("detail step", 0));
    }
    if let Some(&ratio) = head.chroma.iter().find(|&&ratio| ratio == 0) {
        return Err(broken("chroma steps", ratio.into()));
    }
    if let Some(sizes) = head.sizes.iter().find(|sizes| sizes[0] > sizes[1] || sizes[1] > 3) {
        return Err(broken("block sizes", sizes[0].into()));
    }
    if let Some(&bias) = head.biases.iter().find(|&&bias| bias > 15) {
        return Err(broken("biases", bias.into()));
    }
    if !(1..=CLASSES as u8).contains(&head.classes) {
        return Err(broken("step classes", head.classes.into()));
    }
    Ok(())
}

/// Checks that a layer with a plane of alpha belongs to a picture with alpha.
pub(crate) fn check_alpha(head: &DetailHead, channels: Channels) -> Result<(), Broken> {
    if head.alpha && channels.alpha().is_none() {
        return Err(broken("alpha plane of a picture without alpha", channels.count() as u64));
    }
    Ok(())
}

/// Returns the bytes that these parameters take in the section, up to those that all layers take.
pub(crate) fn parameter_bytes(head: &DetailHead) -> u64 {
    contents(head, Spans { payload: 0, checksum: 0 }).len() as u64
}

/// Returns the contents of the section in their shortest form.
pub(crate) fn contents(head: &DetailHead, spans: Spans) -> Vec<u8> {
    [(DetailHead::PLAIN, 0), (DetailHead::SEEN, PRESET)]
        .map(|(preset, flag)| contents_with_preset(head, spans, &preset, flag))
        .into_iter()
        .min_by_key(Vec::len)
        .expect("two presets")
}

/// Returns the contents of the section, which store only the fields that differ from `preset`.
fn contents_with_preset(head: &DetailHead, spans: Spans, preset: &DetailHead, mut flags: u8) -> Vec<u8> {
    let mut fields = Vec::new();
    if head.chroma != preset.chroma {
        flags |= CHROMA;
        fields.extend(head.chroma);
    }
    if head.slopes != preset.slopes {
        flags |= SLOPES;
        fields.extend(head.slopes);
    }
    if head.sizes != preset.sizes {
        flags |= SIZES;
        let [[a, b], [c, d]] = head.sizes;
        fields.push(a | b << 2 | c << 4 | d << 6);
    }
    if head.biases != preset.biases {
        flags |= BIASES;
        fields.push(head.biases[0] | head.biases[1] << 4);
    }
    if head.classes != preset.classes {
        flags |= CLASS_COUNT;
        fields.push(head.classes);
    }
    if head.alpha {
        flags |= ALPHA;
    }
    let mut out = Vec::new();
    put_varint(spans.payload, &mut out);
    out.extend(spans.checksum.to_le_bytes());
    out.extend(head.step.to_le_bytes());
    out.push(flags);
    out.extend(fields);
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heads_round_trip_and_a_reserved_flag_is_refused() {
        let spans = Spans { payload: 300, checksum: 0xdead_beef };
        let odd = DetailHead { chroma: [1, 255], sizes: [[1, 1], [0, 2]], classes: 8, alpha: true, ..DetailHead::SEEN };
        for head in [DetailHead::PLAIN, DetailHead::SEEN, odd, DetailHead { step: 65_535, ..odd }] {
            let bytes = contents(&head, spans);
            assert_eq!(read(&bytes, 0).unwrap(), (head, spans));
            let mut reserved = bytes.clone();
            reserved[8] |= RESERVED;
            assert!(read(&reserved, 0).is_err());
            assert!(read(&bytes[..bytes.len() - 1], 0).is_err() && read(&[&bytes[..], &[0]].concat(), 0).is_err());
        }
        assert_eq!(contents(&DetailHead::SEEN, spans).len(), 9);
        // A value that repeats the preset, and a preset that needs more bytes than the other.
        let mut said_twice = contents(&DetailHead::PLAIN, spans);
        said_twice[8] |= CLASS_COUNT;
        said_twice.push(1);
        assert!(
            read(&said_twice, 0).is_err()
                && read(&contents_with_preset(&DetailHead::SEEN, spans, &DetailHead::PLAIN, 0), 0).is_err()
        );
        for broken in [
            DetailHead { step: 0, ..odd },
            DetailHead { chroma: [0, 3], ..odd },
            DetailHead { sizes: [[2, 1], [0, 0]], ..odd },
            DetailHead { classes: 0, ..odd },
            DetailHead { classes: 9, ..odd },
        ] {
            assert!(read(&contents(&broken, spans), 0).is_err(), "{broken:?}");
        }
    }
}
