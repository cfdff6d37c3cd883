mod casters;
mod crash;
mod database;
mod disk;
mod forged;
mod lease;
mod robustness;
mod server;
