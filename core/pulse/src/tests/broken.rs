//! Broken input has a defined answer.
