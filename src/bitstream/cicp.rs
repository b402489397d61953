//! Code points of colours (ITU-T H.273), as the section `cicp` stores them; exact (spec §3).

use std::fmt;

use crate::error::FormatError;

/// Code points that state the colours of a picture, as in the cICP chunk of PNG 3: colour primaries, transfer
/// characteristics and video range, by the numbers of ITU-T H.273. They express PQ and HLG, which no ICC profile can.
///
/// The matrix coefficients are always 0, because the samples are grey or red, green and blue. Encoding and decoding do
/// not interpret the code points: the samples are those of the source.
///
/// ```
/// let hdr = ssplat::Cicp::new(9, 16);
/// assert_eq!(hdr.to_string(), "BT.2020 primaries, PQ, full range");
/// assert_eq!(hdr.to_bytes(), [9, 16, 0, 1]);
/// assert!(ssplat::Cicp::from_bytes(&[9, 16, 9, 1]).is_err());
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[doc(alias("h273", "hdr", "pq", "hlg", "nclx"))]
pub struct Cicp {
    /// Primaries, transfer characteristics, 0, and 1 if the range is full.
    bytes: [u8; 4],
}

impl Cicp {
    /// BT.2020 primaries with PQ: BT.2100 PQ, also called HDR10.
    pub const BT2100_PQ: Cicp = Cicp::new(9, 16);
    /// BT.2020 primaries with HLG: BT.2100 HLG.
    pub const BT2100_HLG: Cicp = Cicp::new(9, 18);

    /// Returns code points of full range, with the colour `primaries` and `transfer` characteristics of ITU-T H.273.
    #[must_use]
    pub const fn new(primaries: u8, transfer: u8) -> Cicp {
        Cicp { bytes: [primaries, transfer, 0, 1] }
    }

    /// Returns the code points of four bytes: primaries, transfer characteristics, matrix coefficients, and whether
    /// the range is full. All primaries and transfer characteristics are accepted.
    ///
    /// # Errors
    /// [`FormatError::BadValue`] if there are not four bytes, if the matrix coefficients are not 0, or if the last byte
    /// is neither 0 nor 1.
    pub fn from_bytes(bytes: &[u8]) -> Result<Cicp, FormatError> {
        let Ok(bytes) = <[u8; 4]>::try_from(bytes) else {
            return Err(FormatError::BadValue { field: "length of section cicp", value: bytes.len() as u64 });
        };
        match bytes {
            [_, _, 0, 0 | 1] => Ok(Cicp { bytes }),
            [_, _, 0, value] => {
                Err(FormatError::BadValue { field: "full-range flag of section cicp", value: value.into() })
            }
            [_, _, value, _] => {
                Err(FormatError::BadValue { field: "matrix coefficients of section cicp", value: value.into() })
            }
        }
    }

    /// Returns primaries, transfer characteristics, matrix coefficients (0), and 1 if the range is full.
    #[must_use]
    pub const fn to_bytes(self) -> [u8; 4] {
        self.bytes
    }

    pub(crate) fn as_bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Returns the colour primaries, such as 1 for BT.709 and sRGB, 9 for BT.2020, and 12 for Display P3.
    #[must_use]
    pub const fn primaries(self) -> u8 {
        self.bytes[0]
    }

    /// Returns the transfer characteristics, such as 13 for sRGB, 16 for PQ, and 18 for HLG.
    #[must_use]
    pub const fn transfer(self) -> u8 {
        self.bytes[1]
    }

    /// Returns whether all code values from 0 to the largest are used. In the narrow range of video, black is 16 and
    /// white 235 at 8 bits.
    #[must_use]
    pub const fn is_full_range(self) -> bool {
        self.bytes[3] == 1
    }
}

/// Names the code points, such as "Display P3 primaries, sRGB transfer, full range".
impl fmt::Display for Cicp {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let primaries = match self.primaries() {
            1 => "BT.709",
            2 => "unspecified",
            4 => "BT.470 M",
            5 => "BT.470 BG",
            6 | 7 => "BT.601",
            8 => "film",
            9 => "BT.2020",
            10 => "XYZ",
            11 => "DCI-P3",
            12 => "Display P3",
            22 => "EBU 3213",
            _ => "",
        };
        let transfer = match self.transfer() {
            1 => "BT.709 transfer",
            2 => "unspecified transfer",
            4 => "gamma 2.2",
            5 => "gamma 2.8",
            6 => "BT.601 transfer",
            7 => "SMPTE 240 transfer",
            8 => "linear",
            9 | 10 => "logarithmic",
            11 => "xvYCC transfer",
            12 => "BT.1361 transfer",
            13 => "sRGB transfer",
            14 | 15 => "BT.2020 transfer",
            16 => "PQ",
            17 => "DCI transfer",
            18 => "HLG",
            _ => "",
        };
        match (primaries, self.primaries()) {
            ("", number) => write!(f, "primaries {number}, ")?,
            (name, _) => write!(f, "{name} primaries, ")?,
        }
        match (transfer, self.transfer()) {
            ("", number) => write!(f, "transfer {number}, ")?,
            (name, _) => write!(f, "{name}, ")?,
        }
        f.write_str(if self.is_full_range() { "full range" } else { "narrow range" })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_four_bytes_without_a_matrix_are_code_points() {
        for primaries in 0..=255 {
            for flag in [0, 1] {
                let found = Cicp::from_bytes(&[primaries, 255 - primaries, 0, flag]).unwrap();
                assert_eq!(found.to_bytes(), [primaries, 255 - primaries, 0, flag]);
                assert_eq!((found.primaries(), found.transfer()), (primaries, 255 - primaries));
                assert_eq!(found.is_full_range(), flag == 1);
            }
        }
        let refused = |bytes: &[u8]| Cicp::from_bytes(bytes).unwrap_err().to_string();
        assert_eq!(refused(&[9, 16, 0]), "length of section cicp has the illegal value 3");
        assert_eq!(refused(&[9, 16, 0, 1, 1]), "length of section cicp has the illegal value 5");
        assert_eq!(refused(&[9, 16, 9, 1]), "matrix coefficients of section cicp has the illegal value 9");
        assert_eq!(refused(&[9, 16, 0, 2]), "full-range flag of section cicp has the illegal value 2");
    }

    #[test]
    fn code_points_are_named() {
        assert_eq!(Cicp::BT2100_HLG.to_string(), "BT.2020 primaries, HLG, full range");
        assert_eq!(Cicp::new(12, 13).to_string(), "Display P3 primaries, sRGB transfer, full range");
        let narrow = Cicp::from_bytes(&[200, 99, 0, 0]).unwrap();
        assert_eq!(narrow.to_string(), "primaries 200, transfer 99, narrow range");
    }
}
