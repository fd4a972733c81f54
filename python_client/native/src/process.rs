//! The threads that all environments of this process share.

use parking_lot::Mutex;
use pyo3::prelude::*;
use sandgait::pool::Pool;
use std::sync::Arc;

/// A pool with the process that it belongs to and its requested number of threads; 0: one for each processor.
struct Owned {
    process: u32,
    threads: usize,
    pool: Arc<Pool>,
}

/// Threads take this lock only for short times and while they hold Python's lock. A fork also holds Python's lock, so in a
/// child process this lock is free.
static POOL: Mutex<Option<Owned>> = Mutex::new(None);

/// This process's pool; `threads` matters only if it is made now.
pub fn pool(_py: Python<'_>, threads: usize) -> Arc<Pool> {
    let mut pool = POOL.lock();
    let process = std::process::id();
    match &*pool {
        Some(owned) if owned.process == process => owned.pool.clone(),
        _ => {
            let new = Owned { process, threads, pool: Arc::new(Pool::new(threads)) };
            let ours = new.pool.clone();
            // The parent's threads do not exist here, and dropping its pool would wait for them.
            std::mem::forget(pool.replace(new));
            ours
        }
    }
}

/// Number of threads of this process's pool; None: there is no pool yet.
#[pyfunction]
pub fn threads(_py: Python<'_>) -> Option<usize> {
    let pool = POOL.lock();
    pool.as_ref().filter(|owned| owned.process == std::process::id()).map(|owned| owned.threads)
}
