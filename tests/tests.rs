//! The integration tests of the house, in modules by intent.
