//! Plugins as strangers meet them: the command, real libraries in Rust and C, and a library that misbehaves in every way.

mod examples;
mod faults;
mod libraries;
