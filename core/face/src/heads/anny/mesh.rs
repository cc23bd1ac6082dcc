//! Readers of the base mesh's text files: Wavefront OBJ (positions, faces, groups) and `.target` displacements.
//!
//! Files come from a pinned package but are treated as strangers': sizes are bounded, numbers finite, indices in range.

use std::collections::BTreeMap;

/// Most vertices and faces read.
const MOST: usize = 1 << 17;

/// A mesh of triangles and quads, in the file's own units and order.
#[derive(Debug, Default)]
pub struct BaseMesh {
    /// Positions.
    pub vertices: Vec<[f64; 3]>,
    /// Faces of three or four vertices, with their group's number in `groups`.
    pub faces: Vec<(usize, Vec<u32>)>,
    /// Names of the groups.
    pub groups: Vec<String>,
}

fn number(word: Option<&str>, line: usize) -> Result<f64, String> {
    let value = word.and_then(|word| word.parse::<f64>().ok()).filter(|value| value.is_finite());
    value.ok_or_else(|| format!("line {line} lacks a number"))
}

impl BaseMesh {
    /// Reads an OBJ file.
    pub fn parse(text: &[u8]) -> Result<Self, String> {
        let text = std::str::from_utf8(text).map_err(|_| "it is no text".to_owned())?;
        let mut mesh = Self::default();
        let mut group = 0;
        for (i, line) in text.lines().enumerate() {
            let mut words = line.split_ascii_whitespace();
            match words.next() {
                Some("v") => {
                    let vertex =
                        [number(words.next(), i + 1)?, number(words.next(), i + 1)?, number(words.next(), i + 1)?];
                    mesh.vertices.push(vertex);
                }
                Some("g") => {
                    let name = words.next().unwrap_or_default();
                    group = mesh.groups.iter().position(|known| known == name).unwrap_or(mesh.groups.len());
                    if group == mesh.groups.len() {
                        mesh.groups.push(name.to_owned());
                    }
                }
                Some("f") => {
                    let corner = |word: &str| word.split('/').next()?.parse::<u32>().ok()?.checked_sub(1);
                    let face: Option<Vec<u32>> = words.map(corner).collect();
                    let face = face.filter(|face| (3..=4).contains(&face.len()));
                    mesh.faces.push((group, face.ok_or_else(|| format!("line {} is no triangle or quad", i + 1))?));
                }
                _ => {}
            }
            if mesh.vertices.len() > MOST || mesh.faces.len() > MOST || mesh.groups.len() > 4096 {
                return Err(format!("it holds more than {MOST} vertices or faces"));
            }
        }
        if mesh.groups.is_empty() {
            mesh.groups.push(String::new());
        }
        let count = mesh.vertices.len();
        match mesh.faces.iter().flat_map(|(_, face)| face).find(|vertex| **vertex as usize >= count) {
            Some(vertex) => Err(format!("a face points at vertex {} of {count}", vertex + 1)),
            None => Ok(mesh),
        }
    }

    /// The vertices of a group, increasing.
    pub fn group(&self, name: &str) -> Vec<u32> {
        let faces = self.faces.iter().filter(|(group, _)| self.groups[*group] == name);
        let mut vertices: Vec<u32> = faces.flat_map(|(_, face)| face.iter().copied()).collect();
        vertices.sort_unstable();
        vertices.dedup();
        vertices
    }
}

/// Displacements by vertex: lines of `index dx dy dz`, floats perhaps without a leading zero, `#` for remarks.
pub fn target(text: &[u8], vertices: usize) -> Result<BTreeMap<u32, [f64; 3]>, String> {
    let text = std::str::from_utf8(text).map_err(|_| "it is no text".to_owned())?;
    let mut shifts = BTreeMap::new();
    for (i, line) in text.lines().enumerate() {
        let mut words = line.split_ascii_whitespace();
        let Some(first) = words.next().filter(|word| !word.starts_with('#')) else { continue };
        let vertex = first.parse::<u32>().ok().filter(|vertex| (*vertex as usize) < vertices);
        let vertex = vertex.ok_or_else(|| format!("line {} names no vertex of the mesh", i + 1))?;
        let shift = [number(words.next(), i + 1)?, number(words.next(), i + 1)?, number(words.next(), i + 1)?];
        shifts.insert(vertex, shift);
    }
    Ok(shifts)
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]
    use proptest::prelude::*;

    use super::*;

    const OBJ: &str = "# x\nv 0 1 -.5\nv 1 0 0\nv 0 0 0\nv 1 1 1e-3\ng a\nf 1/1 2/2 3/3 4/4\ng joint-x\nf 1 2 3\n";
    const TARGET: &str = "# y\n0 .001 -.5 0\n3 1 2 3\n";

    #[test]
    fn meshes_and_targets_are_read_with_shortened_floats() {
        let mesh = BaseMesh::parse(OBJ.as_bytes()).unwrap();
        assert_eq!((mesh.vertices[0], mesh.faces.len(), mesh.group("joint-x")), ([0.0, 1.0, -0.5], 2, vec![0, 1, 2]));
        let shifts = target(TARGET.as_bytes(), 4).unwrap();
        assert_eq!(shifts[&0], [0.001, -0.5, 0.0]);
        assert!(target(b"4 0 0 0", 4).unwrap_err().contains("line 1"));
        assert!(target(b"0 0 nan 0", 4).is_err() && target(b"0 0 0", 4).is_err());
        assert!(BaseMesh::parse(b"v 0 0 0\nf 1 2 3\n").unwrap_err().contains("vertex 2"));
        assert!(BaseMesh::parse(b"v 0 0 0\nf 1 1\n").is_err() && BaseMesh::parse(b"v 0 0 inf\n").is_err());
        assert!(BaseMesh::parse(b"v 0 0 0\nf 0 1 1\n").is_err());
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(500))]
        #[test]
        fn no_damage_brings_the_readers_down(
            damage in proptest::collection::vec((any::<u16>(), any::<u8>()), 0..6),
            noise in proptest::collection::vec(any::<u8>(), 0..80),
        ) {
            for text in [OBJ, TARGET] {
                let mut bytes = text.as_bytes().to_vec();
                damage.iter().for_each(|(at, value)| { let at = usize::from(*at) % bytes.len(); bytes[at] = *value; });
                drop(BaseMesh::parse(&bytes));
                drop(target(&bytes, 4));
            }
            drop(BaseMesh::parse(&noise));
            drop(target(&noise, 4));
        }
    }
}
