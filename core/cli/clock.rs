//! Times for people and for records: UTC, no time zones, no locale.

use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// `2026-11-22T13:11:24Z`, ISO 8601.
pub fn iso(time: SystemTime) -> String {
    let seconds = time.duration_since(UNIX_EPOCH).unwrap_or_default().as_secs();
    let (days, of_day) = (seconds / 86_400, seconds % 86_400);
    let (year, month, day) = date(days);
    format!("{year:04}-{month:02}-{day:02}T{:02}:{:02}:{:02}Z", of_day / 3600, of_day / 60 % 60, of_day % 60)
}

/// `2026-11-22 13:11:24 UTC`.
pub fn plain(time: SystemTime) -> String {
    iso(time).replace('T', " ").replace('Z', " UTC")
}

/// Year, month and day of a day since 1970-01-01, by counting whole years, then whole months.
fn date(mut days: u64) -> (u64, u64, u64) {
    let leap = |year: u64| year.is_multiple_of(4) && (!year.is_multiple_of(100) || year.is_multiple_of(400));
    // 400 years have 146,097 days.
    let mut year = 1970 + 400 * (days / 146_097);
    days %= 146_097;
    while days >= 365 + u64::from(leap(year)) {
        days -= 365 + u64::from(leap(year));
        year += 1;
    }
    let february = 28 + u64::from(leap(year));
    let mut month = 1;
    for length in [31, february, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31] {
        if days < length {
            break;
        }
        days -= length;
        month += 1;
    }
    (year, month, days + 1)
}

/// `0.42 s`, `12.3 s`, `3 min 20 s`, `2 h 05 min`.
pub fn span(seconds: f64) -> String {
    let whole = seconds.max(0.0).round() as u64;
    match seconds {
        seconds if seconds < 1.0 => format!("{seconds:.2} s"),
        seconds if seconds < 60.0 => format!("{seconds:.1} s"),
        seconds if seconds < 3600.0 => format!("{} min {:02} s", whole / 60, whole % 60),
        _ => format!("{} h {:02} min", whole / 3600, whole / 60 % 60),
    }
}

/// How long ago, in the largest unit that fits.
pub fn ago(time: SystemTime) -> String {
    let past = SystemTime::now().duration_since(time).unwrap_or(Duration::ZERO).as_secs();
    let (count, unit) = match past {
        0..60 => (past, "s"),
        60..3600 => (past / 60, "min"),
        3600..172_800 => (past / 3600, "h"),
        _ => (past / 86_400, "days"),
    };
    format!("{count} {unit} ago")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_follow_the_calendar() {
        let at = |seconds| iso(UNIX_EPOCH + Duration::from_secs(seconds));
        // As `date -u -d @SECONDS` gives them.
        assert_eq!(at(0), "1970-01-01T00:00:00Z");
        assert_eq!(at(951_782_399), "2000-02-28T23:59:59Z");
        assert_eq!(at(951_782_400), "2000-02-29T00:00:00Z");
        assert_eq!(at(1_709_251_199), "2024-02-29T23:59:59Z");
        assert_eq!(at(4_107_542_400), "2100-03-01T00:00:00Z");
        assert_eq!(at(13_569_465_599), "2399-12-31T23:59:59Z");
        assert_eq!(plain(UNIX_EPOCH), "1970-01-01 00:00:00 UTC");
    }

    #[test]
    fn spans_are_short() {
        assert_eq!([0.421, 12.34, 200.0, 7500.0].map(span), ["0.42 s", "12.3 s", "3 min 20 s", "2 h 05 min"]);
    }
}
