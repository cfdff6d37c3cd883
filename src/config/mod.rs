//! Configuration: one struct per concern, every value named, explained and echoed back.
