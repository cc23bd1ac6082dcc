//! The picture as SVG: plain shapes and text, no style sheet, no script, no font of its own.

use std::fmt::Write;

use super::layout::{Measures, lay_out};
use super::{Picture, Tint};

/// Height of a box, px.
const BOX: f64 = 44.0;
/// Width of an average character of 14 px text, generously, px.
const CHARACTER: f64 = 8.2;
const MEASURES: Measures = Measures { gap: 26.0, layer: 108.0, margin: 24.0 };

pub(super) fn draw(picture: &Picture) -> String {
    let width = |(id, kind, _): &(String, &str, Tint)| {
        let characters = id.chars().count().max(kind.chars().count());
        (characters as f64 * CHARACTER + 24.0).max(84.0)
    };
    let widths: Vec<f64> = picture.nodes.iter().map(width).collect();
    let layout = lay_out(&widths, &picture.edges, &MEASURES);
    let legend = legend(picture);
    let (all_width, height) = (layout.width.max(legend.1 + 48.0), layout.height + 28.0);
    let mut text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{all_width:.0}\" height=\"{height:.0}\" \
         viewBox=\"0 0 {all_width:.0} {height:.0}\" font-family=\"sans-serif\">\n<title>{}</title>\n\
         <rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>\n",
        escape(&picture.name)
    );
    let mut labels = String::new();
    for (edge, bends) in picture.edges.iter().zip(&layout.bends) {
        let color = picture.wire_color(edge);
        let (fx, fy) = layout.centers[edge.from];
        let (tx, ty) = layout.centers[edge.to];
        let mut path: Vec<(f64, f64)> = vec![(fx, fy + BOX / 2.0)];
        path.extend(bends);
        path.push((tx, ty - BOX / 2.0 - 5.0));
        let _ = writeln!(text, "<path d=\"{}\" fill=\"none\" stroke=\"{color}\" stroke-width=\"1.4\"/>", curve(&path));
        let (x, y) = (tx, ty - BOX / 2.0);
        let _ = writeln!(text, "<path d=\"M{:.1} {:.1}l-4 -7h8z\" fill=\"{color}\"/>", x, y);
        // Near the consumer, where wires from one producer have parted.
        let (from, to) = (path[path.len() - 2], path[path.len() - 1]);
        let at = |a: f64, b: f64| a + (b - a) * 0.62;
        let _ = writeln!(
            labels,
            "<text x=\"{:.1}\" y=\"{:.1}\" font-size=\"10.5\" text-anchor=\"middle\" fill=\"{color}\" stroke=\"#ffffff\" \
             stroke-width=\"3\" paint-order=\"stroke\">{}</text>",
            at(from.0, to.0),
            at(from.1, to.1) + 3.0,
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
