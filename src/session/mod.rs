//! Desk: where estimation, aiding and storage meet. One task owns one session.
