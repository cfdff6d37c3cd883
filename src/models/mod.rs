//! Physics: ephemeris and time to satellite state, atmosphere, group delays, geometry.
