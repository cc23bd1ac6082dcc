//! The picture as SVG: plain shapes and text, no style sheet, no script, no font of its own.

use std::fmt::Write;

use super::layout::{Layout, Measures, lay_out};
use super::{Picture, Tint};

/// Height of a box, px.
const BOX: f64 = 44.0;
/// Width of an average character of 14 px text, generously, px.
const CHARACTER: f64 = 8.2;
/// Room of an arriving wire's label, px.
const ARRIVAL: f64 = 44.0;
const MEASURES: Measures = Measures { gap: 26.0, layer: 108.0, margin: 24.0 };

pub(super) fn draw(picture: &Picture) -> String {
    let mut wires = vec![0usize; picture.nodes.len()];
    picture.edges.iter().for_each(|edge| wires[edge.to] += 1);
    let width = |((id, kind, _), wires): (&(String, &str, Tint), &usize)| {
        let characters = id.chars().count().max(kind.chars().count());
        (characters as f64 * CHARACTER + 24.0).max(84.0).max(*wires as f64 * ARRIVAL)
    };
    let widths: Vec<f64> = picture.nodes.iter().zip(&wires).map(width).collect();
    let layout = lay_out(&widths, &picture.edges, &MEASURES);
    let (leaves, arrives) = (spread(picture, &layout, &widths, false), spread(picture, &layout, &widths, true));
    let legend = legend(picture);
    let (all_width, height) = (layout.width.max(legend.1 + 48.0), layout.height + 28.0);
    let mut text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{all_width:.0}\" height=\"{height:.0}\" \
         viewBox=\"0 0 {all_width:.0} {height:.0}\" font-family=\"sans-serif\">\n<title>{}</title>\n\
         <rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>\n",
        escape(&picture.name)
    );
    let mut labels = String::new();
    for (at, (edge, bends)) in picture.edges.iter().zip(&layout.bends).enumerate() {
        let color = picture.wire_color(edge);
        let ((fx, _), (tx, rank)) = (leaves[at], arrives[at]);
        let (fy, ty) = (layout.centers[edge.from].1 + BOX / 2.0, layout.centers[edge.to].1 - BOX / 2.0);
        let mut path: Vec<(f64, f64)> = vec![(fx, fy)];
        path.extend(bends);
        path.push((tx, ty - 5.0));
        let _ = writeln!(text, "<path d=\"{}\" fill=\"none\" stroke=\"{color}\" stroke-width=\"1.4\"/>", curve(&path));
        let _ = writeln!(text, "<path d=\"M{tx:.1} {ty:.1}l-4 -7h8z\" fill=\"{color}\"/>");
        // Just above the arrow, neighbours at different heights.
        let _ = writeln!(
            labels,
            "<text x=\"{tx:.1}\" y=\"{:.1}\" font-size=\"10.5\" text-anchor=\"middle\" fill=\"{color}\" \
             stroke=\"#ffffff\" stroke-width=\"3\" paint-order=\"stroke\">{}</text>",
            ty - 11.0 - 12.0 * (rank % 2) as f64,
            escape(&edge.types.join(", "))
        );
    }
    for (((id, kind, tint), (x, y)), width) in picture.nodes.iter().zip(&layout.centers).zip(&widths) {
        let (fill, border) = tint.colors();
        let _ = writeln!(
            text,
            "<rect x=\"{:.1}\" y=\"{:.1}\" width=\"{width:.1}\" height=\"{BOX}\" rx=\"7\" fill=\"{fill}\" \
             stroke=\"{border}\" stroke-width=\"1.5\"/>\n<text x=\"{x:.1}\" y=\"{:.1}\" font-size=\"14\" \
             font-weight=\"600\" text-anchor=\"middle\" fill=\"#1a1a1a\">{}</text>\n<text x=\"{x:.1}\" y=\"{:.1}\" \
             font-size=\"11\" text-anchor=\"middle\" fill=\"#555555\">{}</text>",
            x - width / 2.0,
            y - BOX / 2.0,
            y - 3.0,
            escape(id),
            y + 14.0,
            escape(kind)
        );
    }
    let _ = writeln!(text, "{labels}<g transform=\"translate(24 {:.0})\">\n{}</g>\n</svg>", height - 30.0, legend.0);
    text
}

/// Where each wire leaves or arrives at its box, and which it is there from the left: side by side, in the order of
/// where they come from.
fn spread(picture: &Picture, layout: &Layout, widths: &[f64], arriving: bool) -> Vec<(f64, usize)> {
    let mut at_box: Vec<Vec<(f64, usize)>> = vec![Vec::new(); picture.nodes.len()];
    for (index, (edge, bends)) in picture.edges.iter().zip(&layout.bends).enumerate() {
        let (own, other, next) =
            if arriving { (edge.to, edge.from, bends.last()) } else { (edge.from, edge.to, bends.first()) };
        at_box[own].push((next.map_or(layout.centers[other].0, |point| point.0), index));
    }
    let mut found = vec![(0.0, 0); picture.edges.len()];
    for (node, wires) in at_box.iter_mut().enumerate() {
        wires.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let step = (widths[node] - 16.0) / wires.len() as f64;
        for (rank, (_, index)) in wires.iter().enumerate() {
            let offset = (rank as f64 + 0.5) * step - (widths[node] - 16.0) / 2.0;
            found[*index] = (layout.centers[node].0 + offset, rank);
        }
    }
    found
}

/// A smooth line through points, leaving and arriving vertically.
fn curve(points: &[(f64, f64)]) -> String {
    let mut text = points.first().map_or(String::new(), |(x, y)| format!("M{x:.1} {y:.1}"));
    for pair in points.windows(2) {
        let ((ax, ay), (bx, by)) = (pair[0], pair[1]);
        let middle = (ay + by) / 2.0;
        let _ = write!(text, "C{ax:.1} {middle:.1} {bx:.1} {middle:.1} {bx:.1} {by:.1}");
    }
    text
}

/// What the colours of the boxes mean, and how wide that is.
fn legend(picture: &Picture) -> (String, f64) {
    let (mut text, mut x) = (String::new(), 0.0);
    for tint in [Tint::Hit, Tint::Ran, Tint::Waits, Tint::Failed, Tint::Skipped] {
        if picture.nodes.iter().any(|(_, _, found)| *found == tint) {
            let (fill, border) = tint.colors();
            let _ = writeln!(
                text,
                "<rect x=\"{x:.0}\" y=\"0\" width=\"14\" height=\"14\" rx=\"3\" fill=\"{fill}\" stroke=\"{border}\"/>\n\
                 <text x=\"{:.0}\" y=\"11\" font-size=\"11\" fill=\"#333333\">{}</text>",
                x + 20.0,
                tint.word()
            );
            x += 20.0 + tint.word().len() as f64 * 6.4 + 22.0;
        }
    }
    (text, x)
}

fn escape(text: &str) -> String {
    let plain = |c: char| match c {
        '&' => "&amp;".to_owned(),
        '<' => "&lt;".to_owned(),
        '>' => "&gt;".to_owned(),
        '"' => "&quot;".to_owned(),
        c if c.is_control() => " ".to_owned(),
        c => c.to_string(),
    };
    text.chars().map(plain).collect()
}
