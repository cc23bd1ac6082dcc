//! Nodes HrEstimator and BenchmarkDecoder. May not depend on heartian-pulse.
