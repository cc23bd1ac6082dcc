//! Memory kept from one frame to the next: fresh pages cost as much as the kernels that fill them.
//!
//! What always holds: at most [`KEPT`] vectors of at most [`MOST_FLOATS`] floats each wait for their next use; what is in
//! them is whatever the last user left.

use rayon::prelude::*;
use std::mem::MaybeUninit;
use std::ops::{Deref, DerefMut};
use std::sync::Mutex;

/// Vectors that are kept.
const KEPT: usize = 4;
/// Longer ones are given back to the system: 64 MiB.
const MOST_FLOATS: usize = 1 << 24;

static SPARE: Mutex<Vec<Vec<f32>>> = Mutex::new(Vec::new());

/// `length` zeros, written by all threads: what fresh pages cost is shared.
pub(crate) fn zeros<T: Copy + Default + Send>(length: usize) -> Vec<T> {
    let mut values = Vec::with_capacity(length);
    let room = &mut values.spare_capacity_mut()[..length];
    room.par_chunks_mut(1 << 14).for_each(|chunk| chunk.fill(MaybeUninit::new(T::default())));
    // SAFETY: each of the `length` values was written.
    unsafe { values.set_len(length) };
    values
}

/// Some floats; on being dropped they wait for the next that needs as many.
#[derive(Clone, Debug, Default)]
pub(crate) struct Scratch(Vec<f32>);

impl Scratch {
    /// `length` floats of any value.
    pub fn take(length: usize) -> Self {
        let mut floats = Vec::new();
        if let Ok(mut spare) = SPARE.lock() {
            let fitting = spare.iter().enumerate().filter(|(_, floats)| floats.capacity() >= length);
            if let Some((at, _)) = fitting.min_by_key(|(_, floats)| floats.capacity()) {
                floats = spare.swap_remove(at);
            }
        }
        if floats.capacity() < length {
            return Self(vec![0.0; length]);
        }
        floats.resize(length, 0.0);
        Self(floats)
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let floats = std::mem::take(&mut self.0);
        if floats.capacity() == 0 || floats.capacity() > MOST_FLOATS {
            return;
        }
        if let Ok(mut spare) = SPARE.lock() {
            spare.push(floats);
            // The smallest goes first: the next frame needs at least as much as this one.
            if spare.len() > KEPT
                && let Some((at, _)) = spare.iter().enumerate().min_by_key(|(_, floats)| floats.capacity())
            {
                spare.swap_remove(at);
            }
        }
    }
}

impl Deref for Scratch {
    type Target = [f32];
    fn deref(&self) -> &[f32] {
        &self.0
    }
}

impl DerefMut for Scratch {
    fn deref_mut(&mut self) -> &mut [f32] {
        &mut self.0
    }
}
