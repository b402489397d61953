//! Selects the metadata of a source picture that a file stores.

use image::metadata::Orientation;

use super::colour::is_srgb;
use crate::bitstream::cicp::Cicp;
use crate::options::MetadataPolicy;

/// Metadata to store in a file, and the sizes of the metadata that are left out.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
#[non_exhaustive]
pub struct Carried {
    /// The code points, for [`Encoder::cicp`](crate::Encoder::cicp).
    pub cicp: Option<Cicp>,
    /// The ICC profile, for [`Encoder::icc`](crate::Encoder::icc).
    pub icc: Option<Vec<u8>>,
    /// The EXIF block, for [`Encoder::exif`](crate::Encoder::exif).
    pub exif: Option<Vec<u8>>,
    /// Size of the profile that is left out, bytes; 0 if none is.
    pub icc_left_out: usize,
    /// Size of the EXIF block that is left out, bytes, also if a block with only the orientation replaces it; 0 if
    /// none is.
    pub exif_left_out: usize,
    /// Whether the picture has an orientation that the file does not store.
    pub is_orientation_left_out: bool,
}

impl MetadataPolicy {
    /// Returns the metadata to store for a picture with these code points, this ICC profile, this EXIF block and this
    /// orientation. [`MetadataPolicy::Needed`] omits a profile that code points override. An orientation that does not
    /// come from an EXIF block, as in TIFF, is stored in a new one; [`MetadataPolicy::All`] adds it to the block of a
    /// file that has both, as AVIF may.
    ///
    /// ```
    /// use image::metadata::Orientation;
    /// use ssplat::MetadataPolicy;
    ///
    /// let exif = Some(vec![0; 20_000]);
    /// let carried = MetadataPolicy::Needed.of((None, None), exif, Orientation::Rotate90);
    /// assert_eq!((carried.exif.map(|exif| exif.len()), carried.exif_left_out), (Some(26), 20_000));
    /// ```
    #[cfg(feature = "unstable")]
    #[must_use]
    pub fn of(
        self,
        colors: (Option<Cicp>, Option<Vec<u8>>),
        exif: Option<Vec<u8>>,
        orientation: Orientation,
    ) -> Carried {
        self.select(colors, exif, orientation)
    }

    pub(crate) fn select(
        self,
        (cicp, icc): (Option<Cicp>, Option<Vec<u8>>),
        exif: Option<Vec<u8>>,
        orientation: Orientation,
    ) -> Carried {
        let is_turned = orientation != Orientation::NoTransforms;
        let alone = || is_turned.then(|| oriented(orientation));
        let length = |block: &Option<Vec<u8>>| block.as_ref().map_or(0, Vec::len);
        let (all_icc, all_exif) = (length(&icc), length(&exif));
        // Pictures without a profile are displayed as sRGB.
        let icc = icc.filter(|icc| self != MetadataPolicy::Needed || cicp.is_none() && !is_srgb(icc));
        let cicp = cicp.filter(|_| self != MetadataPolicy::None);
        let stated = |exif: &Vec<u8>| Orientation::from_exif_chunk(exif).unwrap_or(Orientation::NoTransforms);
        let (icc, exif) = match self {
            // Containers such as AVIF state the orientation beside the block.
            MetadataPolicy::All => match exif {
                Some(exif) if stated(&exif) != orientation => (icc, Some(with_orientation(exif, orientation))),
                exif => (icc, exif.or_else(alone)),
            },
            // A block that contains only the orientation is kept unchanged.
            MetadataPolicy::Needed
                if exif
                    .as_ref()
                    .is_some_and(|exif| is_turned && exif.len() <= BLOCK && stated(exif) == orientation) =>
            {
                (icc, exif)
            }
            MetadataPolicy::Needed => (icc, alone()),
            MetadataPolicy::Icc => (icc, None),
            MetadataPolicy::None => (None, None),
        };
        Carried {
            icc_left_out: if icc.is_some() || self == MetadataPolicy::Needed { 0 } else { all_icc },
            // Leaving out a block that can only hold an orientation loses nothing.
            exif_left_out: if length(&exif) < all_exif && all_exif > BLOCK { all_exif } else { 0 },
            is_orientation_left_out: is_turned && exif.as_ref().is_none_or(|exif| stated(exif) != orientation),
            cicp,
            icc,
            exif,
        }
    }
}

/// Returns an EXIF block with its orientation replaced, or added in a directory that takes the place of the first one. A block
/// without a readable directory is returned unchanged.
fn with_orientation(exif: Vec<u8>, orientation: Orientation) -> Vec<u8> {
    let changed = || {
        let is_little = match exif.get(..4)? {
            b"II*\0" => true,
            b"MM\0*" => false,
            _ => return None,
        };
        let short = |at: usize| {
            let bytes = *exif.get(at..)?.first_chunk()?;
            Some(if is_little { u16::from_le_bytes(bytes) } else { u16::from_be_bytes(bytes) })
        };
        let long = |at: usize| {
            let bytes = *exif.get(at..)?.first_chunk()?;
            Some(if is_little { u32::from_le_bytes(bytes) } else { u32::from_be_bytes(bytes) })
        };
        let short_bytes = |value: u16| if is_little { value.to_le_bytes() } else { value.to_be_bytes() };
        let long_bytes = |value: u32| if is_little { value.to_le_bytes() } else { value.to_be_bytes() };
        let first = usize::try_from(long(4)?).ok()?;
        let count = usize::from(short(first)?);
        let (entries, next) = exif.get(first + 2..)?.split_at_checked(12 * count)?;
        let next = next.get(..4)?;
        // One value of type SHORT, padded to four bytes.
        let mut own = [short_bytes(ORIENTATION), short_bytes(3)].concat();
        own.extend(long_bytes(1));
        own.extend(short_bytes(u16::from(orientation.to_exif())));
        own.extend([0, 0]);
        let tag = |entry: &&[u8]| {
            let bytes = [entry[0], entry[1]];
            if is_little { u16::from_le_bytes(bytes) } else { u16::from_be_bytes(bytes) }
        };
        let mut directory: Vec<&[u8]> = entries.chunks_exact(12).filter(|entry| tag(entry) != ORIENTATION).collect();
        directory.push(&own);
        directory.sort_by_key(tag);
        let mut block = exif.clone();
        // Directories begin at even offsets.
        block.resize(exif.len().next_multiple_of(2), 0);
        block.splice(4..8, long_bytes(u32::try_from(block.len()).ok()?));
        block.extend(short_bytes(u16::try_from(directory.len()).ok()?));
        block.extend(directory.concat());
        block.extend(next);
        Some(block)
    };
    changed().unwrap_or(exif)
}

/// The tag of the orientation.
const ORIENTATION: u16 = 0x0112;

/// Bytes of an EXIF block that contains only an orientation.
const BLOCK: usize = 26;

/// Returns an EXIF block that contains only `orientation`: a TIFF header and a directory of one entry.
fn oriented(orientation: Orientation) -> Vec<u8> {
    let mut block = b"II*\0\x08\0\0\0\x01\0".to_vec();
    // Tag 0x0112, type SHORT, one value; no further directory.
    block.extend([0x12, 1, 3, 0, 1, 0, 0, 0, orientation.to_exif(), 0, 0, 0, 0, 0, 0, 0]);
    debug_assert_eq!(block.len(), BLOCK);
    block
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALL: [Orientation; 8] = [
        Orientation::NoTransforms,
        Orientation::Rotate90,
        Orientation::Rotate180,
        Orientation::Rotate270,
        Orientation::FlipHorizontal,
        Orientation::FlipVertical,
        Orientation::Rotate90FlipH,
        Orientation::Rotate270FlipH,
    ];

    #[test]
    fn the_default_policy_keeps_the_profile_and_the_orientation() {
        for orientation in ALL {
            let carried = MetadataPolicy::Needed.select((None, Some(vec![1; 500])), Some(vec![0; 3000]), orientation);
            assert_eq!((carried.icc, carried.icc_left_out), (Some(vec![1; 500]), 0));
            assert_eq!((carried.exif_left_out, carried.is_orientation_left_out), (3000, false));
            let said = carried.exif.as_deref().and_then(Orientation::from_exif_chunk);
            assert_eq!(said, (orientation != Orientation::NoTransforms).then_some(orientation));
            // A block that was stored once is stored again unchanged.
            let again = MetadataPolicy::Needed.select((None, None), carried.exif.clone(), orientation);
            assert_eq!((&again.exif, again.exif_left_out), (&carried.exif, 0));
        }
    }

    #[test]
    fn an_orientation_beside_the_exif_block_is_kept_with_each_policy_that_keeps_any() {
        // An artist of six bytes at offset 26, in both byte orders.
        let big = b"MM\0*\0\0\0\x08\0\x01\x01\x3b\0\x02\0\0\0\x06\0\0\0\x1a\0\0\0\0Tester".to_vec();
        let little = b"II*\0\x08\0\0\0\x01\0\x3b\x01\x02\0\x06\0\0\0\x1a\0\0\0\0\0\0\0Tester".to_vec();
        let short = big[..26].to_vec();
        for block in [&big, &little, &short, &with_orientation(big.clone(), Orientation::FlipVertical)] {
            for orientation in ALL {
                for carry in [MetadataPolicy::All, MetadataPolicy::Needed] {
                    let carried = carry.select((None, None), Some(block.clone()), orientation);
                    let said = carried.exif.as_deref().and_then(Orientation::from_exif_chunk);
                    let is_turned = orientation != Orientation::NoTransforms;
                    assert_eq!(said.unwrap_or(Orientation::NoTransforms), orientation, "{block:?}, {carry:?}");
                    assert!(!carried.is_orientation_left_out);
                    if carry == MetadataPolicy::All && is_turned && *block != short {
                        // The value still lies where its entry says, and a second change has the same directory.
                        let exif = carried.exif.unwrap();
                        assert_eq!(exif[26..32], *b"Tester");
                        let again = with_orientation(exif.clone(), Orientation::Rotate90);
                        assert_eq!(Orientation::from_exif_chunk(&again), Some(Orientation::Rotate90));
                    }
                }
            }
        }
        // Blocks that cannot be read stay, and the loss is told.
        for broken in [b"MM\0*\0\0\0\xff".to_vec(), b"II*\0\x08\0\0\0\xff\xff".to_vec(), vec![7; 40]] {
            let carried = MetadataPolicy::All.select((None, None), Some(broken.clone()), Orientation::Rotate90);
            assert_eq!((carried.exif, carried.is_orientation_left_out), (Some(broken), true));
        }
    }

    #[test]
    fn omitted_metadata_is_reported() {
        let of = |carry: MetadataPolicy, exif: Option<Vec<u8>>| {
            carry.select((None, Some(vec![1; 500])), exif, Orientation::Rotate180)
        };
        let mut block = oriented(Orientation::Rotate180);
        block.resize(90, 2);
        let all = of(MetadataPolicy::All, Some(block.clone()));
        assert_eq!((all.icc_left_out, all.exif_left_out, all.is_orientation_left_out), (0, 0, false));
        assert_eq!(all.exif, Some(block));
        let icc = of(MetadataPolicy::Icc, Some(vec![2; 90]));
        assert_eq!(
            (icc.icc.is_some(), icc.exif, icc.exif_left_out, icc.is_orientation_left_out),
            (true, None, 90, true)
        );
        let none = of(MetadataPolicy::None, None);
        assert_eq!(
            (none.icc, none.icc_left_out, none.exif_left_out, none.is_orientation_left_out),
            (None, 500, 0, true)
        );
    }

    #[test]
    fn code_points_replace_a_profile_unless_all_metadata_are_kept() {
        let icc = || Some(vec![1; 500]);
        let of =
            |policy: MetadataPolicy| policy.select((Some(Cicp::BT2100_PQ), icc()), None, Orientation::NoTransforms);
        for (policy, expected) in [
            (MetadataPolicy::Needed, (Some(Cicp::BT2100_PQ), None)),
            (MetadataPolicy::All, (Some(Cicp::BT2100_PQ), icc())),
            (MetadataPolicy::Icc, (Some(Cicp::BT2100_PQ), icc())),
            (MetadataPolicy::None, (None, None)),
        ] {
            let carried = of(policy);
            assert_eq!((carried.cicp, carried.icc), expected, "{policy:?}");
        }
    }

    #[test]
    fn an_orientation_without_exif_is_stored_in_a_new_block() {
        for carry in [MetadataPolicy::All, MetadataPolicy::Needed] {
            let exif = carry.select((None, None), None, Orientation::Rotate270).exif;
            assert_eq!(exif.as_deref().and_then(Orientation::from_exif_chunk), Some(Orientation::Rotate270));
            assert_eq!(carry.select((None, None), None, Orientation::NoTransforms), Carried::default());
        }
    }
}
