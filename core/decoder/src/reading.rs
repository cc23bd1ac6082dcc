//! One pass over a recording's frames for any number of decoders.
//!
//! Each frame is given once: its mean colour for the classical methods, its face crop for the networks, which is resized
//! once for each side that a network wants. With [`Statistics::PerChunk`] a network runs as soon as its chunk is full and
//! no more than a chunk of crops is held; with [`Statistics::WholeClip`], the toolbox's way, crops are held to the end
//! (16 kB a frame at 72², 49 kB at 128²). Frames after the last whole chunk are not decoded by networks.

use heartian_signal::methods::Rgb;
use heartian_signal::trace::even_rgb;
use heartian_signal::{Protocol, SignalError, resampled_evenly};

use crate::preprocess::{Pixels, Scaling, resize_area};
use crate::{Batch, DecoderError, InputForm, Network, Normalisation, Output, Reader, standardised_batch};

/// Over what a network's normalisation is measured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Statistics {
    /// All frames, as the toolbox does.
    #[default]
    WholeClip,
    /// Each chunk by itself: bounded memory, live.
    PerChunk,
}

/// A recovered pulse, evenly sampled, in arbitrary units and of arbitrary sign.
#[derive(Clone, Debug, PartialEq)]
pub struct Wave {
    /// Sampling rate, hertz.
    pub rate_hertz: f64,
    /// Time of the first sample, seconds.
    pub start_seconds: f64,
    /// Samples; derivatives are summed up already.
    pub values: Vec<f64>,
}

/// Frames as they come, and what the decoders have made of them so far.
#[derive(Debug)]
pub struct Reading<'a> {
    readers: &'a [Reader],
    statistics: Statistics,
    times_seconds: Vec<f64>,
    colors: Vec<Rgb>,
    crops: Vec<Crops>,
    feeds: Vec<Feed>,
}

/// Resized face crops of one side, from frame `first` on.
#[derive(Debug)]
struct Crops {
    side_px: usize,
    first: usize,
    data: Vec<u8>,
}

impl Crops {
    fn frame_bytes(&self) -> usize {
        3 * self.side_px * self.side_px
    }

    /// Codes of frames `from..to`, as far as they are held.
    fn frames(&self, from: usize, to: usize) -> &[u8] {
        let at = |frame: usize| ((frame - self.first) * self.frame_bytes()).min(self.data.len());
        &self.data[at(from)..at(to)]
    }
}

/// Where a network is.
#[derive(Debug)]
struct Feed {
    /// Which reader.
    reader: usize,
    /// Which crops.
    crops: usize,
    /// Samples so far; also the next frame to decode.
    samples: Vec<f64>,
    /// Whether any chunk varied.
    alive: bool,
    failed: Option<DecoderError>,
}

impl<'a> Reading<'a> {
    /// A reading that has seen nothing.
    pub fn new(readers: &'a [Reader], statistics: Statistics) -> Self {
        let (mut crops, mut feeds) = (Vec::<Crops>::new(), Vec::new());
        for (reader, network) in readers.iter().enumerate().filter_map(|(index, reader)| match reader {
            Reader::Neural(network) => Some((index, network)),
            Reader::Classical(_) => None,
        }) {
            let side_px = network.input().side_px;
            let place = crops.iter().position(|crops| crops.side_px == side_px).unwrap_or(crops.len());
            if place == crops.len() {
                crops.push(Crops { side_px, first: 0, data: Vec::new() });
            }
            feeds.push(Feed { reader, crops: place, samples: Vec::new(), alive: false, failed: None });
        }
        Self { readers, statistics, times_seconds: Vec::new(), colors: Vec::new(), crops, feeds }
    }

    /// Whether any decoder looks at face crops.
    pub fn wants_crops(&self) -> bool {
        !self.crops.is_empty()
    }

    /// Takes the next frame: its time (seconds, increasing), the mean colour of the pixels that count (codes 0–255), and
    /// the face crop.
    pub fn frame(&mut self, seconds: f64, color: Rgb, face: &Pixels<'_>) {
        self.times_seconds.push(seconds);
        self.colors.push(color);
        for crops in &mut self.crops {
            crops.data.extend(resize_area(face, (crops.side_px, crops.side_px)));
        }
        if self.statistics == Statistics::PerChunk {
            for index in 0..self.feeds.len() {
                self.run_ready(index, None);
            }
            self.forget();
        }
    }

    /// Decodes the whole chunks that a network has not seen yet; `scalings` are those of the whole clip.
    fn run_ready(&mut self, index: usize, scalings: Option<&[Scaling]>) {
        let frames = self.times_seconds.len();
        let feed = &mut self.feeds[index];
        let (Reader::Neural(network), crops) = (&self.readers[feed.reader], &self.crops[feed.crops]) else { return };
        let length = network.input().frames;
        while feed.failed.is_none() && feed.samples.len() + length <= frames {
            let from = feed.samples.len();
            let (chunk, next) = (crops.frames(from, from + length), crops.frames(from + length, from + length + 1));
            let next = if scalings.is_some() { next } else { &[] };
            match decode_chunk(network, chunk, next, scalings) {
                Ok(Some(samples)) => {
                    feed.alive = true;
                    feed.samples.extend(samples);
                }
                Ok(None) => feed.samples.resize(from + length, 0.0),
                Err(error) => feed.failed = Some(error),
            }
        }
    }

    /// Drops crops that every network has seen.
    fn forget(&mut self) {
        for (place, crops) in self.crops.iter_mut().enumerate() {
            let users = self.feeds.iter().filter(|feed| feed.crops == place && feed.failed.is_none());
            let needed = users.map(|feed| feed.samples.len()).min().unwrap_or(self.times_seconds.len());
            let bytes = ((needed - crops.first) * crops.frame_bytes()).min(crops.data.len());
            crops.data.drain(..bytes);
            crops.first = needed;
        }
    }

    /// What each decoder found, in the order of the decoders. `protocol` tells the smoothness of the detrending inside
    /// some of the classical methods.
    pub fn finish(mut self, protocol: &Protocol) -> Vec<Result<Wave, DecoderError>> {
        if self.statistics == Statistics::WholeClip {
            for index in 0..self.feeds.len() {
                let Reader::Neural(network) = &self.readers[self.feeds[index].reader] else { continue };
                let crops = &self.crops[self.feeds[index].crops];
                let scalings = scalings_of(network.input(), &crops.data, crops.frame_bytes());
                self.run_ready(index, Some(&scalings));
            }
        }
        let even = even_rgb(&self.times_seconds, &self.colors);
        let mut feeds = self.feeds.into_iter();
        let wave = |reader: &Reader| match reader {
            Reader::Classical(method) => {
                let (rgb, rate_hertz) = even.as_ref().map_err(|error| error.clone())?;
                let values = method.trace_smoothed(rgb, *rate_hertz, protocol.detrend)?;
                Ok(Wave { rate_hertz: *rate_hertz, start_seconds: self.times_seconds[0], values })
            }
            Reader::Neural(network) => {
                let Some(feed) = feeds.next() else { return Err(DecoderError::Signal(SignalError::Empty("the clip"))) };
                neural_wave(network, feed, &self.times_seconds)
            }
        };
        self.readers.iter().map(wave).collect()
    }
}

/// The samples of a network as a pulse on an even grid.
fn neural_wave(network: &Network, feed: Feed, times_seconds: &[f64]) -> Result<Wave, DecoderError> {
    if let Some(error) = feed.failed {
        return Err(error);
    }
    let (architecture, frames) = (network.architecture().name(), times_seconds.len());
    if feed.samples.is_empty() {
        return Err(DecoderError::ShortClip { architecture, frames, needed: network.input().frames });
    }
    if !feed.alive {
        return Err(DecoderError::Still { architecture, frames });
    }
    let mut pulse = feed.samples;
    if network.input().output == Output::Derivative {
        let mut sum = 0.0;
        pulse.iter_mut().for_each(|value| {
            sum += *value;
            *value = sum;
        });
    }
    let even = resampled_evenly(&times_seconds[..pulse.len()], &pulse)?;
    Ok(Wave { rate_hertz: even.rate_hertz, start_seconds: times_seconds[0], values: even.values })
}

/// The scalars of a network's normalisations, one after the other.
fn scalings_of(form: &InputForm, frames: &[u8], frame_bytes: usize) -> Vec<Scaling> {
    form.normalisations.iter().map(|normalisation| Scaling::of(frames, frame_bytes, *normalisation)).collect()
}

/// One chunk through a network; `None` when its frames are all the same, so that there is nothing to decode.
fn decode_chunk(
    network: &Network,
    chunk: &[u8],
    next: &[u8],
    scalings: Option<&[Scaling]>,
) -> Result<Option<Vec<f64>>, DecoderError> {
    let form = network.input();
    let pixels = form.side_px * form.side_px;
    let frame_bytes = 3 * pixels;
    if Scaling::of(chunk, frame_bytes, Normalisation::DiffNormalized).is_flat() {
        return Ok(None);
    }
    let own = scalings.is_none().then(|| scalings_of(form, chunk, frame_bytes));
    let scalings = scalings.or(own.as_deref()).unwrap_or(&[]);
    let total = form.frames + form.extra_frames;
    let mut data = Vec::with_capacity(form.chunk_len(form.frames));
    for scaling in scalings {
        let numbers = scaling.apply(chunk, next, frame_bytes);
        for channel in 0..3 {
            for frame in 0..total {
                let from = frame.min(form.frames - 1) * frame_bytes;
                let pixels = numbers[from..from + frame_bytes].as_chunks::<3>().0;
                data.extend(pixels.iter().map(|pixel| pixel[channel]));
            }
        }
    }
    let mut samples = network.run(Batch::one(&data, form.frames))?;
    if form.output == Output::Pulse {
        // The toolbox's trainer of such networks standardises what comes out, batch by batch; a constant has no pulse.
        samples = standardised_batch(&samples).into_iter().map(|v| if v.is_finite() { v } else { 0.0 }).collect();
    }
    Ok(Some(samples.into_iter().map(f64::from).collect()))
}
