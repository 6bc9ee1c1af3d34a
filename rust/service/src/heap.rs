//! The heap of a service's process.

/// Lets all threads of the process share one heap, unless `MALLOC_ARENA_MAX` states how many there are.
///
/// glibc gives its threads up to eight heaps a core, and what is freed in one of them serves no other. A message is allocated
/// by a thread that receives and freed by one that computes, so that the process of a service with 32 vehicles grew from 64
/// to 74 MB within 280 000 requests, and kept growing; with one heap it stays at 66 MB. Other libraries of C are left as
/// they are.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
#[allow(unsafe_code)]
pub(crate) fn share_one() {
    if std::env::var_os("MALLOC_ARENA_MAX").is_none() {
        // SAFETY: `mallopt` may be called at any time; this parameter only bounds the number of heaps.
        unsafe { libc::mallopt(libc::M_ARENA_MAX, 1) };
    }
}

/// Does nothing: only glibc has a heap for each thread.
#[cfg(not(all(target_os = "linux", target_env = "gnu")))]
pub(crate) fn share_one() {}
