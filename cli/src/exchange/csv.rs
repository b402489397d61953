//! Parameters as CSV: a comment line with the properties of the picture, a line of column names, and a line per
//! Gaussian.

use ssplat::{Channels, Limits};

use super::parameters::{self, Given, Parameters};
use super::problem::{Problem, shown};
use super::stated::{self, Stated};

/// Start of the comment line.
const COMMENT: &str = "# ssplat ";

/// Names of the columns before the colours.
const COLUMNS: [&str; 8] = ["x", "y", "scale_major", "scale_minor", "rotation", "cov_xx", "cov_xy", "cov_yy"];

/// Names of the colour columns.
fn color_columns(channels: Channels) -> &'static [&'static str] {
    match channels {
        Channels::Grey => &["grey"],
        Channels::GreyAlpha => &["grey", "alpha"],
        Channels::Rgb => &["red", "green", "blue"],
        Channels::Rgba => &["red", "green", "blue", "alpha"],
    }
}

/// Writes the table. Numbers have enough digits to restore their 32-bit floats.
pub fn write(of: &Parameters) -> String {
    let p = &of.picture;
    let channels = p.channels.count();
    let mut out = format!("{COMMENT}{}\n", stated::line(of));
    out += &[&COLUMNS[..], color_columns(p.channels)].concat().join(",");
    out += "\n";
    for g in &p.list {
        let shape = [g.mean[0], g.mean[1], g.scale[0], g.scale[1], g.rotation];
        let line: Vec<String> =
            shape.iter().chain(&parameters::covariance(g)).chain(&g.color[..channels]).map(f32::to_string).collect();
        out += &line.join(",");
        out += "\n";
    }
    out
}

/// Reads such a table. Columns may be in any order, unknown columns are ignored, and either scales with rotation or
/// covariances may be missing.
pub fn read(text: &str, given: Given, limits: &Limits) -> Result<Parameters, Problem> {
    let mut lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
    let mut stated = Stated::default();
    let (_, mut line) = lines.next().ok_or("the table is empty")?;
    while let Some(comment) = line.strip_prefix('#') {
        if let Some(line) = comment.strip_prefix(' ').and_then(|c| c.strip_prefix(stated::START)) {
            stated.add(line)?;
        }
        line = lines.next().ok_or("the table has no line of names")?.1;
    }
    let names: Vec<&str> = line.split(',').map(str::trim).collect();
    let find = |name: &str| names.iter().position(|n| *n == name);
    let all = |wanted: &[&str]| wanted.iter().map(|name| find(name)).collect::<Option<Vec<_>>>();
    let means = all(&COLUMNS[..2]).ok_or("the table has no columns x and y")?;
    let shape = all(&COLUMNS[2..5]);
    let covariance = all(&COLUMNS[5..]);
    // The longest list that is present, because a picture with alpha also has the columns of one without.
    let (channels, colors) = [Channels::Rgba, Channels::Rgb, Channels::GreyAlpha, Channels::Grey]
        .into_iter()
        .find_map(|c| Some((c, all(color_columns(c))?)))
        .ok_or("the table has neither columns red, green and blue nor a column grey")?;
    let mut gaussians = Vec::new();
    if shape.is_none() && covariance.is_none() {
        return Err("the table has neither scale_major, scale_minor and rotation nor cov_xx, cov_xy and cov_yy".into());
    }
    for (number, line) in lines {
        Problem::limit("gaussians", gaussians.len() as u64 + 1, limits.gaussians)?;
        let fields: Vec<&str> = line.split(',').map(str::trim).take(names.len()).collect();
        let value = |column: usize| {
            let field = fields.get(column).copied().unwrap_or("");
            let problem =
                || format!("line {}: {} is '{}', not a finite number", number + 1, names[column], shown(field));
            field.parse::<f64>().ok().filter(|v| v.is_finite()).ok_or_else(problem)
        };
        let values = |columns: &[usize]| columns.iter().map(|&c| value(c)).collect::<Result<Vec<f64>, String>>();
        let mean = values(&means)?;
        let (scale, rotation) = match (&shape, &covariance) {
            (None, Some(columns)) => {
                let v = values(columns)?;
                let problem = || format!("line {}: covariance {v:?} is not positive definite", number + 1);
                parameters::of_covariance([v[0], v[1], v[2]]).ok_or_else(problem)?
            }
            (shape, _) => {
                let v = values(shape.as_deref().unwrap_or_default())?;
                parameters::ordered([v[0], v[1]], v[2])
            }
        };
        gaussians.push(parameters::gaussian([mean[0], mean[1]], scale, rotation, &values(&colors)?));
    }
    stated.parameters(gaussians, channels, given, "the table has")
}

#[cfg(test)]
mod tests {
    use super::*;
    use ssplat::Blend;

    #[test]
    fn a_table_says_what_is_wrong_and_where() {
        let head = "# ssplat size=8x8;blend=sum\nx,y,scale_major,scale_minor,rotation,red,green,blue\n";
        for (text, problem) in [
            (String::new(), "empty"),
            ("# ssplat size=8x8;blend=sum\n".into(), "no line of names"),
            (format!("{head}1,2,3,1,0,0.5,0.5,zero\n"), "line 3: blue is 'zero'"),
            (format!("{head}1,2,3\n"), "line 3: scale_minor is ''"),
            (head.replace("8x8", "8"), "size is 8"),
            (head.replace("sum", "max"), "blend is max"),
            (head.replace("size=8x8;", ""), "--size"),
            (head.replace("blend=sum", ""), "--blend"),
            (head.replace("red", "rot"), "red, green and blue"),
            (format!("{}1,2,3,1,0,0.5,0.5,0\n", head.replace("rotation", "turn")), "neither scale_major"),
            (head.replace("sum", "sum;background=1"), "1 channels"),
            (head.replace("sum", "sum;background=1 inf 0"), "'inf' is not a finite"),
            (head.replace("8x8", "8x2000000"), "size is 8x2000000"),
            (format!("{head}1,NaN,3,1,0,0.5,0.5,0\n"), "line 3: y is 'NaN', not a finite number"),
            (format!("{head}1,2,3,-inf,0,0.5,0.5,0\n"), "line 3: scale_minor is '-inf'"),
            (format!("{head}{},2,3,1,0,0.5,0.5,0\n", "9x".repeat(1000)), "…'"),
            ("# ssplat size=8x8;blend=sum\nx,y,cov_xx,cov_xy,cov_yy,grey\n1,2,1,2,4,1\n".into(), "positive definite"),
        ] {
            let error = read(&text, Given::default(), &Limits::default()).unwrap_err().to_string();
            assert!(error.contains(problem), "{error} lacks {problem}");
        }
    }

    #[test]
    fn more_lines_than_are_allowed_are_a_limit() {
        let text = "x,y,cov_xx,cov_xy,cov_yy,grey\n".to_owned() + &"1,2,4,0,9,0.5\n".repeat(3);
        let mut limits = Limits::default();
        limits.gaussians = 2;
        let given = Given { size: Some([8, 8]), blend: Some(Blend::Sum) };
        let allowed = 2;
        let problem = Problem::TooMuch { what: "gaussians".into(), requested: 3, allowed };
        assert_eq!(read(&text, given, &limits), Err(problem));
        limits.gaussians = 3;
        assert_eq!(read(&text, given, &limits).unwrap().picture.list.len(), 3);
    }

    #[test]
    fn what_the_caller_gives_goes_before_what_the_table_says() {
        let text = "# ssplat size=8x8;blend=sum\nx,y,cov_xx,cov_xy,cov_yy,grey\n1,2,4,0,9,0.5\n";
        let given = Given { size: Some([20, 10]), blend: Some(Blend::Normalized) };
        let found = read(text, given, &Limits::default()).unwrap().picture;
        assert_eq!(
            (found.width, found.height, found.blend, found.channels),
            (20, 10, Blend::Normalized, Channels::Grey)
        );
        assert_eq!(found.list[0].scale, [3.0, 2.0]);
        assert!((found.list[0].rotation - std::f32::consts::FRAC_PI_2).abs() < 1e-6);
    }
}
