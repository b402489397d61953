//! ICC profiles: made of code points, of chromaticities and of transfer functions, and compared with sRGB.

use moxcms::{
    Chromaticity, CicpColorPrimaries, CicpProfile, ColorPrimaries, ColorProfile, DataColorSpace, Layout,
    MatrixCoefficients, ToneReprCurve, TransferCharacteristics, TransformOptions, XyY,
};

use crate::bitstream::cicp::Cicp;
use crate::bitstream::splats::Metadata;

/// Maximum length of a profile that is compared with sRGB, bytes. sRGB profiles have up to 61 kB, and the comparison of
/// longer ones could take a second.
const MAX_COMPARED_BYTES: usize = 1 << 16;

/// Points per axis of the grid of colours at which a profile is compared with sRGB.
const GRID: usize = 9;

/// Maximum difference from sRGB of a profile that counts as sRGB, in 8-bit code values. Profiles with a curve of 1024
/// entries differ by this much where they are rounded.
const MAX_SRGB_DIFFERENCE: u8 = 1;

/// A `gAMA` within this ratio of 1/2.2 counts as sRGB, as in libpng (`PNG_GAMMA_THRESHOLD`), because encoders write it
/// into sRGB files.
const GAMMA_TOLERANCE: f64 = 0.05;
/// A `cHRM` within this distance of the primaries and the white point of sRGB counts as sRGB, because encoders round
/// them.
const CHROMATICITY_TOLERANCE: f64 = 0.005;

/// Date of the profiles that are created here, in the format of a profile's header: 1 January 2026.
const CREATION_DATE: [u8; 12] = [7, 234, 0, 1, 0, 1, 0, 0, 0, 0, 0, 0];

/// Chromaticities (x, y) of the white point, red, green and blue of sRGB.
const SRGB: [f64; 8] = [0.3127, 0.329, 0.64, 0.33, 0.3, 0.6, 0.15, 0.06];

/// Returns whether a profile is equivalent to sRGB: all colours have the same 8-bit code values, within 1. Grey
/// profiles are compared with the greys of sRGB.
pub fn is_srgb(icc: &[u8]) -> bool {
    icc.len() <= MAX_COMPARED_BYTES
        && difference_from_srgb(icc).is_some_and(|difference| difference <= MAX_SRGB_DIFFERENCE)
}

/// Returns why a profile does not fit grey or RGB samples, as the end of a sentence; `None` if it does.
pub fn misfit(icc: &[u8], is_grey: bool) -> Option<String> {
    // ICC.1, header: length, data colour space, and the signature of all profiles.
    let length = icc.first_chunk().map_or(0, |length| u32::from_be_bytes(*length)) as usize;
    let space = icc.get(16..20).unwrap_or_default();
    let is_profile = icc.get(36..40) == Some(b"acsp");
    match space {
        _ if is_profile && length > icc.len() => Some("is cut off".into()),
        b"GRAY" if is_grey => None,
        b"RGB " if !is_grey => None,
        _ if !is_profile && !matches!(space, b"GRAY" | b"RGB " | b"CMYK" | b"Lab ") => Some("is broken".into()),
        space => {
            let space = if space == b"GRAY" { "grey".into() } else { String::from_utf8_lossy(space) };
            let samples = if is_grey { "grey" } else { "RGB" };
            Some(format!("is for {}, not for the {samples} samples", space.trim()))
        }
    }
}

/// Returns the largest difference between colours under a profile and in sRGB, in 8-bit code values; `None` if they
/// cannot be compared.
fn difference_from_srgb(icc: &[u8]) -> Option<u8> {
    let profile = ColorProfile::new_from_slice(icc).ok()?;
    let grey = |v: usize| [v as u8; 3];
    let colors: Vec<[u8; 3]> = match profile.color_space {
        DataColorSpace::Gray => (0..256).map(grey).collect(),
        DataColorSpace::Rgb => {
            let at = |i: usize| (i * 255 / (GRID - 1)) as u8;
            let grid = (0..GRID * GRID * GRID).map(|i| [at(i % GRID), at(i / GRID % GRID), at(i / GRID / GRID)]);
            (0..256).map(grey).chain(grid).collect()
        }
        _ => return None,
    };
    let (layout, source): (_, Vec<u8>) = match profile.color_space {
        DataColorSpace::Gray => (Layout::Gray, (0..=255).collect()),
        _ => (Layout::Rgb, colors.iter().flatten().copied().collect()),
    };
    let options = TransformOptions { allow_use_cicp_transfer: false, ..TransformOptions::default() };
    let transform = profile.create_transform_8bit(layout, &ColorProfile::new_srgb(), Layout::Rgb, options).ok()?;
    let mut shown = vec![0u8; 3 * colors.len()];
    transform.transform(&source, &mut shown).ok()?;
    shown.iter().zip(colors.iter().flatten()).map(|(a, b): (&u8, &u8)| a.abs_diff(*b)).max()
}

/// How a file stores the colours that code points state: as a profile if one can express them, otherwise as code points.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct CodePoints {
    pub icc: Option<Vec<u8>>,
    pub cicp: Option<Cicp>,
    /// A note for the user about invalid code points.
    pub note: Option<&'static str>,
}

/// Returns how a file stores the colours of these code points: primaries, transfer characteristics, matrix, and whether
/// the range is full. PQ, HLG and the narrow range of video stay code points. Those that state nothing are omitted, and
/// so are reserved ones.
pub fn of_cicp(bytes: [u8; 4], is_grey: bool) -> CodePoints {
    match Cicp::from_bytes(&bytes) {
        Err(_) => {
            let note = Some("its code points of colours (cICP) are invalid, and are left out");
            CodePoints { note, ..CodePoints::default() }
        }
        Ok(cicp) if is_beyond_profiles(cicp) => CodePoints { cicp: Some(cicp), ..CodePoints::default() },
        Ok(cicp) => CodePoints { icc: profile_of_cicp(cicp, is_grey), ..CodePoints::default() },
    }
}

/// Whether the code points are PQ, HLG or of narrow range. moxcms makes profiles of PQ and HLG, whose light has no bound in
/// them.
fn is_beyond_profiles(cicp: Cicp) -> bool {
    matches!(cicp.transfer(), 16 | 18) || !cicp.is_full_range()
}

/// Returns a profile with the meaning of code points; `None` if no profile can express them.
pub fn profile_of_cicp(cicp: Cicp, is_grey: bool) -> Option<Vec<u8>> {
    let parse = || {
        if is_beyond_profiles(cicp) {
            return None;
        }
        let color_primaries = CicpColorPrimaries::try_from(cicp.primaries()).ok()?;
        let transfer_characteristics = TransferCharacteristics::try_from(cicp.transfer()).ok()?;
        let matrix_coefficients = MatrixCoefficients::Identity;
        // Checked first, because moxcms would make a profile of anything else as well.
        let curve = ToneReprCurve::try_from(transfer_characteristics).ok()?;
        ColorPrimaries::try_from(color_primaries).ok()?;
        let cicp = CicpProfile { color_primaries, transfer_characteristics, matrix_coefficients, full_range: true };
        Some((ColorProfile::new_from_cicp(cicp), curve))
    };
    parse().and_then(|(rgb, curve)| encoded(rgb, curve, is_grey))
}

/// Returns the profile of a picture for programs that do not know code points: one with the meaning of the code points,
/// which take precedence, or the profile of the file.
pub fn profile_or_equivalent(metadata: &Metadata, is_grey: bool) -> Option<Vec<u8>> {
    match metadata.cicp {
        Some(cicp) => profile_of_cicp(cicp, is_grey).or_else(|| metadata.icc.clone()),
        None => metadata.icc.clone(),
    }
}

/// Returns the profile of a `gAMA` and a `cHRM` chunk; `None` if they are equivalent to sRGB.
pub(super) fn of_gamma(gamma: Option<f64>, chromaticities: Option<[f64; 8]>, is_grey: bool) -> Option<Vec<u8>> {
    // The decoding exponents are within the range of a profile's curve.
    let exponent = gamma.filter(|g| (0.05..=20.0).contains(g)).map(f64::recip);
    let is_usual = exponent.is_none_or(|e| (e / 2.2 - 1.0).abs() < GAMMA_TOLERANCE);
    let [wx, wy, primaries @ ..] = chromaticities.filter(is_valid).unwrap_or(SRGB);
    let is_srgb = |c: &[f64]| c.iter().zip(SRGB).all(|(a, b)| (a - b).abs() < CHROMATICITY_TOLERANCE);
    let has_its_colors = is_grey || is_srgb(&[&[wx, wy], &primaries[..]].concat());
    if is_usual && has_its_colors {
        return None;
    }
    let transfer = match exponent {
        Some(exponent) if !is_usual => Transfer::Gamma(exponent),
        _ => Transfer::Srgb,
    };
    let [a, b, c, d, e, f] = primaries;
    of_chromaticities(if has_its_colors { SRGB } else { [wx, wy, a, b, c, d, e, f] }, transfer, is_grey)
}

/// Returns whether the chromaticities are those of a white point and three primaries that span an area.
fn is_valid(c: &[f64; 8]) -> bool {
    let [_, _, rx, ry, gx, gy, bx, by] = *c;
    let area = (gx - rx) * (by - ry) - (bx - rx) * (gy - ry);
    c.iter().all(|v| (0.0..=1.0).contains(v)) && [1, 3, 5, 7].iter().all(|&k| c[k] > 1e-3) && area.abs() > 1e-3
}

/// A transfer function: encoded values to linear light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Transfer {
    Srgb,
    /// ITU-R BT.709.
    #[cfg_attr(not(feature = "unstable"), allow(dead_code, reason = "only the program reads such files"))]
    Bt709,
    /// The exponent; 1 is linear.
    Gamma(f64),
}

impl Transfer {
    fn curve(self) -> ToneReprCurve {
        ToneReprCurve::Parametric(match self {
            Transfer::Srgb => vec![2.4, 1.0 / 1.055, 0.055 / 1.055, 1.0 / 12.92, 0.04045],
            Transfer::Bt709 => vec![1.0 / 0.45, 1.0 / 1.099, 0.099 / 1.099, 1.0 / 4.5, 0.081],
            Transfer::Gamma(exponent) => vec![exponent as f32],
        })
    }
}

/// Returns the profile of a white point, of three primaries (chromaticities x, y), and of a transfer function; `None`
/// if it cannot be created. Grey profiles have neither white point nor primaries.
pub fn of_chromaticities(chromaticities: [f64; 8], transfer: Transfer, is_grey: bool) -> Option<Vec<u8>> {
    let mut profile = ColorProfile::new_srgb();
    if !is_grey {
        if !is_valid(&chromaticities) {
            return None;
        }
        let [wx, wy, primaries @ ..] = chromaticities;
        let at = |k: usize| Chromaticity::new(primaries[k] as f32, primaries[k + 1] as f32);
        profile.update_rgb_colorimetry(XyY::new(wx, wy, 1.0), ColorPrimaries { red: at(0), green: at(2), blue: at(4) });
    }
    encoded(profile, transfer.curve(), is_grey)
}

/// Returns the bytes of a colour or grey profile with the given curve; `None` if it cannot be created.
fn encoded(mut profile: ColorProfile, curve: ToneReprCurve, is_grey: bool) -> Option<Vec<u8>> {
    if is_grey {
        profile = ColorProfile::new_gray_with_gamma(2.2);
        profile.gray_trc = Some(curve);
    } else {
        (profile.red_trc, profile.green_trc) = (Some(curve.clone()), Some(curve.clone()));
        profile.blue_trc = Some(curve);
        profile.cicp = None;
    }
    // ICC.1, 9.2.36: the white point of a display is that of the connection space.
    profile.media_white_point = Some(profile.white_point);
    let mut icc = conforming(&profile.encode().ok()?)?;
    // moxcms writes the current time into the header, but equal pictures must give equal files.
    icc.get_mut(24..36)?.copy_from_slice(&CREATION_DATE);
    Some(icc)
}

/// The white point of the connection space, D50, as a profile stores it (ICC.1, 7.2.16).
const D50: [u8; 12] = [0, 0, 0xF6, 0xD6, 0, 1, 0, 0, 0, 0, 0xD3, 0x2D];

/// Returns the profile `icc`, which moxcms wrote, as ICC.1 wants it and libpng checks it: tags start at multiples of
/// four bytes, the white point is exactly D50, and there are a name and a copyright. Equal tags share their bytes.
fn conforming(icc: &[u8]) -> Option<Vec<u8>> {
    let word = |at: usize| icc.get(at..at + 4)?.first_chunk().map(|bytes| u32::from_be_bytes(*bytes));
    let mut tags: Vec<([u8; 4], Vec<u8>)> = Vec::new();
    for k in 0..word(128)? as usize {
        let entry = 132 + 12 * k;
        let (start, length) = (word(entry + 4)? as usize, word(entry + 8)? as usize);
        tags.push((*icc.get(entry..)?.first_chunk()?, icc.get(start..start.checked_add(length)?)?.to_vec()));
    }
    for (name, text) in [(b"desc", "ssplat"), (b"cprt", "CC0")] {
        if tags.iter().all(|(tag, _)| tag != name) {
            // A multi-localized text of one record (ICC.1, 10.15).
            let letters: Vec<u8> = text.encode_utf16().flat_map(u16::to_be_bytes).collect();
            let numbers = [0, 1, 12].map(u32::to_be_bytes).concat();
            let place = [letters.len() as u32, 28].map(u32::to_be_bytes).concat();
            tags.push((*name, [&b"mluc"[..], &numbers, b"enUS", &place, &letters].concat()));
        }
    }
    for (_, white) in tags.iter_mut().filter(|(name, _)| name == b"wtpt") {
        white.get_mut(8..20)?.copy_from_slice(&D50);
    }
    let mut out = icc.get(..128)?.to_vec();
    out[68..80].copy_from_slice(&D50);
    out.extend((tags.len() as u32).to_be_bytes());
    let first = out.len() + 12 * tags.len();
    let mut data: Vec<u8> = Vec::new();
    let mut places: Vec<(&[u8], usize)> = Vec::new();
    for (name, value) in &tags {
        let start = places.iter().find(|(other, _)| other == &value.as_slice()).map(|&(_, start)| start);
        let start = start.unwrap_or_else(|| {
            let start = data.len();
            data.extend_from_slice(value);
            data.resize(data.len().next_multiple_of(4), 0);
            start
        });
        out.extend(name);
        out.extend(((first + start) as u32).to_be_bytes());
        out.extend((value.len() as u32).to_be_bytes());
        places.push((value.as_slice(), start));
    }
    out.extend(data);
    let length = out.len() as u32;
    out[..4].copy_from_slice(&length.to_be_bytes());
    Some(out)
}

#[cfg(test)]
mod tests {
    use moxcms::curve_from_gamma;

    use super::*;

    /// Returns the XYZ values of the primaries under D50, as computed by moxcms.
    fn primaries(icc: &[u8]) -> [[f64; 3]; 3] {
        let p = ColorProfile::new_from_slice(icc).unwrap();
        [p.red_colorant, p.green_colorant, p.blue_colorant].map(|c| [c.x, c.y, c.z])
    }

    fn encode(profile: &ColorProfile) -> Vec<u8> {
        profile.encode().unwrap()
    }

    #[test]
    fn a_profile_is_recognized_as_srgb_by_its_curves_and_primaries() {
        assert!(is_srgb(&encode(&ColorProfile::new_srgb())));
        // A curve of 1024 entries, as in the common profile of 3144 bytes.
        let mut table = ColorProfile::new_srgb();
        let linear = |i: u32| {
            let v = f64::from(i) / 1023.0;
            let v = if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) };
            (v * 65535.0).round() as u16
        };
        let curve = ToneReprCurve::Lut((0..1024).map(linear).collect());
        (table.red_trc, table.green_trc) = (Some(curve.clone()), Some(curve.clone()));
        table.blue_trc = Some(curve);
        assert!(is_srgb(&encode(&table)));
        for other in [ColorProfile::new_display_p3(), ColorProfile::new_adobe_rgb(), ColorProfile::new_bt2020()] {
            assert!(!is_srgb(&encode(&other)));
        }
        let mut gamma = ColorProfile::new_srgb();
        gamma.green_trc = Some(curve_from_gamma(2.2));
        assert!(!is_srgb(&encode(&gamma)));
        assert!(!is_srgb(&encode(&ColorProfile::new_gray_with_gamma(1.8))));
        let mut grey = ColorProfile::new_gray_with_gamma(2.2);
        grey.gray_trc = ColorProfile::new_srgb().red_trc;
        assert!(is_srgb(&encode(&grey)));
        for broken in [&[][..], &[0; 500], &encode(&table)[..400]] {
            assert!(!is_srgb(broken));
        }
    }

    #[test]
    fn gamma_and_chromaticities_other_than_srgb_become_a_profile() {
        assert_eq!(of_gamma(Some(0.45455), Some(SRGB), false), None);
        assert_eq!(of_gamma(None, None, false), None);
        assert_eq!(of_gamma(Some(0.0), Some([0.0; 8]), false), None);
        let linear = of_gamma(Some(1.0), None, false).unwrap();
        let curve = ColorProfile::new_from_slice(&linear).unwrap().red_trc.unwrap();
        assert!((curve.make_linear_evaluator().unwrap().evaluate_value(0.5) - 0.5).abs() < 1e-3);
        // Adobe RGB.
        let adobe = of_gamma(Some(0.45471), Some([0.3127, 0.329, 0.64, 0.33, 0.21, 0.71, 0.15, 0.06]), false).unwrap();
        let expected = primaries(&encode(&ColorProfile::new_adobe_rgb()));
        let near = primaries(&adobe).iter().flatten().zip(expected.iter().flatten()).all(|(a, b)| (a - b).abs() < 1e-3);
        assert!(near && adobe.len() < 700, "{:?} {}", primaries(&adobe), adobe.len());
        let grey = of_gamma(Some(1.0), None, true).unwrap();
        assert_eq!(&grey[16..20], b"GRAY");
        assert!(
            [linear, adobe, grey].iter().all(|icc| icc[24..36] == CREATION_DATE),
            "the profile must not contain the current time"
        );
    }

    #[test]
    fn a_profile_fits_the_samples_of_its_space() {
        let grey = of_gamma(Some(1.0), None, true).unwrap();
        let rgb = of_gamma(Some(1.0), None, false).unwrap();
        assert_eq!((misfit(&grey, true), misfit(&rgb, false)), (None, None));
        assert_eq!(misfit(&grey, false).unwrap(), "is for grey, not for the RGB samples");
        assert_eq!(misfit(&rgb, true).unwrap(), "is for RGB, not for the grey samples");
        assert_eq!(misfit(&rgb[..rgb.len() - 1], false).unwrap(), "is cut off");
        for junk in [&[][..], &[7; 500], &b"a text of more than 40 letters, for all to read".repeat(2)] {
            assert_eq!(misfit(junk, false).unwrap(), "is broken");
        }
    }

    #[test]
    fn profiles_that_are_made_conform_to_icc() {
        let code_points = |transfer, is_grey| of_cicp([12, transfer, 0, 1], is_grey).icc.unwrap();
        let made = [4, 5, 8, 13].map(|transfer| [false, true].map(|is_grey| code_points(transfer, is_grey)));
        let gamma = [false, true].map(|is_grey| of_gamma(Some(1.0), None, is_grey).unwrap());
        for icc in made.as_flattened().iter().chain(&gamma) {
            let word = |at: usize| u32::from_be_bytes(icc[at..at + 4].try_into().unwrap()) as usize;
            assert_eq!((word(0), icc.len() % 4, &icc[68..80]), (icc.len(), 0, &D50[..]));
            let tags: Vec<(&[u8], usize, usize)> = (0..word(128))
                .map(|k| 132 + 12 * k)
                .map(|entry| (&icc[entry..entry + 4], word(entry + 4), word(entry + 8)))
                .collect();
            assert!(tags.iter().all(|&(_, start, length)| start % 4 == 0 && start + length <= icc.len()));
            for name in [b"desc", b"cprt", b"wtpt"] {
                assert!(tags.iter().any(|(tag, ..)| tag == name), "{}", name.escape_ascii());
            }
            ColorProfile::new_from_slice(icc).unwrap();
        }
    }

    #[test]
    fn code_points_become_a_profile_or_stay_code_points() {
        let p3 = of_cicp([12, 13, 0, 1], false);
        let expected = primaries(&encode(&ColorProfile::new_display_p3()));
        let found = primaries(p3.icc.as_ref().unwrap());
        assert!(found.iter().flatten().zip(expected.iter().flatten()).all(|(a, b)| (a - b).abs() < 1e-3), "{found:?}");
        assert!(p3.note.is_none());
        assert!(is_srgb(&of_cicp([1, 13, 0, 1], false).icc.unwrap()));
        for kept in [[9, 16, 0, 1], [9, 18, 0, 1], [1, 13, 0, 0]] {
            let cicp = Cicp::from_bytes(&kept).ok();
            assert_eq!(of_cicp(kept, false), CodePoints { cicp, ..CodePoints::default() });
            assert_eq!(profile_of_cicp(cicp.unwrap(), false), None, "{kept:?}");
        }
        for invalid in [[1, 13, 1, 1], [9, 16, 9, 1], [9, 16, 0, 2]] {
            let found = of_cicp(invalid, false);
            assert!(found.icc.is_none() && found.cicp.is_none() && found.note.is_some(), "{invalid:?}");
        }
        for unknown in [[2, 2, 0, 1], [255, 13, 0, 1], [1, 255, 0, 1]] {
            assert_eq!(of_cicp(unknown, false), CodePoints::default());
        }
    }
}
