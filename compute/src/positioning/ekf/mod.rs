//! Extended Kalman filter on the factors of the graph, for comparison with it.
//!
//! State x, 17×1: position p, velocity v, clock b and drift d as in `positioning::factors`, one
//! inter-system bias β for each constellation, and the position and clock of the previous epoch. So
//! phase differences and odometry, which depend on two epochs, are measurements of x.
//!
//! Prediction over Δt, the graph's motion and clock factors solved for the later state:
//!
//! p₊ = p + Δt·v, v₊ = v, covariance of the noise per axis
//! [q²Δt³/3 + (0.02 m)²·Δt, q²Δt²/2; q²Δt²/2, q²Δt]
//!
//! and the same for [b; d] with h²Δt in place of the trapezoid's variance; biases are random walks.
//! Measurements are the graph's whitened rows r with Jacobian J, one after the other: S = J P Jᵀ +
//! R, K = P Jᵀ/S, x ← x − K·r, P ← (I − K J)·P·(I − K J)ᵀ + R·K·Kᵀ (Joseph's form, Bucy & Joseph
//! 1968).
//!
//! The innovation test rejects a row whose r²/S exceeds the chi-square limit of one degree of
//! freedom at `false_alarm_probability`; without `fault_exclusion` there is no test. Rows of one
//! kind enter in the order of their satellites' pseudorange variances, because a sequential test
//! detects faults best if the least suspect rows come first.
//!
//! Sources: Kalman (1960); Brown & Hwang (1997) for the models; Jazwinski (1970), *Stochastic
//! Processes and Filtering Theory*, chapter 8, for the extended filter.

mod filter;
mod gaussian;
mod rows;

pub(super) use filter::KalmanFilter;
