//! RON graphs, typed ports, registry, planner, scheduler and content-addressed cache. Knows no face.
