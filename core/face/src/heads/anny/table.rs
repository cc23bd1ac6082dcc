//! What we say of the base mesh ourselves: which vertices are kept, what they are part of, and where the landmarks sit.

use crate::model::Region;

const TEXT: &str = include_str!("table.txt");

/// A landmark on three vertices of the base mesh.
pub struct Anchor {
    /// Vertices of the base mesh.
    pub vertices: [u32; 3],
    /// Barycentric coordinates.
    pub barycentric: [f32; 3],
}

/// The landmarks in order of their index, and the kept vertices with their region, increasing.
pub struct Table {
    /// 468 landmarks.
    pub anchors: Vec<Anchor>,
    /// Kept vertices.
    pub regions: Vec<(u32, Region)>,
}

impl Table {
    /// Reads the table; `None` if it were damaged, which a test rules out.
    pub fn read() -> Option<Self> {
        let mut lines = TEXT.lines().filter(|line| !line.starts_with('#'));
        let mut anchors = Vec::new();
        for line in lines.by_ref().take_while(|line| *line != "regions") {
            let mut words = line.split(' ');
            let mut vertex = || words.next()?.parse::<u32>().ok();
            let vertices = [vertex()?, vertex()?, vertex()?];
            let [a, b] = [vertex()? as f32 / 1000.0, vertex()? as f32 / 1000.0];
            anchors.push(Anchor { vertices, barycentric: [a, b, 1.0 - a - b] });
        }
        let mut regions = Vec::new();
        for run in lines.flat_map(|line| line.split(' ')) {
            let (vertices, code) = run.split_once(':')?;
            let (first, count) = vertices.split_once('+').unwrap_or((vertices, "1"));
            let (first, count): (u32, u32) = (first.parse().ok()?, count.parse().ok()?);
            let region = Region::from_code(code.parse().ok()?)?;
            regions.extend((first..first + count).map(|vertex| (vertex, region)));
        }
        Some(Self { anchors, regions })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_is_whole() {
        let table = Table::read();
        let table = table.as_ref();
        assert_eq!(table.map(|table| table.anchors.len()), Some(468));
        let regions = table.map(|table| table.regions.as_slice()).unwrap_or_default();
        assert!(regions.windows(2).all(|pair| pair[0].0 < pair[1].0));
        assert!(Region::ALL.iter().all(|region| regions.iter().any(|(_, own)| own == region)));
    }
}
