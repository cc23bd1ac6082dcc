//! Foreground colours at a soft edge, by blur fusion (Forte, "Approximate Fast Foreground Colour Estimation", ICIP 2021).

use heartian_space::Rgb8Image;

use super::guided::box_mean;

/// Replaces colours where alpha is strictly between 0 and 1 by an estimate of the foreground alone; others stay.
pub(super) fn replace_background(image: &mut Rgb8Image, alpha: &[f32], scale: f32) {
    let size = image.width;
    // A wide pass first, then a narrow one that starts from its result.
    let radii = [16.0, 4.0].map(|radius: f32| ((radius * scale).round() as usize).max(1));
    for channel in 0..3 {
        let plane: Vec<f32> = image.data.iter().skip(channel).step_by(3).map(|v| f32::from(*v)).collect();
        let (mut fore, mut back) = (plane.clone(), plane.clone());
        for radius in radii {
            (fore, back) = fuse(&plane, alpha, (&fore, &back), size, radius);
        }
        for (i, value) in fore.iter().enumerate() {
            if alpha[i] > 0.0 && alpha[i] < 1.0 {
                image.data[3 * i + channel] = (value + 0.5).clamp(0.0, 255.0) as u8;
            }
        }
    }
}

/// One pass: local means of fore- and background, then the correction that makes them compose to the picture.
fn fuse(
    plane: &[f32],
    alpha: &[f32],
    (fore, back): (&[f32], &[f32]),
    size: usize,
    radius: usize,
) -> (Vec<f32>, Vec<f32>) {
    let mean = |f: &dyn Fn(usize) -> f32| box_mean(&(0..alpha.len()).map(f).collect::<Vec<_>>(), size, radius);
    let weight = mean(&|i| alpha[i]);
    let fore_sum = mean(&|i| alpha[i] * fore[i]);
    let back_sum = mean(&|i| (1.0 - alpha[i]) * back[i]);
    let mut out = (Vec::with_capacity(plane.len()), Vec::with_capacity(plane.len()));
    for i in 0..plane.len() {
        let local = if weight[i] > 1e-4 { fore_sum[i] / weight[i] } else { fore[i] };
        let behind = if weight[i] < 1.0 - 1e-4 { back_sum[i] / (1.0 - weight[i]) } else { back[i] };
        let rest = plane[i] - alpha[i] * local - (1.0 - alpha[i]) * behind;
        out.0.push((local + alpha[i] * rest).clamp(0.0, 255.0));
        out.1.push(behind);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mixed_edge_gets_its_foreground_back_and_the_inside_stays() {
        let size = 64;
        let (skin, wall) = ([200.0, 150.0, 120.0], [20.0, 40.0, 220.0]);
        let alpha: Vec<f32> =
            (0..size * size).map(|i| (1.0 - ((i % size) as f32 - 30.0) / 6.0).clamp(0.0, 1.0)).collect();
        let mut image = Rgb8Image::filled(size, size, [0; 3]);
        for (i, a) in alpha.iter().enumerate() {
            let mixed = std::array::from_fn(|c| (a * skin[c] + (1.0 - a) * wall[c]).round() as u8);
            image.set_pixel(i % size, i / size, mixed);
        }
        let inside = image.pixel(10, 30);
        replace_background(&mut image, &alpha, 1.0);
        assert_eq!(image.pixel(10, 30), inside);
        for x in 30..36 {
            let pixel = image.pixel(x, 30);
            let off: f32 = (0..3).map(|c| (f32::from(pixel[c]) - skin[c]).abs()).fold(0.0, f32::max);
            assert!(off < 12.0, "column {x}: {pixel:?}");
        }
    }
}
