//! Observations with known truth, from a seed.
