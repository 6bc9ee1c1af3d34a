//! How many connections and files the process may have.

/// Raises the limit of open descriptors to the largest that this process may have, which is not the usual one. Each connection
/// takes a descriptor, also that of a stranger before its handshake ends, and without free ones zenoh neither accepts a
/// connection nor ends those that wait.
pub(crate) fn allow_all() {
    match rlimit::increase_nofile_limit(u64::MAX) {
        Ok(limit) => tracing::debug!(limit, "open descriptors"),
        Err(error) => tracing::warn!(%error, "the limit of open descriptors stays as it was"),
    }
}
