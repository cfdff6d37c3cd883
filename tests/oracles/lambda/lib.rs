//! The integer least squares of Graphfix alone, compiled from its sources. They name no other
//! module.

#[path = "../../../compute/src/lambda/mod.rs"]
pub mod lambda;
