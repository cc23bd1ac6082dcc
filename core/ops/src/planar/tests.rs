//! The planar convolution against its definition in f64, over odd sizes, missing frames and shifted channels.

#![expect(clippy::unwrap_used, reason = "tests")]

use super::*;
use crate::Extent;

fn numbers(count: usize, seed: u32) -> Vec<f32> {
    let mut state = seed.wrapping_mul(2_654_435_761) | 1;
    (0..count)
        .map(|_| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / 8_388_608.0 - 1.0
        })
        .collect()
}

struct Case {
    extent: Extent,
    outputs: usize,
    kernel: [usize; 3],
    pad: [usize; 2],
    margin: usize,
}

/// The sum that the kernel should give, term by term.
fn exact(
    case: &Case,
    dense: &[f32],
    weights: &[f32],
    at: [usize; 4],
    source: &dyn Fn(usize, usize) -> Option<usize>,
) -> f64 {
    let ([o, _, y, x], [kt, ky, kx]) = (at, case.kernel);
    let Extent { frames, channels, height, width } = case.extent;
    let mut sum = 0.0;
    for c in 0..channels {
        for t in 0..kt {
            let Some(frame) = source(c, t).filter(|frame| *frame < frames) else { continue };
            for (dy, dx) in (0..ky * kx).map(|tap| (tap / kx, tap % kx)) {
                let (row, column) = ((y + dy).wrapping_sub(case.pad[0]), (x + dx).wrapping_sub(case.pad[1]));
                if row < height && column < width {
                    let weight = weights[(((o * channels + c) * kt + t) * ky + dy) * kx + dx];
                    sum += f64::from(weight) * f64::from(dense[((c * frames + frame) * height + row) * width + column]);
                }
            }
        }
    }
    sum
}

#[test]
fn every_output_is_its_defining_sum() {
    let extent = |frames, channels, height, width| Extent { frames, channels, height, width };
    let cases = [
        Case { extent: extent(4, 3, 9, 11), outputs: 5, kernel: [3, 3, 3], pad: [1, 1], margin: 1 },
        Case { extent: extent(2, 7, 30, 40), outputs: 8, kernel: [1, 3, 3], pad: [0, 0], margin: 0 },
        Case { extent: extent(2, 3, 13, 6), outputs: 1, kernel: [1, 5, 5], pad: [2, 2], margin: 2 },
        Case { extent: extent(3, 70, 5, 4), outputs: 12, kernel: [3, 3, 3], pad: [1, 1], margin: 2 },
        Case { extent: extent(1, 1, 1, 1), outputs: 2, kernel: [1, 1, 1], pad: [0, 0], margin: 0 },
        Case { extent: extent(3, 4, 6, 300), outputs: 4, kernel: [2, 2, 2], pad: [0, 1], margin: 1 },
    ];
    for (index, case) in cases.iter().enumerate() {
        let Extent { frames, channels, height, width } = case.extent;
        let [kt, ky, kx] = case.kernel;
        let tolerance = 1e-6 + 1e-7 * (channels * kt * ky * kx) as f64;
        let dense = numbers(case.extent.values(), index as u32);
        let weights = numbers(case.outputs * channels * kt * ky * kx, 91 + index as u32);
        let bias = numbers(case.outputs, 7);
        let volume = Volume::from_dense(case.extent, case.margin, &dense, false).unwrap();
        let convolution = Convolution::new(&weights, &bias, [case.outputs, channels], case.kernel).unwrap();
        let output = [height + 2 * case.pad[0] + 1 - ky, width + 2 * case.pad[1] + 1 - kx];
        for t in 0..frames {
            // The first channels are read a frame later, as a temporal shift does; what is before frame 0 is missing.
            let source = move |c: usize, k: usize| if c < channels / 3 { Some(t + k) } else { (t + k).checked_sub(1) };
            let windows = Windows { before: case.pad, output, source };
            let mut seen = 0;
            convolution
                .frame(&volume, &windows, &mut Scratch::default(), |strip| {
                    for o in 0..case.outputs {
                        for r in 0..strip.rows {
                            let y = strip.first_row + r;
                            for (x, got) in strip.row(o, r).iter().enumerate() {
                                let want = exact(case, &dense, &weights, [o, t, y, x], &source) + f64::from(bias[o]);
                                assert!((f64::from(*got) - want).abs() < tolerance, "case {index} {:?}", [o, t, y, x]);
                                seen += 1;
                            }
                        }
                    }
                })
                .unwrap();
            assert_eq!(seen, case.outputs * output[0] * output[1]);
        }
    }
}

#[test]
fn windows_that_leave_the_margin_are_refused() {
    let extent = Extent { frames: 1, channels: 2, height: 4, width: 4 };
    let volume = Volume::zeros(extent, 1);
    let convolution = Convolution::new(&[1.0; 18], &[], [1, 2], [1, 3, 3]).unwrap();
    let run = |before, output| {
        let windows = Windows { before, output, source: |_, _| Some(0) };
        convolution.frame(&volume, &windows, &mut Scratch::default(), |_| {})
    };
    assert!(run([1, 1], [4, 4]).is_ok() && run([0, 0], [2, 2]).is_ok());
    assert!(run([2, 1], [4, 4]).is_err() && run([1, 1], [5, 4]).is_err() && run([0, 0], [0, 1]).is_err());
    assert!(Convolution::new(&[1.0; 17], &[], [1, 2], [1, 3, 3]).is_err());
    assert!(Convolution::new(&[1.0; 18], &[0.0; 2], [1, 2], [1, 3, 3]).is_err());
}

#[test]
fn pairs_of_frames_give_the_sums_of_single_ones() {
    for (frames, channels, outputs, side) in [(5, 3, 6, 9), (2, 20, 4, 24), (1, 2, 1, 3)] {
        let extent = Extent { frames, channels, height: side, width: side + 1 };
        let (dense, bias) = (numbers(extent.values(), 5), numbers(outputs, 6));
        let weights = numbers(outputs * channels * 27, 7);
        let volume = Volume::from_dense(extent, 1, &dense, false).unwrap();
        let paired = PairedConvolution::new(&weights, &bias, [outputs, channels], [3, 3]).unwrap();
        let case = Case { extent, outputs, kernel: [3, 3, 3], pad: [1, 1], margin: 1 };
        let (mut scratch, mut seen) = (PairScratch::default(), 0);
        for pair in 0..frames.div_ceil(2) {
            let sink = |which: usize, strip: &mut Strip<'_>| {
                let t = 2 * pair + which;
                let source = move |_: usize, k: usize| (t + k).checked_sub(1);
                let rows = strip.rows;
                for (o, r) in (0..outputs * rows).map(|i| (i / rows, i % rows)) {
                    let y = strip.first_row + r;
                    for (x, got) in strip.row(o, r).iter().enumerate() {
                        let want = exact(&case, &dense, &weights, [o, t, y, x], &source) + f64::from(bias[o]);
                        assert!((f64::from(*got) - want).abs() < 1e-4, "{:?} {got} {want}", [o, t, y, x]);
                        seen += 1;
                    }
                }
            };
            let size = [[1, 1], [side, side + 1]];
            paired.pair(&volume, 2 * pair as isize - 1, size, &mut scratch, sink).unwrap();
        }
        assert_eq!(seen, outputs * frames.next_multiple_of(2) * side * (side + 1));
    }
    assert!(PairedConvolution::new(&[0.0; 26], &[], [1, 1], [3, 3]).is_err());
}

#[test]
fn pairs_of_rows_give_the_sums_of_single_ones() {
    for (channels, [height, width], pad) in [(3, [9, 12], 1), (6, [24, 30], 0), (2, [4, 3], 0), (4, [3, 3], 0)] {
        let (frames, outputs) = (3, 5);
        let extent = Extent { frames, channels, height, width };
        let (dense, bias) = (numbers(extent.values(), 15), numbers(outputs, 16));
        let weights = numbers(outputs * channels * 9, 17);
        let volume = Volume::from_dense(extent, pad, &dense, false).unwrap();
        let paired = PairedConvolution::new(&weights, &bias, [outputs, channels], [1, 3]).unwrap();
        let case = Case { extent, outputs, kernel: [1, 3, 3], pad: [pad, pad], margin: pad };
        let output = [height + 2 * pad - 2, width + 2 * pad - 2];
        let (mut scratch, mut seen) = (PairScratch::default(), 0);
        for t in 0..frames {
            let source = move |c: usize, _: usize| if c < channels / 3 { Some(t + 1) } else { Some(t) };
            let windows = Windows { before: [pad, pad], output, source };
            let sink = |strip: &mut Strip<'_>| {
                let rows = strip.rows;
                for (o, r) in (0..outputs * rows).map(|i| (i / rows, i % rows)) {
                    let y = strip.first_row + r;
                    let got = strip.row(o, r).to_vec();
                    if r + 1 < rows && r % 2 == 0 {
                        assert_eq!(strip.two_rows(o, r).0, got);
                    }
                    for (x, got) in got.iter().enumerate() {
                        let want = exact(&case, &dense, &weights, [o, t, y, x], &source) + f64::from(bias[o]);
                        assert!((f64::from(*got) - want).abs() < 2e-5, "{:?} {got} {want}", [o, t, y, x]);
                        seen += 1;
                    }
                }
            };
            paired.frame(&volume, &windows, &mut scratch, sink).unwrap();
        }
        assert_eq!(seen, frames * outputs * output[0] * output[1]);
    }
}
