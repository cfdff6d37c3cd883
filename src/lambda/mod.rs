//! Integer least squares; knows nothing of what its integers mean.
