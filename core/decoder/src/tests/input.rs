//! What a network does with input it cannot take, and that it answers the same however it is run.

use crate::bench::seeded_weights;
use crate::{Architecture, Batch, DecoderError, Factorisation, Network, Options};

fn network(architecture: Architecture) -> Network {
    Network::new(&seeded_weights(architecture).unwrap(), &Options::default()).unwrap()
}

/// A chunk of a few frames, different from pixel to pixel.
fn chunk(network: &Network, frames: usize, phase: f32) -> Vec<f32> {
    let len = network.input().chunk_len(frames);
    (0..len).map(|i| (i as f32 * 0.61 + phase).sin() + (i as f32 * 3e-3).cos()).collect()
}

#[test]
fn chunks_of_another_form_are_refused() {
    for architecture in Architecture::ALL {
        let network = network(architecture);
        let form = network.input();
        let frames = form.frame_multiple * 2;
        let values = chunk(&network, frames, 0.0);
        let run = |data: &[f32], chunks, frames| network.run(Batch { data, chunks, frames });
        assert!(matches!(run(&values, 1, 0), Err(DecoderError::ChunkLength { .. })));
        if form.frame_multiple > 1 {
            assert!(matches!(run(&values, 1, frames - 1), Err(DecoderError::ChunkLength { .. })));
        }
        for (data, chunks) in
            [(&values[1..], 1), (&values[..], 0), (&values[..], 2), (&values[..], usize::MAX), (&[], 1)]
        {
            assert!(
                matches!(run(data, chunks, frames), Err(DecoderError::BatchSize { .. })),
                "{}",
                architecture.name()
            );
        }
        for bad in [f32::NAN, f32::INFINITY] {
            let mut values = values.clone();
            values[7] = bad;
            assert!(matches!(run(&values, 1, frames), Err(DecoderError::InputNotFinite { index: 7, .. })));
        }
        // So large that sums overflow: an error that says so, or a saturated but finite answer.
        let huge: Vec<f32> = values.iter().map(|v| v * 1e38).collect();
        match run(&huge, 1, frames) {
            Ok(out) => assert!(out.iter().all(|v| v.is_finite())),
            Err(error) => assert!(matches!(error, DecoderError::OutputNotFinite { .. }), "{error}"),
        }
        let black = vec![0.0; values.len()];
        assert_eq!(run(&black, 1, frames).unwrap().len(), frames);
    }
}

#[test]
fn threads_do_not_change_a_bit() {
    for architecture in Architecture::ALL {
        let network = network(architecture);
        let frames = network.input().frame_multiple.max(2) * 3;
        let values = chunk(&network, frames, 0.3);
        let run = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| network.run(Batch::one(&values, frames)).unwrap())
        };
        let one = run(1);
        assert!(one.iter().any(|v| *v != one[0]), "{} answers a constant", architecture.name());
        for threads in [2, 5] {
            let other = run(threads);
            assert!(one.iter().zip(&other).all(|(a, b)| a.to_bits() == b.to_bits()), "{}", architecture.name());
        }
    }
}

#[test]
fn chunks_of_a_batch_do_not_see_each_other() {
    for architecture in Architecture::ALL {
        let network = network(architecture);
        let frames = network.input().frame_multiple.max(2) * 2;
        let (a, b) = (chunk(&network, frames, 0.0), chunk(&network, frames, 1.7));
        let alone = [&a, &b].map(|chunk| network.run(Batch::one(chunk, frames)).unwrap()).concat();
        let together = network.run(Batch { data: &[a, b].concat(), chunks: 2, frames }).unwrap();
        assert_eq!(alone, together, "{}", architecture.name());
    }
}

#[test]
fn options_that_do_not_fit_are_named() {
    let build = |architecture, options: Options| {
        Network::new(&seeded_weights(architecture).unwrap(), &options).map(|network| network.architecture())
    };
    let wrong = [
        (Architecture::PhysFormer, Options { heads: 5, ..Options::default() }),
        (Architecture::PhysFormer, Options { heads: 0, ..Options::default() }),
        (Architecture::PhysFormer, Options { theta: f32::NAN, ..Options::default() }),
        (Architecture::PhysFormer, Options { sharpness: 0.0, ..Options::default() }),
        (Architecture::TsCan, Options { segment_frames: 0, ..Options::default() }),
        (Architecture::PhysNet, Options { side_px: Some(8), ..Options::default() }),
    ];
    for (architecture, options) in wrong {
        let error = build(architecture, options).unwrap_err();
        assert!(matches!(error, DecoderError::Option { .. }), "{error}");
    }
    let on = Options { factorisation: Factorisation::On, ..Options::default() };
    assert_eq!(build(Architecture::FactorizePhys, on).unwrap(), Architecture::FactorizePhys);
}
