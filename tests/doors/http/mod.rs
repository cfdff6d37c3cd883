//! The REST door, one file per resource.

mod bases;
pub(crate) mod navigation;
mod pages;
mod positioning;
mod sessions;
mod solutions;
