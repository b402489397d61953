//! Errors in exchanged parameters.

use std::fmt;

use crate::failure::Kind;

/// Error that stops an import.
#[derive(Debug, Clone, PartialEq)]
pub enum Problem {
    /// The input is invalid.
    Broken(String),
    /// Neither the input nor the caller states a required value.
    Unstated(String),
    /// The input exceeds the limits.
    TooMuch { what: String, requested: u64, allowed: u64 },
}

impl Problem {
    /// Returns the kind of failure.
    pub fn kind(&self) -> Kind {
        match self {
            Problem::Broken(_) => Kind::Format,
            Problem::Unstated(_) => Kind::Usage,
            Problem::TooMuch { .. } => Kind::Limit,
        }
    }

    /// Adds the array's `name` to the error.
    pub fn of(self, name: &str) -> Problem {
        match self {
            Problem::Broken(text) => Problem::Broken(format!("array {name} {text}")),
            Problem::Unstated(text) => Problem::Unstated(format!("array {name} {text}")),
            Problem::TooMuch { what, requested, allowed } => {
                Problem::TooMuch { what: format!("array {name}: {what}"), requested, allowed }
            }
        }
    }

    /// Returns an error if `requested` is more than `allowed`.
    pub fn limit(what: impl Into<String>, requested: u64, allowed: u64) -> Result<(), Problem> {
        if requested > allowed {
            return Err(Problem::TooMuch { what: what.into(), requested, allowed });
        }
        Ok(())
    }
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Problem::Broken(text) | Problem::Unstated(text) => f.write_str(text),
            Problem::TooMuch { what, requested, allowed } => {
                write!(f, "{what} {requested} is more than the {allowed} that are allowed")
            }
        }
    }
}

impl From<String> for Problem {
    fn from(text: String) -> Self {
        Problem::Broken(text)
    }
}

impl From<&str> for Problem {
    fn from(text: &str) -> Self {
        Problem::Broken(text.into())
    }
}

/// Returns a value of the input for a message, shortened.
pub fn shown(text: &str) -> String {
    let most = 40;
    let short: String = text.chars().take(most).flat_map(char::escape_debug).collect();
    if text.chars().nth(most).is_some() { short + "…" } else { short }
}
