//! What can be wrong with plain data: lengths, times, values that are not finite.

/// What can be wrong with plain data.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SpaceError {
    /// A buffer's length contradicts its declared size.
    #[error("{what} holds {found} values where {expected} were expected")]
    Length {
        /// The buffer.
        what: &'static str,
        /// Wanted number of values.
        expected: usize,
        /// Found number of values.
        found: usize,
    },
    /// Times are not finite and strictly increasing.
    #[error("{what}: time {index} ({seconds} s) is not after the one before it, or not finite")]
    Times {
        /// The sequence.
        what: &'static str,
        /// First offending index.
        index: usize,
        /// Its value.
        seconds: f64,
    },
    /// A value is not finite.
    #[error("{what}: value {index} (at {seconds:.3} s) is {value}; remove or interpolate it first")]
    NotFinite {
        /// The sequence.
        what: &'static str,
        /// First offending index.
        index: usize,
        /// Its time.
        seconds: f64,
        /// Its value.
        value: f64,
    },
    /// A series does not reach over the times asked for.
    #[error("{what} spans {from:.3}–{to:.3} s but {wanted_from:.3}–{wanted_to:.3} s is needed")]
    Span {
        /// The sequence.
        what: &'static str,
        /// First time present.
        from: f64,
        /// Last time present.
        to: f64,
        /// First time wanted.
        wanted_from: f64,
        /// Last time wanted.
        wanted_to: f64,
    },
    /// A table's column has no name, another's name, or cells of two kinds.
    #[error(
        "column {index} of a table is named `{name}`: names must be there and unique, and cells all words or all figures"
    )]
    Column {
        /// Its name.
        name: String,
        /// Its place.
        index: usize,
    },
    /// Entries are not in increasing order.
    #[error("{0} are not in increasing order")]
    Order(&'static str),
    /// There is nothing in it.
    #[error("{0} is empty")]
    Empty(&'static str),
}
