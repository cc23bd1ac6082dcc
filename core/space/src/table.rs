//! A table of results: named columns of text or numbers, one row a case, as it travels between nodes.
//!
//! Always holds: names are unique and not empty, all columns have the same number of rows. A number that could not be
//! measured is NaN.

use heartian_artifact::{Artifact, ArtifactError, ArtifactType, Bundle, BundleReader};

use crate::SpaceError;

/// The cells of a column.
#[derive(Clone, Debug, PartialEq)]
pub enum Cells {
    /// Words.
    Text(Vec<String>),
    /// Figures; the unit is in the column's name.
    Numbers(Vec<f64>),
}

impl Cells {
    /// Number of rows.
    pub fn len(&self) -> usize {
        match self {
            Self::Text(cells) => cells.len(),
            Self::Numbers(cells) => cells.len(),
        }
    }

    /// Whether there is no row.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// One cell.
#[derive(Clone, Debug, PartialEq)]
pub enum Cell {
    /// A word.
    Text(String),
    /// A figure.
    Number(f64),
}

/// Columns in order.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Table {
    columns: Vec<(String, Cells)>,
}

impl Table {
    /// Checks and wraps.
    ///
    /// # Errors
    /// When a name is empty or repeated, or columns have different lengths.
    pub fn new(columns: Vec<(String, Cells)>) -> Result<Self, SpaceError> {
        for (index, (name, cells)) in columns.iter().enumerate() {
            let expected = columns[0].1.len();
            if cells.len() != expected {
                return Err(SpaceError::Length { what: "a table's column", expected, found: cells.len() });
            }
            if name.is_empty() || columns[..index].iter().any(|(other, _)| other == name) {
                return Err(SpaceError::Column { name: name.clone(), index });
            }
        }
        Ok(Self { columns })
    }

    /// A table from rows that hold one cell a column, each column of one kind.
    ///
    /// # Errors
    /// When a row has another number of cells, a column mixes words and figures, or names repeat.
    pub fn from_rows(names: &[&str], rows: Vec<Vec<Cell>>) -> Result<Self, SpaceError> {
        let mut columns: Vec<(String, Option<Cells>)> = names.iter().map(|name| ((*name).to_owned(), None)).collect();
        for row in rows {
            if row.len() != names.len() {
                let (expected, found) = (names.len(), row.len());
                return Err(SpaceError::Length { what: "a table's row", expected, found });
            }
            for (index, (cell, (name, cells))) in row.into_iter().zip(&mut columns).enumerate() {
                match (cells, cell) {
                    (Some(Cells::Text(cells)), Cell::Text(cell)) => cells.push(cell),
                    (Some(Cells::Numbers(cells)), Cell::Number(cell)) => cells.push(cell),
                    (cells @ None, Cell::Text(cell)) => *cells = Some(Cells::Text(vec![cell])),
                    (cells @ None, Cell::Number(cell)) => *cells = Some(Cells::Numbers(vec![cell])),
                    _ => return Err(SpaceError::Column { name: name.clone(), index }),
                }
            }
        }
        let filled = |(name, cells): (String, Option<Cells>)| (name, cells.unwrap_or(Cells::Numbers(Vec::new())));
        Self::new(columns.into_iter().map(filled).collect())
    }

    /// Columns in order, by name.
    pub fn columns(&self) -> &[(String, Cells)] {
        &self.columns
    }

    /// The column of that name.
    pub fn column(&self, name: &str) -> Option<&Cells> {
        self.columns.iter().find(|(other, _)| other == name).map(|(_, cells)| cells)
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.columns.first().map_or(0, |(_, cells)| cells.len())
    }
}

/// JSON has no NaN: figures travel as tensors, words in the metadata, both by the column's number.
impl Artifact for Table {
    const TYPE: ArtifactType = ArtifactType { name: "table", version: 1 };

    fn to_bundle(&self) -> Result<Bundle<'_>, ArtifactError> {
        let names: Vec<&str> = self.columns.iter().map(|(name, _)| name.as_str()).collect();
        let mut bundle = Bundle::new().meta("columns", &names)?;
        for (index, (_, cells)) in self.columns.iter().enumerate() {
            bundle = match cells {
                Cells::Text(cells) => bundle.meta(&format!("column{index}"), cells)?,
                Cells::Numbers(cells) => bundle.tensor(&format!("column{index}"), &[cells.len()], cells)?,
            };
        }
        Ok(bundle)
    }

    fn from_bundle(reader: BundleReader<'_>) -> Result<Self, ArtifactError> {
        let names: Vec<String> = reader.meta("columns")?;
        let read = |(index, name): (usize, String)| {
            let column = format!("column{index}");
            let cells = match reader.meta::<Vec<String>>(&column) {
                Ok(words) => Cells::Text(words),
                Err(_) => Cells::Numbers(reader.shaped(&column, &[None])?),
            };
            Ok((name, cells))
        };
        let columns = names.into_iter().enumerate().map(read).collect::<Result<_, ArtifactError>>()?;
        Self::new(columns).map_err(|error| ArtifactError::Invalid(error.to_string()))
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]
    use super::*;

    #[test]
    fn a_table_survives_its_travels_nan_and_all() {
        let rows = vec![
            vec![Cell::Text("input".into()), Cell::Number(72.0)],
            vec![Cell::Text("a,\"b\"".into()), Cell::Number(f64::INFINITY)],
        ];
        let table = Table::from_rows(&["clip", "hr_bpm"], rows).unwrap();
        let bytes = table.to_bundle().unwrap().to_bytes().unwrap();
        assert_eq!(Table::from_bundle(BundleReader::new(&bytes).unwrap()).unwrap(), table);
        assert_eq!((table.rows(), Table::default().rows()), (2, 0));
        let bytes = Table::default().to_bundle().unwrap().to_bytes().unwrap();
        assert_eq!(Table::from_bundle(BundleReader::new(&bytes).unwrap()).unwrap(), Table::default());
    }

    #[test]
    fn tables_that_contradict_themselves_are_refused() {
        let numbers = |n: usize| Cells::Numbers(vec![0.0; n]);
        assert!(Table::new(vec![("a".into(), numbers(1)), ("b".into(), numbers(2))]).is_err());
        assert!(Table::new(vec![("a".into(), numbers(1)), ("a".into(), numbers(1))]).is_err());
        assert!(Table::new(vec![(String::new(), numbers(1))]).is_err());
        assert!(Table::from_rows(&["a"], vec![vec![Cell::Number(1.0)], vec![Cell::Text("x".into())]]).is_err());
        assert!(Table::from_rows(&["a"], vec![vec![]]).is_err());
    }
}
