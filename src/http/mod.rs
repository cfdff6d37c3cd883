//! Door: REST.
