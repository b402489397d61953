//! Points for splat viewers: the PLY of 3D Gaussian Splatting (Kerbl et al., 2023), flat in z.
//!
//! x to the right and y down in pixels, z 0; scales as natural logarithms, rotations as quaternions w, x, y, z about z,
//! colours as coefficients of the constant spherical harmonic, opacity as a logit. Viewers composite the points by
//! opacity, so they show the Gaussians and not the picture. A comment has the properties of the picture, and a last
//! property the alpha, which viewers ignore; with both, an import gives the same Gaussians.

use ssplat::{Channels, Gaussian, Limits};

use super::parameters::{self, Given, Parameters};
use super::problem::{Problem, shown};
use super::stated::{self, Stated};

/// The constant spherical harmonic, `1/(2·√π)`.
const HARMONIC: f32 = 0.282_094_8;

/// Opacity of Gaussians without alpha, and the largest opacity, because the logit of 1 is infinite.
const OPAQUE: f32 = 0.999;

/// Thickness in units of the minor scale.
const THICKNESS: f32 = 1e-3;

/// Properties of a point, in order.
const PROPERTIES: [&str; 17] = [
    "x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2", "rot_0",
    "rot_1", "rot_2", "rot_3",
];

/// The property that holds alpha as it is.
const ALPHA: &str = "alpha";

/// Largest length of a header. Files of 3D Gaussian Splatting have 62 properties in 1.5 kB.
const MOST_HEADER: usize = 64 << 10;

/// Largest sine of half the angle about another axis than z, where 1 is the length of the quaternion.
const TILT: f64 = 1e-3;

/// Returns the file.
pub fn write(of: &Parameters) -> Vec<u8> {
    let picture = &of.picture;
    let mut header = format!(
        "ply\nformat binary_little_endian 1.0\ncomment {}{}\nelement vertex {}\n",
        stated::START,
        stated::line(of),
        picture.list.len()
    );
    let alpha = picture.channels.alpha();
    for property in PROPERTIES.iter().chain(alpha.map(|_| &ALPHA)) {
        header += &format!("property float {property}\n");
    }
    header += "end_header\n";
    let mut out = header.into_bytes();
    for g in &picture.list {
        let [red, green, blue] = match picture.channels {
            Channels::Grey | Channels::GreyAlpha => [g.color[0]; 3],
            Channels::Rgb | Channels::Rgba => [g.color[0], g.color[1], g.color[2]],
        };
        let opacity = alpha.map_or(OPAQUE, |k| g.color[k].clamp(1.0 - OPAQUE, OPAQUE));
        let (sin, cos) = (0.5 * g.rotation).sin_cos();
        let [s1, s2] = g.scale;
        let point: [f32; PROPERTIES.len()] = [
            g.mean[0],
            g.mean[1],
            0.0,
            0.0,
            0.0,
            1.0,
            (red - 0.5) / HARMONIC,
            (green - 0.5) / HARMONIC,
            (blue - 0.5) / HARMONIC,
            (opacity / (1.0 - opacity)).ln(),
            s1.ln(),
            s2.ln(),
            (THICKNESS * s2).ln(),
            cos,
            0.0,
            0.0,
            sin,
        ];
        out.extend(point.iter().chain(alpha.map(|k| &g.color[k])).flat_map(|v| v.to_le_bytes()));
    }
    out
}

/// How the vertices are stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Encoding {
    Ascii,
    Little,
    Big,
}

/// Types of properties.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Kind {
    fn of(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Kind::I8,
            "uchar" | "uint8" => Kind::U8,
            "short" | "int16" => Kind::I16,
            "ushort" | "uint16" => Kind::U16,
            "int" | "int32" => Kind::I32,
            "uint" | "uint32" => Kind::U32,
            "float" | "float32" => Kind::F32,
            "double" | "float64" => Kind::F64,
            _ => return None,
        })
    }

    fn bytes(self) -> usize {
        match self {
            Kind::I8 | Kind::U8 => 1,
            Kind::I16 | Kind::U16 => 2,
            Kind::I32 | Kind::U32 | Kind::F32 => 4,
            Kind::F64 => 8,
        }
    }

    /// Returns the value in `bytes`, which has at least [`Kind::bytes`] bytes.
    fn value(self, bytes: &[u8], encoding: Encoding) -> f64 {
        let mut stored = [0; 8];
        let n = self.bytes();
        stored[..n].copy_from_slice(&bytes[..n]);
        if encoding == Encoding::Big {
            stored[..n].reverse();
        }
        let [a, b, c, d, ..] = stored;
        match self {
            Kind::I8 => f64::from(a as i8),
            Kind::U8 => f64::from(a),
            Kind::I16 => f64::from(i16::from_le_bytes([a, b])),
            Kind::U16 => f64::from(u16::from_le_bytes([a, b])),
            Kind::I32 => f64::from(i32::from_le_bytes([a, b, c, d])),
            Kind::U32 => f64::from(u32::from_le_bytes([a, b, c, d])),
            Kind::F32 => f64::from(f32::from_le_bytes([a, b, c, d])),
            Kind::F64 => f64::from_le_bytes(stored),
        }
    }
}

/// What the header states.
struct Header {
    encoding: Encoding,
    vertices: u64,
    properties: Vec<(String, Kind)>,
    stated: Stated,
    /// Whether an export of ssplat wrote the file.
    is_own: bool,
    /// Length in bytes and in lines.
    length: (usize, usize),
}

impl Header {
    /// Reads the header of `file`; `vertex` must be its first element, and have no lists.
    fn read(file: &[u8]) -> Result<Self, Problem> {
        let mut at = 0;
        let mut number = 0;
        let mut line = || -> Result<(usize, usize, &str), Problem> {
            let rest = &file[at..file.len().min(MOST_HEADER)];
            let Some(length) = rest.iter().position(|&b| b == b'\n') else {
                return Err(format!("the header has no end_header in its first {MOST_HEADER} bytes").into());
            };
            (at, number) = (at + length + 1, number + 1);
            let text = std::str::from_utf8(&rest[..length]).map_err(|_| format!("line {number} is not UTF-8 text"))?;
            Ok((at, number, text.trim()))
        };
        if !file.starts_with(b"ply") || line()?.2 != "ply" {
            return Err("the file does not begin with 'ply'".into());
        }
        let (mut encoding, mut vertices, mut elements) = (None, None, 0);
        let (mut stated, mut is_own) = (Stated::default(), false);
        let mut properties: Vec<(String, Kind)> = Vec::new();
        let length = loop {
            let (at, number, text) = line()?;
            let illegal = || Problem::from(format!("line {number} is '{}'", shown(text)));
            let (word, rest) = text.split_once(' ').unwrap_or((text, ""));
            let words: Vec<&str> = rest.split_whitespace().take(3).collect();
            match (word, &words[..]) {
                ("format", [name, "1.0"]) => {
                    encoding = Some(match *name {
                        "ascii" => Encoding::Ascii,
                        "binary_little_endian" => Encoding::Little,
                        "binary_big_endian" => Encoding::Big,
                        _ => return Err(illegal()),
                    });
                }
                ("comment", _) => {
                    if let Some(line) = rest.strip_prefix(stated::START) {
                        stated.add(line)?;
                        is_own |= stated.background().is_some();
                    }
                }
                ("obj_info", _) | ("", _) => {}
                ("element", [name, count]) => {
                    elements += 1;
                    let count = count.parse::<u64>().map_err(|_| illegal())?;
                    match (*name, elements) {
                        ("vertex", 1) => vertices = Some(count),
                        (_, 1) => {
                            return Err(
                                format!("line {number}: the first element is {}, not vertex", shown(name)).into()
                            );
                        }
                        // What follows the vertices is not read.
                        _ => {}
                    }
                }
                ("property", _) if elements == 0 => return Err(illegal()),
                ("property", _) if elements > 1 => {}
                ("property", ["list", ..]) => {
                    return Err(format!("line {number}: a vertex has a list, '{}'", shown(text)).into());
                }
                ("property", [kind, name]) => {
                    let kind = Kind::of(kind).ok_or_else(illegal)?;
                    if properties.iter().any(|(other, _)| other == name) {
                        return Err(format!("line {number}: the property {} is there twice", shown(name)).into());
                    }
                    properties.push(((*name).to_owned(), kind));
                }
                ("end_header", []) => break (at, number),
                _ => return Err(illegal()),
            }
        };
        Ok(Header {
            encoding: encoding.ok_or("the header has no format")?,
            vertices: vertices.ok_or("the header has no element vertex")?,
            properties,
            stated,
            is_own,
            length,
        })
    }

    /// Returns the place of a property.
    fn find(&self, name: &str) -> Option<usize> {
        self.properties.iter().position(|(other, _)| other == name)
    }

    /// Returns the places of properties, all of which must be there.
    fn all<const N: usize>(&self, names: [&str; N]) -> Result<[usize; N], Problem> {
        let mut places = [0; N];
        for (place, name) in places.iter_mut().zip(names) {
            *place = self.find(name).ok_or_else(|| format!("a vertex has no property {name}"))?;
        }
        Ok(places)
    }
}

/// The place of a vertex, for messages: "vertex 12" or "line 31".
#[derive(Debug, Clone, Copy)]
struct Place(&'static str, u64);

/// The values of one vertex, and its place for messages.
struct Vertex<'a> {
    values: &'a [f64],
    place: Place,
    header: &'a Header,
}

impl Vertex<'_> {
    /// Returns values, which must be finite.
    fn get<const N: usize>(&self, places: [usize; N]) -> Result<[f64; N], Problem> {
        for place in places {
            if !self.values[place].is_finite() {
                return Err(self.problem(place, "not a finite number"));
            }
        }
        Ok(places.map(|place| self.values[place]))
    }

    fn problem(&self, place: usize, what: &str) -> Problem {
        let Place(what_is, number) = self.place;
        format!("{what_is} {number}: {} is {}, {what}", self.header.properties[place].0, self.values[place]).into()
    }
}

/// Reads points that lie in one plane, with their rotations about z. Returns the parameters, and a note if the points
/// have an opacity that is left out.
pub fn read(file: &[u8], given: Given, limits: &Limits) -> Result<(Parameters, Option<&'static str>), Problem> {
    let header = Header::read(file)?;
    Problem::limit("gaussians", header.vertices, limits.gaussians)?;
    let means = header.all(["x", "y"])?;
    let scales = header.all(["scale_0", "scale_1"])?;
    let turns = header.all(["rot_0", "rot_1", "rot_2", "rot_3"])?;
    let colors = header.all(["f_dc_0", "f_dc_1", "f_dc_2"])?;
    let (depth, alpha) = (header.find("z"), header.find(ALPHA));
    let channels = match (header.stated.background(), alpha) {
        (Some(1), _) => Channels::Grey,
        (Some(2), Some(_)) => Channels::GreyAlpha,
        (Some(2 | 4), None) => return Err(format!("a vertex has no property {ALPHA}").into()),
        (Some(3), _) | (_, None) => Channels::Rgb,
        (_, Some(_)) => Channels::Rgba,
    };
    let mut rows = Rows::new(file, &header)?;
    // At least eleven properties of a byte each, so no more than the file has bytes.
    let mut list: Vec<Gaussian> = Vec::new();
    if header.encoding != Encoding::Ascii {
        list.reserve_exact(header.vertices as usize);
    }
    let mut values = vec![0.0; header.properties.len()];
    let mut plane = None;
    for i in 0..header.vertices {
        let place = rows.next(i, &mut values)?;
        let vertex = Vertex { values: &values, place, header: &header };
        let mean = vertex.get(means)?;
        if let Some(depth) = depth {
            let [z] = vertex.get([depth])?;
            if *plane.get_or_insert(z) != z {
                return Err(vertex.problem(depth, "so the vertices do not lie in one plane"));
            }
        }
        vertex.get(scales)?;
        let scale = scales.map(|place| values[place].exp());
        for (place, scale) in scales.into_iter().zip(scale) {
            if !(scale as f32).is_finite() || scale as f32 <= 0.0 {
                return Err(vertex.problem(place, "not the logarithm of a size in pixels"));
            }
        }
        let [w, x, y, z] = vertex.get(turns)?;
        let length = [w, x, y, z].into_iter().fold(0.0, f64::hypot);
        if length.is_nan() || length <= 0.0 {
            return Err(vertex.problem(turns[0], "and so are the others, which is no rotation"));
        }
        for (place, tilt) in [(turns[1], x), (turns[2], y)] {
            if (tilt / length).abs() > TILT {
                return Err(vertex.problem(place, "so the vertex is not turned about z alone"));
            }
        }
        let (scale, rotation) = parameters::ordered(scale, 2.0 * z.atan2(w));
        let mut color = vertex.get(colors)?.map(|c| c * f64::from(HARMONIC) + 0.5).to_vec();
        color.truncate(channels.count() - usize::from(channels.alpha().is_some()));
        if let (Some(alpha), Some(_)) = (alpha, channels.alpha()) {
            color.extend(vertex.get([alpha])?);
        }
        list.push(parameters::gaussian(mean, scale, rotation, &color));
    }
    let note = !header.is_own && header.find("opacity").is_some();
    let note = note.then_some("opacity is left out: the colours are blended by the Gaussians' weights alone");
    Ok((header.stated.parameters(list, channels, given, "vertices have")?, note))
}

/// The vertices of a file, one after another.
enum Rows<'a> {
    Text { lines: std::str::Lines<'a>, number: usize },
    Bytes { body: &'a [u8], stride: usize, kinds: Vec<Kind>, encoding: Encoding },
}

impl<'a> Rows<'a> {
    fn new(file: &'a [u8], header: &Header) -> Result<Self, Problem> {
        let (at, number) = header.length;
        let body = &file[at..];
        if header.encoding == Encoding::Ascii {
            let text = std::str::from_utf8(body).map_err(|e| format!("no text: {e}"))?;
            return Ok(Rows::Text { lines: text.lines(), number });
        }
        let kinds: Vec<Kind> = header.properties.iter().map(|p| p.1).collect();
        let stride = kinds.iter().map(|kind| kind.bytes()).sum::<usize>();
        // Both are far below 2³².
        let needed = header.vertices * stride as u64;
        if (body.len() as u64) < needed {
            let (n, has) = (header.vertices, body.len());
            return Err(format!("{n} vertices take {needed} bytes, but {has} follow the header").into());
        }
        Ok(Rows::Bytes { body, stride, kinds, encoding: header.encoding })
    }

    /// Reads the next vertex, the one of number `i`, and returns its place for messages.
    fn next(&mut self, i: u64, values: &mut [f64]) -> Result<Place, Problem> {
        match self {
            Rows::Bytes { body, stride, kinds, encoding } => {
                let (mut row, rest) = body.split_at(*stride);
                *body = rest;
                for (value, kind) in values.iter_mut().zip(kinds) {
                    *value = kind.value(row, *encoding);
                    row = &row[kind.bytes()..];
                }
                Ok(Place("vertex", i))
            }
            Rows::Text { lines, number } => {
                *number += 1;
                let line = lines.next().ok_or_else(|| format!("the file ends before vertex {i}"))?;
                let mut fields = line.split_whitespace();
                for value in values.iter_mut() {
                    let field = fields.next().unwrap_or("");
                    let problem = || format!("line {number}: '{}' is not a number", shown(field));
                    *value = field.parse().map_err(|_| problem())?;
                }
                match fields.next() {
                    Some(field) => Err(format!("line {number}: '{}' is left over", shown(field)).into()),
                    None => Ok(Place("line", *number as u64)),
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ssplat::{Blend, Gaussians};

    #[test]
    fn a_point_has_the_properties_that_viewers_look_for() {
        let g = Gaussian { mean: [3.0, 4.0], scale: [2.0, 0.5], rotation: 1.0, color: [0.5, 1.0, 0.0, 0.0] };
        let (channels, blend) = (Channels::Rgb, Blend::Sum);
        let picture = Gaussians {
            width: 8,
            height: 6,
            channels,
            depth: ssplat::Depth::Eight,
            blend,
            background: [0.0; 4],
            list: vec![g; 2],
        };
        let file = write(&Parameters { picture, stored: None });
        let end = b"end_header\n";
        let at = file.windows(end.len()).position(|w| w == end).unwrap() + end.len();
        let header = String::from_utf8(file[..at].to_vec()).unwrap();
        assert!(header.starts_with("ply\nformat binary_little_endian 1.0\n") && header.contains("element vertex 2\n"));
        let names: Vec<&str> = header.lines().filter_map(|l| l.strip_prefix("property float ")).collect();
        assert_eq!(file.len() - at, 2 * 4 * names.len());
        let value = |name: &str| {
            let from = at + 4 * names.iter().position(|n| *n == name).unwrap();
            f32::from_le_bytes(file[from..from + 4].try_into().unwrap())
        };
        assert_eq!([value("x"), value("y"), value("z")], [3.0, 4.0, 0.0]);
        assert_eq!([value("f_dc_0"), value("f_dc_1") + value("f_dc_2")], [0.0, 0.0]);
        assert!((value("f_dc_1") * 0.282_094_8 - 0.5).abs() < 1e-6);
        assert!((value("scale_0").exp() - 2.0).abs() < 1e-6 && value("scale_2") < value("scale_1"));
        // The x axis, rotated by the quaternion: 1 − 2z² and 2wz.
        let (w, z) = (value("rot_0"), value("rot_3"));
        assert!((1.0 - 2.0 * z * z - 1f32.cos()).abs() < 1e-6 && (2.0 * w * z - 1f32.sin()).abs() < 1e-6);
        assert!((1.0 / (1.0 + (-value("opacity")).exp()) - OPAQUE).abs() < 1e-6);
    }

    /// A file of text with one vertex, turned by a right angle.
    const TEXT: &str = "ply\r\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty double y\nproperty float z\n\
        property float f_dc_0\nproperty float f_dc_1\nproperty float f_dc_2\nproperty uchar opacity\n\
        property float scale_0\nproperty float scale_1\nproperty float rot_0\nproperty float rot_1\n\
        property float rot_2\nproperty float rot_3\nelement face 9\nproperty list uchar int vertices\nend_header\n\
        3 4 7 0 0 0 200 0 1 1 0 0 1\n";

    const GIVEN: Given = Given { size: Some([8, 6]), blend: Some(Blend::Sum) };

    #[test]
    fn points_of_other_programs_are_read_as_text_and_in_both_orders_of_bytes() {
        let limits = Limits::default();
        let (found, note) = read(TEXT.as_bytes(), GIVEN, &limits).unwrap();
        let [g] = found.picture.list[..] else { panic!("{found:?}") };
        assert_eq!((g.mean, g.color), ([3.0, 4.0], [0.5, 0.5, 0.5, 0.0]));
        // The second scale is the larger one, across the direction of the rotation.
        assert!((g.scale[0] - 1f32.exp()).abs() < 1e-6 && g.scale[1] == 1.0 && g.rotation.abs() < 1e-6, "{g:?}");
        assert!(note.is_some_and(|note| note.contains("opacity")));
        let fields = [3.0, 4.0, 7.0, 0.0, 0.0, 0.0, 200.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0];
        for (name, is_big) in [("binary_big_endian", true), ("binary_little_endian", false)] {
            let header = TEXT.replace("ascii", name);
            let mut file = header.as_bytes()[..header.find("3 4 7").unwrap()].to_vec();
            for (k, v) in fields.into_iter().enumerate() {
                let mut bytes = match k {
                    1 => f64::to_le_bytes(v).to_vec(),
                    6 => vec![v as u8],
                    _ => (v as f32).to_le_bytes().to_vec(),
                };
                if is_big {
                    bytes.reverse();
                }
                file.extend(bytes);
            }
            assert_eq!(read(&file, GIVEN, &limits).unwrap().0, found, "{name}");
            let problem = read(&file[..file.len() - 1], GIVEN, &limits).unwrap_err().to_string();
            assert_eq!(problem, "1 vertices take 53 bytes, but 52 follow the header");
        }
    }

    #[test]
    fn problems_name_the_line_or_vertex_and_the_property() {
        let text = |from: &str, to: &str| {
            assert!(TEXT.contains(from), "{from}");
            TEXT.replacen(from, to, 1)
        };
        for (file, problem) in [
            (String::new(), "does not begin with 'ply'"),
            ("ply\nformat ascii 1.0\n".into(), "no end_header in its first 65536 bytes"),
            (format!("ply\n{}", "comment a\n".repeat(7000)), "no end_header in its first 65536 bytes"),
            (text("format ascii 1.0\n", ""), "no format"),
            (text("ascii", "base64"), "line 2 is 'format base64 1.0'"),
            (text("float x", "float32x x"), "line 4 is 'property float32x x'"),
            (text("double y", "float x"), "line 5: the property x is there twice"),
            (text("float z", "list uchar int z"), "line 6: a vertex has a list"),
            (text("element vertex 1", "element face 1"), "line 3: the first element is face, not vertex"),
            (text("vertex 1", "vertex -1"), "line 3 is 'element vertex -1'"),
            (text("vertex 1", "vertex 99999999999999999"), "gaussians 99999999999999999 is more than"),
            (text("scale_1", "scale_2"), "a vertex has no property scale_1"),
            (text("3 4 7", "3 NaN 7"), "line 20: y is NaN, not a finite number"),
            (text("3 4 7", "3 four 7"), "line 20: 'four' is not a number"),
            (text("3 4 7", "3 4 7 8"), "line 20: '1' is left over"),
            (text("200 0 1", "200 0 800"), "line 20: scale_1 is 800, not the logarithm of a size"),
            (text("1 0 0 1\n", "1 0.1 0 1\n"), "line 20: rot_1 is 0.1, so the vertex is not turned about z"),
            (text("1 0 0 1\n", "0 0 0 0\n"), "line 20: rot_0 is 0, and so are the others"),
            (text("vertex 1", "vertex 2"), "the file ends before vertex 1"),
            (text("vertex 1", "vertex 2") + "3 4 6 0 0 0 200 0 1 1 0 0 1\n", "line 21: z is 6, so the vertices do not"),
            (text("ply\r\n", "ply\ncomment ssplat background=0 0\n"), "no property alpha"),
            (text("ply\r\n", "ply\ncomment ssplat size=0x9\n"), "size is 0x9"),
        ] {
            let error = read(file.as_bytes(), GIVEN, &Limits::default()).unwrap_err().to_string();
            assert!(error.contains(problem), "{error:?} lacks {problem:?}");
        }
        let unstated = read(TEXT.as_bytes(), Given { size: None, ..GIVEN }, &Limits::default()).unwrap_err();
        assert!(matches!(unstated, Problem::Unstated(text) if text.contains("--size")));
    }
}
