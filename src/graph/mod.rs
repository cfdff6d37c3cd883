//! Least squares on factor graphs; knows nothing of what its variables mean.
