//! The contact sheet: a row a clip, a column a frame, and the difference of two rows enlarged.

use heartian_space::{Clip, Rgb8Image};
use plotters::style::RGBColor;

use crate::ReportError;
use crate::canvas::{draw_on, write_text};

const GUTTER_PX: usize = 4;
const LABEL_PX: usize = 24;
const PAPER: [u8; 3] = [24, 24, 26];
const INK: RGBColor = RGBColor(235, 235, 235);
/// How much the difference of baseline and modulated render is enlarged, around mid-grey.
const GAIN: i32 = 50;

/// `columns` evenly spaced frames of every clip, composited over black, one labelled row a clip; when a clip labelled
/// `baseline_rendered` and one labelled `rendered` are among them, their difference ×50 around mid-grey follows.
///
/// # Errors
/// When there is no clip or the clips differ in size or length.
pub fn contact_sheet(clips: &[&Clip], columns: usize) -> Result<Rgb8Image, ReportError> {
    let first = *clips.first().ok_or(ReportError::Nothing("clip"))?;
    clips.iter().try_for_each(|clip| check_alike(first, clip))?;
    let columns = columns.clamp(1, first.len());
    let frames: Vec<usize> = (0..columns).map(|c| (2 * c + 1) * first.len() / (2 * columns)).collect();

    let mut rows: Vec<(String, Vec<Rgb8Image>)> = Vec::new();
    for clip in clips {
        rows.push((clip.label.clone(), frames.iter().map(|&frame| clip.image_over_black(frame)).collect()));
        if clip.label == "rendered"
            && let Some(baseline) = clips.iter().find(|other| other.label == "baseline_rendered")
        {
            let images = frames.iter().map(|&frame| difference(clip.frame(frame), baseline.frame(frame), first));
            rows.push((format!("rendered − baseline, ×{GAIN}"), images.collect()));
        }
    }

    let (width, height) = (first.width + GUTTER_PX, first.height + GUTTER_PX + LABEL_PX);
    let mut sheet = Rgb8Image::filled(columns * width + GUTTER_PX, rows.len() * height + GUTTER_PX, PAPER);
    for (r, (_, images)) in rows.iter().enumerate() {
        for (c, image) in images.iter().enumerate() {
            sheet.paste(image, GUTTER_PX + c * width, r * height + LABEL_PX + GUTTER_PX);
        }
    }
    draw_on(&mut sheet, |area| {
        rows.iter().enumerate().try_for_each(|(r, (label, _))| {
            write_text(area, label, (GUTTER_PX as i32 + 2, (r * height + GUTTER_PX + 3) as i32), (17, INK))
        })
    })?;
    Ok(sheet)
}

/// Refuses clips that cannot stand in one sheet.
pub(crate) fn check_alike(first: &Clip, clip: &Clip) -> Result<(), ReportError> {
    let describe = |clip: &Clip| format!("{}×{}, {} frames", clip.width, clip.height, clip.len());
    if (clip.width, clip.height, clip.len()) == (first.width, first.height, first.len()) {
        Ok(())
    } else {
        Err(ReportError::Mismatch { label: clip.label.clone(), expected: describe(first), found: describe(clip) })
    }
}

fn difference(modulated: &[u8], baseline: &[u8], size: &Clip) -> Rgb8Image {
    let enlarge = |(a, b): (&u8, &u8)| (128 + GAIN * (i32::from(*a) - i32::from(*b))).clamp(0, 255) as u8;
    let data = modulated.iter().zip(baseline).map(enlarge).collect();
    Rgb8Image { width: size.width, height: size.height, data }
}

#[cfg(test)]
mod tests {
    use heartian_space::Sequence;

    use super::*;

    fn clip(label: &str, value: u8) -> Clip {
        let times_seconds = vec![0.0, 0.5, 1.0];
        let sequence = Sequence { frames: vec![value; 3 * 8 * 8 * 3], alpha: vec![255; 3 * 64], times_seconds };
        Clip::new(label, 8, 8, sequence).expect("a valid clip")
    }

    #[test]
    fn the_difference_row_shows_one_level_as_fifty() -> Result<(), ReportError> {
        let (baseline, modulated) = (clip("baseline_rendered", 100), clip("rendered", 101));
        let sheet = contact_sheet(&[&baseline, &modulated], 2)?;
        assert_eq!(sheet.width, 2 * 12 + 4);
        let row = 2 * (8 + GUTTER_PX + LABEL_PX) + LABEL_PX + GUTTER_PX;
        assert_eq!(sheet.pixel(GUTTER_PX + 3, row + 3), [178; 3]);
        Ok(())
    }

    #[test]
    fn unlike_clips_are_refused() {
        let mut longer = clip("rendered", 1);
        longer.width = 16;
        assert!(matches!(contact_sheet(&[&clip("input", 0), &longer], 2), Err(ReportError::Mismatch { .. })));
        assert!(matches!(contact_sheet(&[], 2), Err(ReportError::Nothing(_))));
    }
}
