//! Rows of stiff and extreme cases: what each does to the worst error, and what guards it. The test suite prints them.

/// One row of the table.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    pub group: String,
    pub case: String,
    /// The worst that was seen, in the unit of `bound`.
    pub worst: f64,
    /// Bound on it.
    pub bound: Bound,
    /// Part of the code that keeps it within the bound.
    pub guard: String,
}

/// The promise of a row.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Bound {
    /// At most this many 8-bit code values from the f64 definition.
    Codes(f64),
    /// At least this many decibels above the picture of one constant colour, or above an earlier state of the same fit.
    Gain(f64),
    /// A relative error of at most this.
    Relative(f64),
    /// Nothing: it is there to be known.
    Reported,
}

impl Row {
    pub fn holds(&self) -> bool {
        match self.bound {
            Bound::Codes(most) | Bound::Relative(most) => self.worst <= most,
            Bound::Gain(least) => self.worst >= least,
            Bound::Reported => true,
        }
    }

    /// How near its bound the row is, for finding the worst of several; NaN counts as the worst.
    pub fn badness(&self) -> f64 {
        let v = match self.bound {
            Bound::Codes(most) | Bound::Relative(most) => self.worst / most,
            Bound::Gain(least) => least - self.worst,
            Bound::Reported => self.worst,
        };
        if v.is_nan() { f64::INFINITY } else { v }
    }
}

/// Reads the rows that the tests print, tab-separated and marked, among other lines.
pub fn parse(text: &str) -> Vec<Row> {
    let rows = text.lines().filter_map(|line| {
        // The harness of tests may have begun the line.
        let line = &line[line.find("stability\t")?..];
        let cells: Vec<&str> = line.trim().split('\t').collect();
        let ["stability", group, case, worst, unit, bound, guard] = cells[..] else { return None };
        let bound: f64 = bound.parse().ok()?;
        let bound = match unit {
            "codes" => Bound::Codes(bound),
            "gain" => Bound::Gain(bound),
            "reported" => Bound::Reported,
            _ => Bound::Relative(bound),
        };
        let worst = worst.parse().unwrap_or(f64::NAN);
        Some(Row { group: group.into(), case: case.into(), worst, bound, guard: guard.into() })
    });
    rows.collect()
}
