//! The REST door, one file per resource.

pub(crate) mod navigation;
mod pages;
mod positioning;
mod sessions;
mod solutions;
