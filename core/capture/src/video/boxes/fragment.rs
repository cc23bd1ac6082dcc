//! Fragments: the samples of a recording whose header was written before its end was known.

use super::cursor::{Cursor, Parsed};
use super::{Sample, Track, is_video};

/// What a fragment's samples have unless they say otherwise.
#[derive(Clone, Copy, Default)]
struct Defaults {
    duration: u32,
    size: u32,
    flags: u32,
}

/// Adds the samples of one fragment, whose header begins at `start`, to the first video track.
pub(super) fn add(track: &mut Track, movie: Cursor<'_>, fragment: Cursor<'_>, start: u64) -> Parsed<()> {
    let extends = movie.path(&[b"mvex"])?;
    let mut rest = fragment;
    while let Some((kind, content)) = rest.child()? {
        if kind == *b"traf" && fragment_is_video(movie, content)? {
            add_runs(track, extends, content, start)?;
        }
    }
    Ok(())
}

/// Whether a track fragment belongs to the first video track.
fn fragment_is_video(movie: Cursor<'_>, fragment: Cursor<'_>) -> Parsed<bool> {
    let mut header = fragment.need(&[b"tfhd"], "a fragment has no header")?;
    header.full()?;
    let wanted = header.u32()?;
    let mut rest = movie;
    while let Some((kind, content)) = rest.child()? {
        if kind == *b"trak" && is_video(content)? {
            let mut header = content.need(&[b"tkhd"], "its video track has no header")?;
            let (version, _) = header.full()?;
            header.take(if version == 1 { 16 } else { 8 })?;
            return Ok(header.u32()? == wanted);
        }
    }
    Ok(false)
}

fn track_defaults(extends: Option<Cursor<'_>>, id: u32) -> Parsed<Defaults> {
    let Some(mut rest) = extends else { return Ok(Defaults::default()) };
    while let Some((kind, mut content)) = rest.child()? {
        if kind == *b"trex" {
            content.full()?;
            if content.u32()? == id {
                content.u32()?;
                return Ok(Defaults { duration: content.u32()?, size: content.u32()?, flags: content.u32()? });
            }
        }
    }
    Ok(Defaults::default())
}

fn add_runs(track: &mut Track, extends: Option<Cursor<'_>>, fragment: Cursor<'_>, start: u64) -> Parsed<()> {
    let mut header = fragment.need(&[b"tfhd"], "a fragment has no header")?;
    let (_, flags) = header.full()?;
    let mut defaults = track_defaults(extends, header.u32()?)?;
    let base = if flags & 1 != 0 { header.u64()? } else { start };
    if flags & 2 != 0 {
        header.u32()?;
    }
    for (bit, field) in [(8, &mut defaults.duration), (0x10, &mut defaults.size), (0x20, &mut defaults.flags)] {
        if flags & bit != 0 {
            *field = header.u32()?;
        }
    }
    let mut time = match fragment.find(b"tfdt")? {
        Some(mut start) => {
            let (version, _) = start.full()?;
            i64::try_from(start.word(version)?).map_err(|_| "a fragment's time is absurd")?
        }
        None => 0,
    };
    let (mut rest, mut offset) = (fragment, base);
    while let Some((kind, content)) = rest.child()? {
        if kind == *b"trun" {
            add_run(track, content, defaults, (&mut time, &mut offset), base)?;
        }
    }
    Ok(())
}

fn add_run(
    track: &mut Track,
    mut run: Cursor<'_>,
    defaults: Defaults,
    (time, offset): (&mut i64, &mut u64),
    base: u64,
) -> Parsed<()> {
    let (_, flags) = run.full()?;
    let count = run.u32()?;
    if flags & 1 != 0 {
        *offset = base.checked_add_signed(i64::from(run.i32()?)).ok_or("a sample's position is absurd")?;
    }
    let first_flags = if flags & 4 != 0 { Some(run.u32()?) } else { None };
    let per_sample = (flags & 0xf00).count_ones() as usize * 4;
    if per_sample.saturating_mul(count as usize) > run.0.len() || count > 1 << 24 {
        return Err("a fragment ends before its samples");
    }
    for i in 0..count {
        let mut field = |bit: u32, default: u32| if flags & bit != 0 { run.u32() } else { Ok(default) };
        let (duration, size) = (field(0x100, defaults.duration)?, field(0x200, defaults.size)?);
        let own = field(0x400, first_flags.filter(|_| i == 0).unwrap_or(defaults.flags))?;
        let shift = field(0x800, 0)? as i32;
        let shown = time.saturating_add(i64::from(shift));
        track.samples.push(Sample { offset: *offset, size, shown, is_sync: own & 0x1_0000 == 0 });
        *offset = offset.checked_add(u64::from(size)).ok_or("a sample's position is absurd")?;
        *time = time.checked_add(i64::from(duration)).ok_or("a sample's time is absurd")?;
    }
    Ok(())
}
