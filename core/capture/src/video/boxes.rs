//! The boxes of an MP4 file (ISO/IEC 14496-12): where each video sample lies, when it is shown, how it is coded.
//!
//! Plain and fragmented files; edit lists move the start, display matrices turn the picture. Every number is checked
//! against the bytes that are there: a damaged table is an error, never a panic or a huge allocation.

mod cursor;
mod fragment;

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};

use super::yuv::Encoding;
use cursor::{Cursor, Parsed};

/// The movie header of an hour of video is a few megabytes.
const LARGEST_HEADER: u64 = 256 << 20;

/// One coded picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Sample {
    pub offset: u64,
    pub size: u32,
    /// Presentation time in ticks, edit list applied.
    pub shown: i64,
    pub is_sync: bool,
}

/// The first video track of a file.
#[derive(Clone, Debug)]
pub(super) struct Track {
    /// Four-character code of the coding (`avc1`).
    pub coding: [u8; 4],
    /// The H.264 configuration record; empty for other codings.
    pub configuration: Vec<u8>,
    pub ticks_per_second: u32,
    /// Clockwise.
    pub quarter_turns: u8,
    /// Colours as the container names them.
    pub encoding: Option<Encoding>,
    /// In decoding order.
    pub samples: Vec<Sample>,
    /// The first sample that was shown at the time of another, and that time in ticks.
    pub moved: Option<(usize, i64)>,
}

/// Reads the first video track of an MP4 file.
pub(super) fn read_track(file: &mut File) -> Result<Track, String> {
    let (movie, fragments) = headers(file)?;
    let movie = movie.ok_or("it has no movie header (`moov`): the recording was cut off before it was finished")?;
    let parse = || -> Parsed<Track> {
        let movie = Cursor(&movie);
        let mut rest = movie;
        while let Some((kind, content)) = rest.child()? {
            if kind == *b"trak" && is_video(content)? {
                let mut track = plain_track(content)?;
                for (offset, fragment) in &fragments {
                    fragment::add(&mut track, movie, Cursor(fragment), *offset)?;
                }
                finish(&mut track, content)?;
                return Ok(track);
            }
        }
        Err("it has no video track")
    };
    parse().map_err(str::to_owned)
}

type Fragment = (u64, Vec<u8>);

/// The movie header and the fragments' headers with their offsets; media data are passed over.
fn headers(file: &mut File) -> Result<(Option<Vec<u8>>, Vec<Fragment>), String> {
    let length = file.seek(SeekFrom::End(0)).map_err(|error| error.to_string())?;
    let (mut at, mut movie, mut fragments) = (0u64, None, Vec::new());
    while at + 8 <= length {
        file.seek(SeekFrom::Start(at)).map_err(|error| error.to_string())?;
        let mut head = [0; 16];
        let got = file.read(&mut head).map_err(|error| error.to_string())?;
        let mut cursor = Cursor(&head[..got]);
        let (Ok(size), Ok(kind)) = (cursor.u32(), cursor.array::<4>()) else { break };
        let (header, size) = match size {
            0 => (8, length - at),
            1 => (16, cursor.u64().map_err(str::to_owned)?),
            size => (8, u64::from(size)),
        };
        if size < header {
            return Err("a box is smaller than its own header".into());
        }
        if kind == *b"moov" || kind == *b"moof" {
            let content = size - header;
            if content > LARGEST_HEADER || at.saturating_add(size) > length {
                return Err("its header is cut short".into());
            }
            let mut bytes = vec![0; content as usize];
            file.seek(SeekFrom::Start(at + header)).map_err(|error| error.to_string())?;
            file.read_exact(&mut bytes).map_err(|error| error.to_string())?;
            if kind == *b"moov" { movie = Some(bytes) } else { fragments.push((at, bytes)) }
        }
        at = at.saturating_add(size);
    }
    Ok((movie, fragments))
}

fn is_video(track: Cursor<'_>) -> Parsed<bool> {
    let Some(mut handler) = track.path(&[b"mdia", b"hdlr"])? else { return Ok(false) };
    handler.take(8)?;
    Ok(handler.array::<4>()? == *b"vide")
}

fn plain_track(track: Cursor<'_>) -> Parsed<Track> {
    let mut header = track.need(&[b"mdia", b"mdhd"], "its video track has no media header")?;
    let (version, _) = header.full()?;
    header.take(if version == 1 { 16 } else { 8 })?;
    let ticks_per_second = header.u32()?.max(1);
    let table = track.need(&[b"mdia", b"minf", b"stbl"], "its video track has no sample table")?;
    let mut description = table.need(&[b"stsd"], "its video track has no sample description")?;
    description.take(8)?;
    let (coding, mut entry) = description.child()?.ok_or("its video track has no sample description")?;
    entry.take(78)?;
    let configuration = entry.find(b"avcC")?.map(|content| content.0.to_vec()).unwrap_or_default();
    Ok(Track {
        coding,
        configuration,
        ticks_per_second,
        quarter_turns: quarter_turns(track)?,
        encoding: colour(entry)?,
        samples: samples(table)?,
        moved: None,
    })
}

/// The display matrix `x' = a·x + c·y, y' = b·x + d·y`, as quarter turns clockwise; other matrices are ignored.
fn quarter_turns(track: Cursor<'_>) -> Parsed<u8> {
    let mut header = track.need(&[b"tkhd"], "its video track has no header")?;
    let (version, _) = header.full()?;
    header.take(if version == 1 { 48 } else { 36 })?;
    let [a, b, _, c, d] = [header.i32()?, header.i32()?, header.i32()?, header.i32()?, header.i32()?].map(i32::signum);
    Ok(match [a, b, c, d] {
        [0, 1, -1, 0] => 1,
        [-1, 0, 0, -1] => 2,
        [0, -1, 1, 0] => 3,
        _ => 0,
    })
}

fn colour(entry: Cursor<'_>) -> Parsed<Option<Encoding>> {
    let Some(mut colour) = entry.find(b"colr")? else { return Ok(None) };
    if colour.array::<4>()? != *b"nclx" {
        return Ok(None);
    }
    colour.take(4)?;
    let (matrix, flags) = (colour.u16()?, colour.u8()?);
    Ok(Some(Encoding { matrix: matrix as u8, full_range: flags & 0x80 != 0 }))
}

/// The sample table of an unfragmented track (empty in a fragmented one); `shown` is still the composition time.
fn samples(table: Cursor<'_>) -> Parsed<Vec<Sample>> {
    let Some(sizes) = table.find(b"stsz")?.map(sizes).transpose()? else { return Ok(Vec::new()) };
    let offsets = chunk_offsets(table)?;
    let mut runs = table.need(&[b"stsc"], "its video track does not say which chunk holds which sample")?;
    runs.full()?;
    let count = runs.count(12)?;
    let runs: Vec<[u32; 3]> = (0..count).map(|_| Ok([runs.u32()?, runs.u32()?, runs.u32()?])).collect::<Parsed<_>>()?;
    let mut samples = Vec::with_capacity(sizes.len());
    let mut sizes = sizes.into_iter();
    for (run, [first, per_chunk, _]) in runs.iter().enumerate() {
        let end = runs.get(run + 1).map_or(offsets.len(), |next| (next[0] as usize).saturating_sub(1));
        for chunk in (*first as usize).saturating_sub(1)..end.min(offsets.len()) {
            let mut offset = offsets[chunk];
            for size in sizes.by_ref().take(*per_chunk as usize) {
                samples.push(Sample { offset, size, shown: 0, is_sync: true });
                offset = offset.checked_add(u64::from(size)).ok_or("a sample's position is absurd")?;
            }
        }
    }
    decoding_times(table, &mut samples)?;
    composition_offsets(table, &mut samples)?;
    if let Some(mut sync) = table.find(b"stss")? {
        sync.full()?;
        samples.iter_mut().for_each(|sample| sample.is_sync = false);
        for _ in 0..sync.count(4)? {
            let number = sync.u32()? as usize;
            if let Some(sample) = number.checked_sub(1).and_then(|i| samples.get_mut(i)) {
                sample.is_sync = true;
            }
        }
    }
    Ok(samples)
}

fn sizes(mut table: Cursor<'_>) -> Parsed<Vec<u32>> {
    table.full()?;
    let all = table.u32()?;
    if all != 0 {
        let count = table.u32()?;
        // Samples of one size carry no list to check the count against.
        return if count <= 1 << 24 { Ok(vec![all; count as usize]) } else { Err("the number of samples is absurd") };
    }
    let count = table.count(4)?;
    (0..count).map(|_| table.u32()).collect()
}

fn chunk_offsets(table: Cursor<'_>) -> Parsed<Vec<u64>> {
    if let Some(mut offsets) = table.find(b"stco")? {
        offsets.full()?;
        let count = offsets.count(4)?;
        return (0..count).map(|_| Ok(u64::from(offsets.u32()?))).collect();
    }
    let mut offsets = table.need(&[b"co64"], "its video track does not say where its samples lie")?;
    offsets.full()?;
    let count = offsets.count(8)?;
    (0..count).map(|_| offsets.u64()).collect()
}

fn decoding_times(table: Cursor<'_>, samples: &mut [Sample]) -> Parsed<()> {
    let mut runs = table.need(&[b"stts"], "its video track has no sample times")?;
    runs.full()?;
    let (mut time, mut rest) = (0i64, samples.iter_mut());
    for _ in 0..runs.count(8)? {
        let (count, delta) = (runs.u32()?, runs.u32()?);
        for sample in rest.by_ref().take(count as usize) {
            sample.shown = time;
            time = time.checked_add(i64::from(delta)).ok_or("a sample's time is absurd")?;
        }
    }
    if rest.next().is_some() { Err("its video track has fewer times than samples") } else { Ok(()) }
}

fn composition_offsets(table: Cursor<'_>, samples: &mut [Sample]) -> Parsed<()> {
    let Some(mut runs) = table.find(b"ctts")? else { return Ok(()) };
    runs.full()?;
    let mut rest = samples.iter_mut();
    for _ in 0..runs.count(8)? {
        let (count, offset) = (runs.u32()?, runs.i32()?);
        rest.by_ref().take(count as usize).for_each(|sample| sample.shown += i64::from(offset));
    }
    Ok(())
}

/// Applies the edit list's start and orders nothing else: samples stay in decoding order.
fn finish(track: &mut Track, content: Cursor<'_>) -> Parsed<()> {
    let mut start = None;
    if let Some(mut edits) = content.path(&[b"edts", b"elst"])? {
        let (version, _) = edits.full()?;
        for _ in 0..edits.count(if version == 1 { 20 } else { 12 })? {
            edits.word(version)?;
            let media = if version == 1 { edits.u64()? as i64 } else { i64::from(edits.i32()?) };
            edits.u32()?;
            if media >= 0 && start.is_none() {
                start = Some(media);
            }
        }
    }
    let earliest = track.samples.iter().map(|sample| sample.shown).min().unwrap_or(0);
    let start = start.unwrap_or(earliest);
    track.samples.iter_mut().for_each(|sample| sample.shown = sample.shown.saturating_sub(start));
    part_times(track);
    Ok(())
}

/// Two pictures at one time would make the display order ambiguous: the later coded moves on by a tick.
fn part_times(track: &mut Track) {
    let mut order: Vec<usize> = (0..track.samples.len()).collect();
    order.sort_by_key(|index| (track.samples[*index].shown, *index));
    let mut before: Option<i64> = None;
    for index in order {
        let sample = &mut track.samples[index];
        if let Some(least) = before.and_then(|before| before.checked_add(1)).filter(|least| sample.shown < *least) {
            track.moved.get_or_insert((index, sample.shown));
            sample.shown = least;
        }
        before = Some(sample.shown);
    }
}
