//! Rows of the table of stiff and extreme cases: the worst error of each, and the measure that bounds it.

/// One row of the table.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    pub group: String,
    pub case: String,
    /// The worst value that occurred, in the unit of `bound`.
    pub worst: f64,
    /// The bound on the worst value.
    pub bound: Bound,
    /// The measure that bounds it.
    pub guard: String,
}

/// The guarantee of a row.
#[derive(Debug, Clone, Copy, PartialEq)]
#[allow(dead_code, reason = "those outside and those inside promise different things")]
pub enum Bound {
    /// At most this many 8-bit code values from the f64 definition.
    Codes(f64),
    /// At least this many decibels above the picture of one constant colour, or above an earlier state of the same fit.
    Gain(f64),
    /// A relative error of at most this.
    Relative(f64),
    /// No bound: the value is only reported.
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

    #[allow(dead_code, reason = "the report only reads them")]
    /// Formats the row as one line of tab-separated text.
    pub fn line(&self) -> String {
        let (unit, bound) = match self.bound {
            Bound::Codes(v) => ("codes", v),
            Bound::Gain(v) => ("gain", v),
            Bound::Relative(v) => ("relative", v),
            Bound::Reported => ("reported", 0.0),
        };
        format!("stability\t{}\t{}\t{:.3e}\t{unit}\t{bound:e}\t{}", self.group, self.case, self.worst, self.guard)
    }
}
