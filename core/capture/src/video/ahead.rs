//! Decoding while the frames before are being worked on.

use std::ops::ControlFlow;
use std::sync::mpsc::sync_channel;

use super::{FrameSource, TimedFrame, Video, VideoError};

/// Frames decoded before they are asked for.
const FRAMES_AHEAD: usize = 4;

/// Calls `each` with every frame in order until it breaks, while a thread decodes the frames after it. Returns what was
/// doubtful in the video and read all the same, a line each.
///
/// # Errors
/// When the video is damaged, or `each` fails.
pub fn for_each_frame<E: From<VideoError>>(
    mut video: Video,
    mut each: impl FnMut(TimedFrame) -> Result<ControlFlow<()>, E>,
) -> Result<Vec<String>, E> {
    std::thread::scope(|scope| {
        let (sender, frames) = sync_channel(FRAMES_AHEAD);
        let reader = scope.spawn(move || {
            // Ends at the last frame, at an error, or when the reader has hung up.
            while let Some(next) = video.next_frame().transpose() {
                let failed = next.is_err();
                if sender.send(next).is_err() || failed {
                    break;
                }
            }
            video.warnings()
        });
        for frame in &frames {
            if each(frame?)?.is_break() {
                break;
            }
        }
        drop(frames);
        Ok(reader.join().unwrap_or_default())
    })
}
