//! Cost against work on linear axes, one colour a group, each with the straight line that fits it best.

use heartian_space::Rgb8Image;
use plotters::chart::{ChartBuilder, SeriesLabelPosition};
use plotters::prelude::{Circle, Color, IntoFont, LineSeries, PathElement, RGBColor, ShapeStyle};

use crate::ReportError;
use crate::canvas::{FONT, draw_on, drawing};
use crate::figure::PALETTE;

const SIZE_PX: (usize, usize) = (1000, 700);

/// One measurement.
#[derive(Clone, Debug, PartialEq)]
pub struct CostPoint {
    /// Points of one group share a colour and a line.
    pub group: String,
    /// How much was done, ≥ 0.
    pub work: f64,
    /// What it took, ≥ 0.
    pub cost: f64,
}

/// The line of least squares through a group.
#[derive(Clone, Debug, PartialEq)]
pub struct CostLine {
    /// The group.
    pub group: String,
    /// Cost of no work.
    pub fixed: f64,
    /// Cost of one unit of work.
    pub slope: f64,
    /// Share of the cost's variance that the line explains, at most 1.
    pub explained: f64,
}

/// Draws points and lines, and gives the lines; `axes` say what work and cost are.
///
/// # Errors
/// When there is no finite point, or the drawing library refuses.
pub fn cost_figure(points: &[CostPoint], work: &str, cost: &str) -> Result<(Rgb8Image, Vec<CostLine>), ReportError> {
    let shown: Vec<&CostPoint> = points.iter().filter(|p| p.work.is_finite() && p.cost.is_finite()).collect();
    if shown.is_empty() {
        return Err(ReportError::Nothing("measurement"));
    }
    let mut lines: Vec<CostLine> = Vec::new();
    for point in &shown {
        if !lines.iter().any(|line| line.group == point.group) {
            lines.push(fit(&point.group, &shown));
        }
    }
    let top = |of: fn(&CostPoint) -> f64| 1.05 * shown.iter().map(|p| of(p)).fold(1e-9, f64::max);
    let (most_work, most_cost) = (top(|p| p.work), top(|p| p.cost));
    let mut image = Rgb8Image::filled(SIZE_PX.0, SIZE_PX.1, [255; 3]);
    draw_on(&mut image, |area| {
        let mut builder = ChartBuilder::on(area);
        builder.margin(14).x_label_area_size(44).y_label_area_size(64);
        let mut chart = builder.build_cartesian_2d(0.0..most_work, 0.0..most_cost).map_err(drawing)?;
        let mut mesh = chart.configure_mesh();
        mesh.x_desc(work).y_desc(cost).light_line_style(RGBColor(246, 246, 246));
        mesh.label_style((FONT, 16).into_font()).axis_desc_style((FONT, 17).into_font());
        mesh.draw().map_err(drawing)?;
        for (index, line) in lines.iter().enumerate() {
            let color = PALETTE[index % PALETTE.len()];
            let ends = [0.0, most_work].map(|x| (x, line.fixed + line.slope * x));
            let style = ShapeStyle { color: color.mix(0.5), filled: false, stroke_width: 1 };
            let series = chart.draw_series(LineSeries::new(ends, style)).map_err(drawing)?;
            series
                .label(line.group.clone())
                .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], color.stroke_width(2)));
            let dots = shown.iter().filter(|p| p.group == line.group);
            chart.draw_series(dots.map(|p| Circle::new((p.work, p.cost), 5, color.filled()))).map_err(drawing)?;
        }
        let mut legend = chart.configure_series_labels();
        legend.position(SeriesLabelPosition::UpperLeft).label_font((FONT, 16).into_font());
        legend.background_style(RGBColor(255, 255, 255)).draw().map_err(drawing)
    })?;
    Ok((image, lines))
}

/// Least squares; a group whose work never changes gets a flat line.
fn fit(group: &str, points: &[&CostPoint]) -> CostLine {
    let of_group: Vec<&&CostPoint> = points.iter().filter(|p| p.group == group).collect();
    let n = of_group.len() as f64;
    let mean = |of: &dyn Fn(&CostPoint) -> f64| of_group.iter().map(|p| of(p)).sum::<f64>() / n;
    let (x, y) = (mean(&|p| p.work), mean(&|p| p.cost));
    let (xx, xy, yy) =
        (mean(&|p| (p.work - x).powi(2)), mean(&|p| (p.work - x) * (p.cost - y)), mean(&|p| (p.cost - y).powi(2)));
    let slope = if xx > 0.0 { xy / xx } else { 0.0 };
    let explained = if yy > 0.0 { slope * xy / yy } else { 1.0 };
    CostLine { group: group.to_owned(), fixed: y - slope * x, slope, explained }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_line_is_found_and_drawn() -> Result<(), ReportError> {
        let point = |work: f64, cost: f64| CostPoint { group: "forward".into(), work, cost };
        let points = [point(0.0, 2.0), point(1.0, 5.0), point(2.0, 8.0), point(f64::NAN, 1.0)];
        let (image, lines) = cost_figure(&points, "pairs", "ms")?;
        assert_eq!(lines.len(), 1);
        let line = &lines[0];
        assert!(
            (line.fixed - 2.0).abs() < 1e-9 && (line.slope - 3.0).abs() < 1e-9 && (line.explained - 1.0).abs() < 1e-9
        );
        assert!(image.data.chunks_exact(3).filter(|p| **p == [0, 0, 0]).count() > 100);
        assert!(matches!(cost_figure(&points[3..], "pairs", "ms"), Err(ReportError::Nothing(_))));
        Ok(())
    }
}
