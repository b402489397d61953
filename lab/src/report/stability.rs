//! Reads the rows of stiff and extreme cases that the test suite prints.

#[path = "../../../tests/stiff/row.rs"]
mod row;

pub use row::{Bound, Row};

impl Row {
    /// Returns how close the row is to its bound, for finding the worst of several; NaN counts as the worst.
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
        // The test harness may have started the line.
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
