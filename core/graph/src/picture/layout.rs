//! Layers from producers to consumers, few crossings, boxes as near as they can be to what they are wired to.
//!
//! The steps are those of layered drawing in general: longest-path layers, bends where a wire passes a layer, order by
//! barycentres, then for each layer the positions nearest to the wished ones that keep their distance (isotonic
//! regression, exact in linear time).

use super::Edge;

/// Sweeps over the layers that improve order and positions.
const SWEEPS: usize = 12;
/// With more points than this, wires that pass several layers are drawn straight.
const BENDS_LIMIT: usize = 200_000;

/// Where everything is; lengths in pixels.
pub struct Layout {
    /// Centre of each node's box.
    pub centers: Vec<(f64, f64)>,
    /// The points of each edge between its boxes.
    pub bends: Vec<Vec<(f64, f64)>>,
    pub width: f64,
    pub height: f64,
}

/// A box, or the place where a wire passes a layer.
struct Point {
    layer: usize,
    width: f64,
    x: f64,
    above: Vec<usize>,
    below: Vec<usize>,
}

/// Distances of the layout.
pub struct Measures {
    pub gap: f64,
    pub layer: f64,
    pub margin: f64,
}

/// Lays out boxes of these widths; edges go from lower to higher indices.
pub fn lay_out(widths: &[f64], edges: &[Edge], measures: &Measures) -> Layout {
    let mut layer = vec![0usize; widths.len()];
    for edge in edges {
        // Edges are sorted by consumer, and producers come first, so one pass finds the longest paths.
        layer[edge.to] = layer[edge.to].max(layer[edge.from] + 1);
    }
    let mut points: Vec<Point> = (0..widths.len())
        .map(|at| Point { layer: layer[at], width: widths[at], x: 0.0, above: Vec::new(), below: Vec::new() })
        .collect();
    let passed: usize = edges.iter().map(|edge| layer[edge.to] - layer[edge.from] - 1).sum();
    let bend = passed + points.len() <= BENDS_LIMIT;
    let mut chains: Vec<Vec<usize>> = Vec::with_capacity(edges.len());
    for edge in edges {
        let mut chain = vec![edge.from];
        for between in (layer[edge.from] + 1)..(if bend { layer[edge.to] } else { 0 }) {
            chain.push(points.len());
            points.push(Point { layer: between, width: 12.0, x: 0.0, above: Vec::new(), below: Vec::new() });
        }
        chain.push(edge.to);
        for pair in chain.windows(2) {
            points[pair[0]].below.push(pair[1]);
            points[pair[1]].above.push(pair[0]);
        }
        chains.push(chain);
    }
    let depth = points.iter().map(|point| point.layer + 1).max().unwrap_or(0);
    let mut layers: Vec<Vec<usize>> = vec![Vec::new(); depth];
    points.iter().enumerate().for_each(|(at, point)| layers[point.layer].push(at));
    arrange(&mut points, &mut layers, measures.gap);
    let left = points.iter().map(|point| point.x - point.width / 2.0).fold(f64::INFINITY, f64::min);
    let left = if left.is_finite() { left } else { 0.0 };
    let right = points.iter().map(|point| point.x + point.width / 2.0).fold(left, f64::max);
    let at = |point: &Point| {
        (point.x - left + measures.margin, measures.margin + measures.layer * (point.layer as f64 + 0.5))
    };
    Layout {
        centers: points[..widths.len()].iter().map(at).collect(),
        bends: chains
            .iter()
            .map(|chain| chain[1..chain.len() - 1].iter().map(|point| at(&points[*point])).collect())
            .collect(),
        width: right - left + 2.0 * measures.margin,
        height: measures.layer * depth as f64 + 2.0 * measures.margin,
    }
}

/// Orders each layer and places its points, sweeping down and up.
fn arrange(points: &mut [Point], layers: &mut [Vec<usize>], gap: f64) {
    for layer in layers.iter() {
        let mut x = 0.0;
        for at in layer {
            points[*at].x = x + points[*at].width / 2.0;
            x += points[*at].width + gap;
        }
    }
    for sweep in 0..SWEEPS {
        let downwards = sweep % 2 == 0;
        let count = layers.len();
        for step in 0..count {
            let layer = &mut layers[if downwards { step } else { count - 1 - step }];
            let wished = |at: usize| {
                let point = &points[at];
                // In the last sweeps both sides count, so that a box comes to stand between what it joins.
                let both = sweep + 4 >= SWEEPS;
                let sides = [(&point.above, downwards || both), (&point.below, !downwards || both)];
                let joined = sides.iter().filter(|(_, counts)| *counts).flat_map(|(side, _)| side.iter());
                let (sum, count) = joined.fold((0.0, 0.0), |(sum, count), other| (sum + points[*other].x, count + 1.0));
                if count > 0.0 { sum / count } else { point.x }
            };
            let mut placed: Vec<(usize, f64)> = layer.iter().map(|at| (*at, wished(*at))).collect();
            if sweep + 4 < SWEEPS {
                placed.sort_by(|a, b| a.1.total_cmp(&b.1));
                *layer = placed.iter().map(|(at, _)| *at).collect();
            }
            let widths: Vec<f64> = placed.iter().map(|(at, _)| points[*at].width).collect();
            let wishes: Vec<f64> = placed.iter().map(|(_, wish)| *wish).collect();
            let found = nearest(&wishes, &widths, gap);
            placed.iter().zip(found).for_each(|((at, _), x)| points[*at].x = x);
        }
    }
}

/// Positions in this order, a gap apart, with the least squared distance to the wished ones.
fn nearest(wishes: &[f64], widths: &[f64], gap: f64) -> Vec<f64> {
    let mut offsets = vec![0.0; wishes.len()];
    for at in 1..wishes.len() {
        offsets[at] = offsets[at - 1] + (widths[at - 1] + widths[at]) / 2.0 + gap;
    }
    // Pools of neighbours that share one position, less their offsets: mean and count.
    let mut pools: Vec<(f64, f64)> = Vec::new();
    for (wish, offset) in wishes.iter().zip(&offsets) {
        let mut pool = (wish - offset, 1.0);
        while let Some((mean, count)) = pools.pop_if(|(mean, _)| *mean > pool.0) {
            pool = ((mean * count + pool.0 * pool.1) / (count + pool.1), count + pool.1);
        }
        pools.push(pool);
    }
    let shared = pools.iter().flat_map(|(mean, count)| std::iter::repeat_n(*mean, *count as usize));
    shared.zip(&offsets).map(|(base, offset)| base + offset).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boxes_never_overlap_and_wires_go_down() {
        let edge = |from, to| Edge { from, to, types: vec!["x"] };
        let edges = [edge(0, 2), edge(1, 2), edge(0, 3), edge(1, 3), edge(2, 4), edge(0, 5), edge(3, 5), edge(4, 5)];
        let widths = [80.0, 120.0, 60.0, 200.0, 90.0, 70.0];
        let measures = Measures { gap: 20.0, layer: 100.0, margin: 10.0 };
        let layout = lay_out(&widths, &edges, &measures);
        for a in 0..6 {
            for b in 0..a {
                let ((ax, ay), (bx, by)) = (layout.centers[a], layout.centers[b]);
                assert!(ay != by || (ax - bx).abs() >= (widths[a] + widths[b]) / 2.0 + 20.0 - 1e-6, "{a} {b}");
            }
            let (x, y) = layout.centers[a];
            assert!(x - widths[a] / 2.0 >= 10.0 - 1e-6 && x + widths[a] / 2.0 <= layout.width - 10.0 + 1e-6);
            assert!(y > 0.0 && y < layout.height);
        }
        for (edge, bends) in edges.iter().zip(&layout.bends) {
            assert!(layout.centers[edge.from].1 < layout.centers[edge.to].1);
            let skipped = (layout.centers[edge.to].1 - layout.centers[edge.from].1) / 100.0 - 1.0;
            assert_eq!(bends.len() as f64, skipped.round());
        }
    }

    #[test]
    fn positions_are_the_nearest_that_keep_their_distance() {
        let near = |found: Vec<f64>, wanted: &[f64]| found.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 1e-9);
        assert!(near(nearest(&[0.0, 100.0], &[10.0, 10.0], 5.0), &[0.0, 100.0]));
        assert!(near(nearest(&[50.0, 50.0, 50.0], &[10.0, 10.0, 10.0], 0.0), &[40.0, 50.0, 60.0]));
        assert!(near(nearest(&[100.0, 0.0], &[10.0, 10.0], 0.0), &[45.0, 55.0]));
        assert!(nearest(&[], &[], 1.0).is_empty());
    }
}
