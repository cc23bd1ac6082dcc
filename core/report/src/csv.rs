//! Tables as CSV (RFC 4180): a header, commas, quotes where needed, lines ended by a line feed.

use heartian_space::{Cells, Table};

/// The table as text. A figure that could not be measured is an empty cell, as spreadsheets and pandas expect.
pub fn table_csv(table: &Table) -> String {
    let mut text = line(table.columns().iter().map(|(name, _)| quoted(name)));
    for row in 0..table.rows() {
        text.push_str(&line(table.columns().iter().map(|(_, cells)| match cells {
            Cells::Text(cells) => quoted(&cells[row]),
            Cells::Numbers(cells) if cells[row].is_nan() => String::new(),
            Cells::Numbers(cells) => cells[row].to_string(),
        })));
    }
    text
}

fn line(cells: impl Iterator<Item = String>) -> String {
    let mut line = cells.collect::<Vec<_>>().join(",");
    line.push('\n');
    line
}

fn quoted(text: &str) -> String {
    if text.contains([',', '"', '\n', '\r']) { format!("\"{}\"", text.replace('"', "\"\"")) } else { text.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use heartian_space::SpaceError;

    #[test]
    fn cells_keep_their_places() -> Result<(), SpaceError> {
        let table = Table::new(vec![
            ("clip".into(), Cells::Text(vec!["a,\"b\"".into(), "c".into()])),
            ("hr_bpm".into(), Cells::Numbers(vec![f64::NAN, 71.25])),
        ])?;
        assert_eq!(table_csv(&table), "clip,hr_bpm\n\"a,\"\"b\"\"\",\nc,71.25\n");
        assert_eq!(table_csv(&Table::default()), "\n");
        Ok(())
    }
}
