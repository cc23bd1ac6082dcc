//! Nodes FrameLoader and FlameTracker.
