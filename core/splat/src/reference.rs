//! The naive f64 texts: the specification that the fast kernels are held against. No cleverness, no threads.

pub mod harmonics;
