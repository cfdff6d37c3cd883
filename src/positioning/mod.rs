//! Estimation: pure, synchronous, deterministic. Same input, same bits.
