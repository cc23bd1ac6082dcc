//! The Bland–Altman plot: the difference of two methods over their mean, with its mean and limits of agreement.

use heartian_space::Rgb8Image;
use plotters::chart::ChartBuilder;
use plotters::prelude::{Circle, Color, IntoFont, PathElement, RGBColor, ShapeStyle};

use crate::ReportError;
use crate::canvas::{FONT, draw_on, drawing};
use crate::figure::PALETTE;

const SIZE_PX: (usize, usize) = (900, 620);

/// What is plotted: one point a window, in groups that share a colour.
#[derive(Clone, Debug, PartialEq)]
pub struct Agreement {
    /// Name and pairs (predicted, reference), bpm, of each group.
    pub groups: Vec<(String, Vec<(f64, f64)>)>,
    /// Mean difference, reference less predicted, bpm.
    pub mean: f64,
    /// Lower and upper limit of agreement, bpm.
    pub limits: (f64, f64),
}

/// Draws the plot; pairs that are not finite are left out.
///
/// # Errors
/// When no pair is left, or the drawing library refuses.
pub fn agreement_figure(agreement: &Agreement) -> Result<Rgb8Image, ReportError> {
    let point = |(predicted, reference): &(f64, f64)| ((predicted + reference) / 2.0, reference - predicted);
    let finite = |(x, y): &(f64, f64)| x.is_finite() && y.is_finite();
    let groups: Vec<(&str, Vec<(f64, f64)>)> = agreement
        .groups
        .iter()
        .map(|(name, pairs)| (name.as_str(), pairs.iter().map(point).filter(finite).collect()))
        .collect();
    let all: Vec<(f64, f64)> = groups.iter().flat_map(|(_, points)| points.iter().copied()).collect();
    if all.is_empty() {
        return Err(ReportError::Nothing("pair of heart rates"));
    }
    let lines = [agreement.mean, agreement.limits.0, agreement.limits.1];
    let x = padded(all.iter().map(|point| point.0));
    let y = padded(all.iter().map(|point| point.1).chain(lines));
    let mut image = Rgb8Image::filled(SIZE_PX.0, SIZE_PX.1, [255; 3]);
    draw_on(&mut image, |area| {
        let mut builder = ChartBuilder::on(area);
        builder.margin(14).x_label_area_size(42).y_label_area_size(62);
        let mut chart = builder.build_cartesian_2d(x.clone(), y).map_err(drawing)?;
        let mut mesh = chart.configure_mesh();
        mesh.x_desc("mean of reference and predicted, bpm").y_desc("reference − predicted, bpm");
        mesh.light_line_style(RGBColor(244, 244, 244)).label_style((FONT, 16).into_font());
        mesh.axis_desc_style((FONT, 17).into_font()).draw().map_err(drawing)?;
        for (line, style) in lines.into_iter().zip([2, 1, 1]) {
            let style = ShapeStyle { color: RGBColor(90, 90, 90).to_rgba(), filled: false, stroke_width: style };
            let ends = vec![(x.start, line), (x.end, line)];
            chart.draw_series(std::iter::once(PathElement::new(ends, style))).map_err(drawing)?;
        }
        for (index, (name, points)) in groups.iter().enumerate() {
            let color = PALETTE[(index + 1) % PALETTE.len()];
            let dots = points.iter().map(|point| Circle::new(*point, 4, color.mix(0.8).filled()));
            let series = chart.draw_series(dots).map_err(drawing)?;
            series.label(*name).legend(move |(x, y)| Circle::new((x + 10, y), 4, color.filled()));
        }
        let mut labels = chart.configure_series_labels();
        labels.background_style(RGBColor(255, 255, 255).mix(0.85)).border_style(RGBColor(200, 200, 200));
        labels.label_font((FONT, 15)).draw().map_err(drawing)
    })?;
    Ok(image)
}

/// The span of values with a tenth to spare at each end, and never empty.
fn padded(values: impl Iterator<Item = f64>) -> std::ops::Range<f64> {
    let finite = values.filter(|value| value.is_finite());
    let (low, high) = finite.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), value| (a.min(value), b.max(value)));
    let pad = (0.1 * (high - low)).max(0.5);
    low - pad..high + pad
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_and_limits_leave_ink_and_nothing_is_refused() -> Result<(), ReportError> {
        let pairs = |off: f64| (0..20).map(|k| (60.0 + f64::from(k) + off, 60.0 + f64::from(k))).collect();
        let groups = vec![("rendered.pos".into(), pairs(0.4)), ("input.pos".into(), pairs(-1.0))];
        let agreement = Agreement { groups, mean: 0.3, limits: (-2.0, 2.5) };
        let image = agreement_figure(&agreement)?;
        let ink = image.data.as_chunks::<3>().0.iter().filter(|p| p[0] > p[1].saturating_add(60)).count();
        assert!(ink > 200, "{ink}");
        if let Some(folder) = std::env::var_os("HEARTIAN_KEEP_PICTURES") {
            let path = std::path::Path::new(&folder).join("agreement.png");
            std::fs::write(path, crate::encode_png(&image)?).expect("writable");
        }
        let nothing = Agreement { groups: vec![("x".into(), vec![(f64::NAN, 60.0)])], ..agreement };
        assert!(matches!(agreement_figure(&nothing), Err(ReportError::Nothing(_))));
        Ok(())
    }
}
