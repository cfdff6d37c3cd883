//! What goes wrong: crashes, hostile casters, receivers that jump and lose satellites.

mod casters;
mod crash;
mod robustness;
