//! What a decoder network is fed: face boxes, crops, area resizing, normalisation and chunks, as rPPG-Toolbox does them.
//!
//! Frames are 8-bit sRGB, row-major, RGB interleaved, `frames × height × width × 3`; boxes are in pixels of the frame.
//! Every step has a golden (`preprocess/`), and every step is a pure function: equal frames give equal numbers at any
//! thread count. Sums over pixels are f64 (a float32 sum of a clip is wrong in the third digit).

mod face_box;
mod normalise;
mod resize;

pub use face_box::{FaceBox, FollowedBox, HAAR_ENLARGEMENT};
pub use normalise::{Scaling, chunk_count, label_difference, label_standardised, normalised, resampled_to_frames};
pub use resize::{Pixels, resize_area};
