//! Visibility by rasterisation: for every sample of every pixel, the nearest triangle.
//!
//! Always holds: positions are snapped to 1/64 pixel and edges are evaluated in integers with a top-left rule, so
//! triangles that share an edge neither overlap nor leave a gap, and the result does not depend on any float rounding.
//! Both faces of a triangle are drawn. *Nearness* is any quantity that is linear on the screen and grows toward the
//! viewer: 1/z in a perspective view, the height toward the viewer in a parallel one.

use glam::Vec2;

/// Fixed-point units in a pixel.
const SUBPIXEL: f32 = 64.0;
/// Vertices further out than this many pixels are beyond the fixed-point range; their triangles are not drawn.
const FARTHEST_PX: f32 = 1.0e6;
/// The mark of a sample that no triangle covers.
const NOTHING: u32 = u32::MAX;

/// Sample positions about the pixel's centre, in 1/64 pixel: the standard 8-sample pattern of Direct3D 11.
pub const EIGHT_SAMPLES: [[i64; 2]; 8] =
    [[4, -12], [-4, 12], [20, 4], [-12, -20], [-20, 20], [-28, -4], [12, 28], [28, -28]];
/// The pixel's centre alone.
pub const ONE_SAMPLE: [[i64; 2]; 1] = [[0, 0]];

/// A vertex on the screen.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ScreenVertex {
    /// Column and row, pixels.
    pub position_px: Vec2,
    /// Linear on the screen, larger is nearer; NaN marks a vertex that cannot be drawn (behind the camera).
    pub nearness: f32,
}

/// What is seen of one triangle in one pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fragment {
    /// Triangle number.
    pub triangle: u32,
    /// Fraction of the pixel in which this triangle is the nearest, in (0, 1].
    pub coverage: f32,
    /// Mean position of those samples, pixels.
    pub position_px: Vec2,
}

/// The nearest triangle at each of `S` samples of each pixel.
pub struct VisibilityBuffer<const S: usize> {
    width: usize,
    height: usize,
    offsets: [[i64; 2]; S],
    nearness: Vec<[f32; S]>,
    triangles: Vec<[u32; S]>,
}

impl<const S: usize> VisibilityBuffer<S> {
    /// An empty buffer of `width × height` pixels with the given sample pattern ([`EIGHT_SAMPLES`], [`ONE_SAMPLE`]).
    pub fn new(width: usize, height: usize, offsets: [[i64; 2]; S]) -> Self {
        let pixels = width * height;
        Self { width, height, offsets, nearness: vec![[f32::MIN; S]; pixels], triangles: vec![[NOTHING; S]; pixels] }
    }

    /// Forgets what was drawn.
    pub fn clear(&mut self) {
        self.nearness.fill([f32::MIN; S]);
        self.triangles.fill([NOTHING; S]);
    }

    /// Draws all triangles. Those with a vertex that is not finite, out of range or unknown are left out.
    pub fn draw(&mut self, vertices: &[ScreenVertex], triangles: &[[u32; 3]]) {
        for (number, corners) in triangles.iter().enumerate() {
            let corners = corners.map(|vertex| vertices.get(vertex as usize).copied().unwrap_or(UNDRAWABLE));
            if let Some(setup) = Setup::new(corners, &self.offsets) {
                self.draw_one(&setup, number as u32);
            }
        }
    }

    fn draw_one(&mut self, setup: &Setup<S>, number: u32) {
        let [x_range, y_range] = setup.pixel_bounds(self.width, self.height);
        for y in y_range {
            for x in x_range.clone() {
                let centre = [x as i64 * 64 + 32, y as i64 * 64 + 32];
                let edges = setup.edges.each_ref().map(|edge| edge.at(centre));
                if (0..3).any(|e| edges[e] + setup.edges[e].reach < 0) {
                    continue;
                }
                let nearness_at_centre = setup.nearness_at(x, y);
                let pixel = y * self.width + x;
                let (nearest, owner) = (&mut self.nearness[pixel], &mut self.triangles[pixel]);
                for s in 0..S {
                    let outside = (edges[0] + setup.edges[0].at_sample[s])
                        | (edges[1] + setup.edges[1].at_sample[s])
                        | (edges[2] + setup.edges[2].at_sample[s]);
                    let nearness =
                        (nearness_at_centre + setup.nearness_at_sample[s]).clamp(setup.range[0], setup.range[1]);
                    if outside >= 0 && nearness > nearest[s] {
                        nearest[s] = nearness;
                        owner[s] = number;
                    }
                }
            }
        }
    }

    /// Nearness at a pixel's first sample; `f32::MIN` where nothing is drawn.
    pub fn nearness(&self, x: usize, y: usize) -> f32 {
        self.nearness[y * self.width + x][0]
    }

    /// What is seen in a pixel, one fragment a triangle in the order of its first sample; at most `S`.
    pub fn fragments(&self, x: usize, y: usize) -> impl Iterator<Item = Fragment> + '_ {
        let owners = self.triangles[y * self.width + x];
        let mut pending: [bool; S] = std::array::from_fn(|s| owners[s] != NOTHING);
        std::iter::from_fn(move || {
            let first = pending.iter().position(|pending| *pending)?;
            let (mut count, mut sum) = (0i64, [0i64; 2]);
            for s in first..S {
                if pending[s] && owners[s] == owners[first] {
                    pending[s] = false;
                    count += 1;
                    sum = [sum[0] + self.offsets[s][0], sum[1] + self.offsets[s][1]];
                }
            }
            let mean = Vec2::new(sum[0] as f32, sum[1] as f32) / (count as f32 * SUBPIXEL);
            Some(Fragment {
                triangle: owners[first],
                coverage: count as f32 / S as f32,
                position_px: Vec2::new(x as f32 + 0.5, y as f32 + 0.5) + mean,
            })
        })
    }
}

const UNDRAWABLE: ScreenVertex = ScreenVertex { position_px: Vec2::ZERO, nearness: f32::NAN };

/// One edge function, positive inside, shifted by one unit where the top-left rule excludes the edge itself.
struct Edge<const S: usize> {
    origin: [i64; 2],
    delta: [i64; 2],
    bias: i64,
    at_sample: [i64; S],
    reach: i64,
}

impl<const S: usize> Edge<S> {
    fn new(from: [i64; 2], to: [i64; 2], offsets: &[[i64; 2]; S]) -> Self {
        let delta = [to[0] - from[0], to[1] - from[1]];
        let is_top_left = delta[1] < 0 || (delta[1] == 0 && delta[0] > 0);
        let at_sample = offsets.map(|[x, y]| delta[0] * y - delta[1] * x);
        let reach = at_sample.iter().copied().max().unwrap_or(0);
        Self { origin: from, delta, bias: if is_top_left { 0 } else { -1 }, at_sample, reach }
    }

    fn at(&self, point: [i64; 2]) -> i64 {
        self.delta[0] * (point[1] - self.origin[1]) - self.delta[1] * (point[0] - self.origin[0]) + self.bias
    }
}

/// A triangle made ready: its edges, its bounds and its plane of nearness.
struct Setup<const S: usize> {
    edges: [Edge<S>; 3],
    low: [i64; 2],
    high: [i64; 2],
    anchor_px: Vec2,
    nearness: f32,
    gradient: Vec2,
    nearness_at_sample: [f32; S],
    range: [f32; 2],
}

impl<const S: usize> Setup<S> {
    fn new(corners: [ScreenVertex; 3], offsets: &[[i64; 2]; S]) -> Option<Self> {
        let drawable = |v: &ScreenVertex| {
            v.nearness.is_finite() && v.position_px.is_finite() && v.position_px.abs().max_element() < FARTHEST_PX
        };
        if !corners.iter().all(drawable) {
            return None;
        }
        let [a, mut b, mut c] = corners;
        let (p0, mut p1, mut p2) = (snap(a), snap(b), snap(c));
        let twice_area = (p1[0] - p0[0]) * (p2[1] - p0[1]) - (p1[1] - p0[1]) * (p2[0] - p0[0]);
        if twice_area == 0 {
            return None;
        }
        if twice_area < 0 {
            (b, c) = (c, b);
            (p1, p2) = (p2, p1);
        }
        let area = twice_area.abs() as f32;
        let (d1, d2) = (b.nearness - a.nearness, c.nearness - a.nearness);
        let (u, v) =
            ([p1[0] - p0[0], p1[1] - p0[1]].map(|d| d as f32), [p2[0] - p0[0], p2[1] - p0[1]].map(|d| d as f32));
        let gradient = Vec2::new(d1 * v[1] - d2 * u[1], d2 * u[0] - d1 * v[0]) * (SUBPIXEL / area);
        let [low, high] =
            [i64::min, i64::max].map(|pick| std::array::from_fn(|axis| pick(p0[axis], pick(p1[axis], p2[axis]))));
        Some(Self {
            edges: [Edge::new(p0, p1, offsets), Edge::new(p1, p2, offsets), Edge::new(p2, p0, offsets)],
            low,
            high,
            anchor_px: Vec2::new(p0[0] as f32, p0[1] as f32) / SUBPIXEL,
            nearness: a.nearness,
            gradient,
            nearness_at_sample: offsets.map(|[x, y]| gradient.dot(Vec2::new(x as f32, y as f32)) / SUBPIXEL),
            range: [a.nearness.min(b.nearness).min(c.nearness), a.nearness.max(b.nearness).max(c.nearness)],
        })
    }

    /// Columns and rows whose samples can lie inside.
    fn pixel_bounds(&self, width: usize, height: usize) -> [std::ops::Range<usize>; 2] {
        let along = |axis: usize, size: usize| {
            let first = (self.low[axis] >> 6).clamp(0, size as i64) as usize;
            let end = ((self.high[axis] >> 6) + 1).clamp(0, size as i64) as usize;
            first..end.max(first)
        };
        [along(0, width), along(1, height)]
    }

    fn nearness_at(&self, x: usize, y: usize) -> f32 {
        let centre = Vec2::new(x as f32 + 0.5, y as f32 + 0.5);
        self.nearness + self.gradient.dot(centre - self.anchor_px)
    }
}

fn snap(vertex: ScreenVertex) -> [i64; 2] {
    (vertex.position_px * SUBPIXEL).round().to_array().map(|value| value as i64)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn vertex(x: f32, y: f32, nearness: f32) -> ScreenVertex {
        ScreenVertex { position_px: Vec2::new(x, y), nearness }
    }

    #[test]
    fn triangles_that_share_edges_cover_each_sample_once() {
        let corners: Vec<_> =
            [(3.0, 2.5), (17.3, 1.1), (19.9, 18.2), (1.7, 15.0), (9.13, 8.71)].map(|(x, y)| vertex(x, y, 1.0)).into();
        let fan = [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]];
        let coverage_of = |triangles: &[[u32; 3]]| {
            let mut buffer = VisibilityBuffer::new(22, 20, EIGHT_SAMPLES);
            buffer.draw(&corners, triangles);
            let pixels = (0..20).flat_map(|y| (0..22).map(move |x| (x, y)));
            pixels.map(|(x, y)| buffer.fragments(x, y).map(|f| f64::from(f.coverage)).sum::<f64>()).sum::<f64>()
        };
        let apart: f64 = fan.iter().map(|triangle| coverage_of(&[*triangle])).sum();
        assert_eq!(apart, coverage_of(&fan), "no sample belongs to two neighbours or to none");
        let quad = [[0, 1, 2], [0, 2, 3]];
        assert_eq!(coverage_of(&quad), coverage_of(&fan), "the outline alone decides what is covered");
    }

    #[test]
    fn coverage_approaches_the_area() {
        let mut buffer = VisibilityBuffer::new(64, 64, EIGHT_SAMPLES);
        buffer.draw(&[vertex(3.2, 4.1, 1.0), vertex(60.5, 9.7, 1.0), vertex(22.9, 58.4, 1.0)], &[[0, 2, 1]]);
        let covered: f32 = (0..64 * 64).flat_map(|p| buffer.fragments(p % 64, p / 64)).map(|f| f.coverage).sum();
        let area = 0.5 * ((60.5f32 - 3.2) * (58.4 - 4.1) - (9.7 - 4.1) * (22.9 - 3.2));
        assert!((covered - area).abs() < 0.005 * area, "{covered} of {area}");
    }

    #[test]
    fn the_nearer_triangle_wins_wherever_it_is_nearer() {
        let vertices = [
            vertex(0.0, 0.0, 2.0),
            vertex(32.0, 0.0, 0.0),
            vertex(0.0, 32.0, 2.0),
            vertex(32.0, 32.0, 0.0),
            vertex(0.0, 0.0, 1.0),
            vertex(32.0, 0.0, 1.0),
            vertex(0.0, 32.0, 1.0),
            vertex(32.0, 32.0, 1.0),
        ];
        let mut buffer = VisibilityBuffer::new(32, 32, ONE_SAMPLE);
        buffer.draw(&vertices, &[[0, 1, 2], [1, 3, 2], [4, 5, 6], [5, 7, 6]]);
        for (x, y) in (0..32 * 32).map(|p| (p % 32, p / 32)) {
            let owner = buffer.fragments(x, y).next().map(|f| f.triangle / 2);
            assert_eq!(owner, Some(u32::from(x >= 16)), "pixel ({x}, {y})");
        }
    }

    #[test]
    fn what_cannot_be_drawn_is_left_out() {
        let vertices = [
            vertex(1.0, 1.0, 1.0),
            vertex(9.0, 1.0, f32::NAN),
            vertex(1.0, 9.0, 1.0),
            vertex(f32::INFINITY, 0.0, 1.0),
            vertex(1.0e9, 0.0, 1.0),
        ];
        let mut buffer = VisibilityBuffer::new(10, 10, ONE_SAMPLE);
        buffer.draw(&vertices, &[[0, 1, 2], [0, 3, 2], [0, 4, 2], [0, 2, 99], [0, 0, 2]]);
        assert_eq!((0..100).flat_map(|p| buffer.fragments(p % 10, p / 10)).count(), 0);
    }
}
