//! A plugin that misbehaves, for the host's tests.
