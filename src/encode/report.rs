//! What an encode did without, and what that saved.

/// Something that the encoder did without, because the picture or the options do not need it or it was not to be had.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct LeftOut {
    /// What it is, a colon, and why.
    pub what: String,
    /// Bytes saved; 0 where it saves only time, which then buys quality, or nothing that was measured.
    pub bytes: u64,
    /// Seconds saved, estimated from the cost of one iteration with and without it; 0 where that is not known.
    pub seconds: f64,
}

/// All of it, in the order in which it was found.
#[derive(Debug, Default)]
pub(super) struct Savings(Vec<LeftOut>);

impl Savings {
    /// Notes what was left out, in place of what an earlier attempt left out for the same reason.
    pub(super) fn note(&mut self, what: impl Into<String>, bytes: u64, seconds: f64) {
        let what = what.into();
        self.0.retain(|l| l.what != what);
        self.0.push(LeftOut { what, bytes, seconds });
    }

    /// Notes what was the first to be left out, and how many seconds that saved.
    pub(super) fn note_first(&mut self, what: &str, seconds: f64) {
        self.0.insert(0, LeftOut { what: what.to_owned(), bytes: 0, seconds });
    }

    pub(super) fn into_list(self) -> Vec<LeftOut> {
        self.0
    }
}
