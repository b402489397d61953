//! What a picture file states about its colours, as an ICC profile: statements that the decoders of `image` ignore, and
//! the comparison of profiles with sRGB.

use std::io::{self, BufRead, ErrorKind, Read, Seek, SeekFrom};

use image::DynamicImage;
use moxcms::{
    Chromaticity, CicpColorPrimaries, CicpProfile, ColorPrimaries, ColorProfile, DataColorSpace, Layout,
    MatrixCoefficients, ToneReprCurve, TransferCharacteristics, TransformOptions, XyY, curve_from_gamma,
};

/// Maximum length of a profile that is compared with sRGB, bytes. sRGB profiles have up to 61 kB, and the comparison of
/// longer ones could take a second.
const MAX_COMPARED_BYTES: usize = 1 << 16;

/// Maximum length of a profile that is read from a TIFF, bytes.
const MAX_TIFF_PROFILE_BYTES: u32 = 64 << 20;

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

/// What a file states about its colours in addition to the profile that its decoder finds.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Stated {
    /// A profile with the same meaning.
    icc: Option<Vec<u8>>,
    /// Whether it takes precedence over the profile that the decoder finds.
    is_first: bool,
    /// A note for the user about what no profile can express.
    #[cfg_attr(not(feature = "unstable"), allow(dead_code, reason = "only the program and the encoder ask for it"))]
    pub note: Option<&'static str>,
    /// Whether decoders return all pictures of the format with alpha.
    always_has_alpha: bool,
}

impl Stated {
    /// Returns the profile to use, given the profile that the decoder found.
    pub fn or(&self, found: Option<Vec<u8>>) -> Option<Vec<u8>> {
        if self.is_first { self.icc.clone().or(found) } else { found.or_else(|| self.icc.clone()) }
    }

    /// Removes an alpha channel that the decoder adds to all pictures of the format, if it is opaque.
    pub fn without_idle_alpha(&self, picture: DynamicImage) -> DynamicImage {
        match picture {
            DynamicImage::ImageRgba8(picture) if self.always_has_alpha && picture.pixels().all(|p| p.0[3] == 255) => {
                DynamicImage::ImageRgba8(picture).into_rgb8().into()
            }
            other => other,
        }
    }
}

/// Reads what the file in `reader` states about its colours: `cICP`, `gAMA` and `cHRM` of PNG, and the profile of TIFF,
/// which `image` 0.25.10 loses for small pictures. The reader is rewound.
///
/// # Errors
/// Errors of `reader`. A truncated file is not an error; its statements are ignored.
pub fn look(reader: &mut (impl BufRead + Seek)) -> io::Result<Stated> {
    let found = match reader.fill_buf()? {
        [0x89, b'P', b'N', b'G', ..] => png(reader),
        [b'I', b'I', 42, 0, ..] | [b'M', b'M', 0, 42, ..] => tiff(reader),
        [b'G', b'I', b'F', b'8', ..] => return Ok(Stated { always_has_alpha: true, ..Stated::default() }),
        _ => return Ok(Stated::default()),
    };
    reader.rewind()?;
    match found {
        Err(e) if e.kind() == ErrorKind::UnexpectedEof => Ok(Stated::default()),
        found => found,
    }
}

/// Returns whether a profile is equivalent to sRGB: all colours have the same 8-bit code values, within 1. Grey
/// profiles are compared with the greys of sRGB.
pub fn is_srgb(icc: &[u8]) -> bool {
    icc.len() <= MAX_COMPARED_BYTES
        && difference_from_srgb(icc).is_some_and(|difference| difference <= MAX_SRGB_DIFFERENCE)
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

fn bytes<const N: usize>(reader: &mut impl Read) -> io::Result<[u8; N]> {
    let mut bytes = [0; N];
    reader.read_exact(&mut bytes)?;
    Ok(bytes)
}

/// Reads the chunks before the samples. `cICP` takes precedence over a profile, and a profile or `sRGB` over `gAMA` and
/// `cHRM`.
fn png(reader: &mut (impl Read + Seek)) -> io::Result<Stated> {
    reader.seek(SeekFrom::Start(8))?;
    let (mut is_grey, mut gamma, mut chromaticities) = (false, None, None);
    let (mut cicp, mut has_better) = (None, false);
    loop {
        let length = u32::from_be_bytes(bytes(reader)?);
        let mut read = 0;
        match (&bytes::<4>(reader)?, length) {
            (b"IHDR", 13) => {
                let header: [u8; 13] = bytes(reader)?;
                (is_grey, read) = ([0, 4].contains(&header[9]), 13);
            }
            (b"cICP", 4) => (cicp, read) = (Some(bytes::<4>(reader)?), 4),
            (b"gAMA", 4) => (gamma, read) = (Some(f64::from(u32::from_be_bytes(bytes(reader)?)) / 1e5), 4),
            (b"cHRM", 32) => {
                let said: [u8; 32] = bytes(reader)?;
                let (values, _) = said.as_chunks::<4>();
                let values: Vec<f64> = values.iter().map(|v| f64::from(u32::from_be_bytes(*v)) / 1e5).collect();
                (chromaticities, read) = (values.try_into().ok(), 32);
            }
            (b"iCCP" | b"sRGB", _) => has_better = true,
            (b"IDAT" | b"IEND", _) => break,
            _ => {}
        }
        reader.seek_relative(i64::from(length) - read + 4)?;
    }
    if let Some(cicp) = cicp {
        return Ok(of_cicp(cicp, is_grey));
    }
    let icc = if has_better { None } else { of_gamma(gamma, chromaticities, is_grey) };
    Ok(Stated { icc, ..Stated::default() })
}

/// Returns the profile of code points (ITU-T H.273): primaries, transfer function, matrix, and whether the range is
/// full.
pub fn of_cicp([primaries, transfer, matrix, range]: [u8; 4], is_grey: bool) -> Stated {
    let note = match (transfer, matrix, range) {
        (16, ..) => Some(
            "its colours use PQ (cICP), which no ICC profile can express; they are kept unchanged and will look pale",
        ),
        (18, ..) => Some(
            "its colours use HLG (cICP), which no ICC profile can express; they are kept unchanged and will look pale",
        ),
        (_, 0, 1..) => None,
        _ => Some(
            "its colours use the limited range of video (cICP), which no ICC profile can express; they are kept unchanged",
        ),
    };
    if note.is_some() {
        return Stated { note, ..Stated::default() };
    }
    let parse = || {
        let color_primaries = CicpColorPrimaries::try_from(primaries).ok()?;
        let transfer_characteristics = TransferCharacteristics::try_from(transfer).ok()?;
        let matrix_coefficients = MatrixCoefficients::Identity;
        // Checked first, because moxcms would make a profile of anything else as well.
        let curve = ToneReprCurve::try_from(transfer_characteristics).ok()?;
        ColorPrimaries::try_from(color_primaries).ok()?;
        let cicp = CicpProfile { color_primaries, transfer_characteristics, matrix_coefficients, full_range: true };
        Some((ColorProfile::new_from_cicp(cicp), curve))
    };
    let icc = parse().and_then(|(rgb, curve)| encoded(rgb, curve, is_grey));
    Stated { is_first: icc.is_some(), icc, ..Stated::default() }
}

/// Returns the profile of a `gAMA` and a `cHRM` chunk; `None` if they are equivalent to sRGB.
fn of_gamma(gamma: Option<f64>, chromaticities: Option<[f64; 8]>, is_grey: bool) -> Option<Vec<u8>> {
    // The decoding exponents are within the range of a profile's curve.
    let exponent = gamma.filter(|g| (0.05..=20.0).contains(g)).map(f64::recip);
    let is_usual = exponent.is_none_or(|e| (e / 2.2 - 1.0).abs() < GAMMA_TOLERANCE);
    let [wx, wy, primaries @ ..] = chromaticities.filter(is_valid).unwrap_or(SRGB);
    let is_srgb = |c: &[f64]| c.iter().zip(SRGB).all(|(a, b)| (a - b).abs() < CHROMATICITY_TOLERANCE);
    let has_its_colors = is_grey || is_srgb(&[&[wx, wy], &primaries[..]].concat());
    if is_usual && has_its_colors {
        return None;
    }
    let mut profile = ColorProfile::new_srgb();
    let curve = match exponent {
        Some(exponent) if !is_usual => curve_from_gamma(exponent as f32),
        _ => profile.red_trc.clone()?,
    };
    if !has_its_colors {
        let at = |k: usize| Chromaticity::new(primaries[k] as f32, primaries[k + 1] as f32);
        profile.update_rgb_colorimetry(XyY::new(wx, wy, 1.0), ColorPrimaries { red: at(0), green: at(2), blue: at(4) });
    }
    encoded(profile, curve, is_grey)
}

/// Returns whether the chromaticities are those of a white point and three primaries that span an area.
fn is_valid(c: &[f64; 8]) -> bool {
    let [_, _, rx, ry, gx, gy, bx, by] = *c;
    let area = (gx - rx) * (by - ry) - (bx - rx) * (gy - ry);
    c.iter().all(|v| (0.0..=1.0).contains(v)) && [1, 3, 5, 7].iter().all(|&k| c[k] > 1e-3) && area.abs() > 1e-3
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
    let mut icc = profile.encode().ok()?;
    // moxcms writes the current time into the header, but equal pictures must give equal files.
    icc.get_mut(24..36)?.copy_from_slice(&CREATION_DATE);
    Some(icc)
}

/// Reads the profile of the first directory. `image` limits the values of a tag to 1/32 of the samples.
fn tiff(reader: &mut (impl Read + Seek)) -> io::Result<Stated> {
    let head: [u8; 8] = bytes(reader)?;
    let short = |b: [u8; 2]| if head[0] == b'I' { u16::from_le_bytes(b) } else { u16::from_be_bytes(b) };
    let long = |b: [u8; 4]| if head[0] == b'I' { u32::from_le_bytes(b) } else { u32::from_be_bytes(b) };
    reader.seek(SeekFrom::Start(u64::from(long([head[4], head[5], head[6], head[7]]))))?;
    let entries = short(bytes(reader)?);
    for _ in 0..entries {
        let (tag, _kind, count) = (short(bytes(reader)?), short(bytes(reader)?), long(bytes(reader)?));
        let offset = long(bytes(reader)?);
        // Tag 34675. Shorter values contain no header.
        if tag == 34675 && (128..=MAX_TIFF_PROFILE_BYTES).contains(&count) {
            reader.seek(SeekFrom::Start(u64::from(offset)))?;
            let mut icc = Vec::new();
            reader.take(u64::from(count)).read_to_end(&mut icc)?;
            let icc = (icc.len() as u64 == u64::from(count)).then_some(icc);
            return Ok(Stated { icc, ..Stated::default() });
        }
    }
    Ok(Stated::default())
}

#[cfg(test)]
mod tests {
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
    fn code_points_become_a_profile_or_a_note() {
        let p3 = of_cicp([12, 13, 0, 1], false);
        let expected = primaries(&encode(&ColorProfile::new_display_p3()));
        let found = primaries(p3.icc.as_ref().unwrap());
        assert!(found.iter().flatten().zip(expected.iter().flatten()).all(|(a, b)| (a - b).abs() < 1e-3), "{found:?}");
        assert!(p3.is_first && p3.note.is_none());
        assert!(is_srgb(&of_cicp([1, 13, 0, 1], false).icc.unwrap()));
        for unsaid in [[9, 16, 0, 1], [9, 18, 0, 1], [1, 13, 0, 0], [1, 13, 1, 1]] {
            let found = of_cicp(unsaid, false);
            assert!(found.icc.is_none() && found.note.is_some());
        }
        for unknown in [[2, 2, 0, 1], [255, 13, 0, 1], [1, 255, 0, 1]] {
            assert_eq!(of_cicp(unknown, false), Stated::default());
        }
    }
}
