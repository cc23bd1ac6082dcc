//! Head models, linear blend skinning, landmark networks and the head tracker.
