//! The one row of `committer`: the lease of the database, and the counter that a probe raises.

/// Changes a row, so that a probe needs the same as a commit: a lock, and space on the disk.
pub(super) const PROBE: &str = "UPDATE committer SET probes = probes + 1";
/// Gives the lease its next number, for a node.
pub(super) const NEXT_FENCE: &str =
    "UPDATE committer SET node = $1, fence = fence + 1 RETURNING fence";
/// The node that has the lease or had it last, and the number of its lease.
pub(super) const OWNER: &str = "SELECT node, fence FROM committer";
