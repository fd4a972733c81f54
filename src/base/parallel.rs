//! The number of processors, and work on many items spread over them.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, OnceLock, PoisonError};
use std::thread;

/// Threads of all [`map`]s that run now, besides their callers.
static HELPERS: AtomicUsize = AtomicUsize::new(0);

/// Number of processors that this process may use; 1 if the system does not report it.
pub fn processors() -> usize {
    // Linux reads several files for the answer.
    static COUNT: OnceLock<usize> = OnceLock::new();
    *COUNT.get_or_init(|| thread::available_parallelism().map_or(1, usize::from))
}

/// Threads that help one [`map`], until it ends or panics.
struct Helpers(usize);

impl Helpers {
    /// At most `wanted`, and fewer if other maps have taken the processors.
    fn take(wanted: usize) -> Self {
        let most = processors() - 1;
        let mut taken = 0;
        let add = |now: usize| {
            taken = wanted.min(most.saturating_sub(now));
            Some(now + taken)
        };
        // `add` never returns None.
        let _ = HELPERS.fetch_update(Ordering::Relaxed, Ordering::Relaxed, add);
        Self(taken)
    }
}

impl Drop for Helpers {
    fn drop(&mut self) {
        HELPERS.fetch_sub(self.0, Ordering::Relaxed);
    }
}

/// Applies `f` to every item; the results have the items' order. The caller's thread works, too; others help while
/// processors are free. So a map within a map starts no threads that would only wait for each other.
pub fn map<T: Sync, R: Send>(items: &[T], f: impl Fn(&T) -> R + Sync) -> Vec<R> {
    let results: Vec<Mutex<Option<R>>> = items.iter().map(|_| Mutex::new(None)).collect();
    each(items.len(), &|k| {
        let made = f(&items[k]);
        *results[k].lock().unwrap_or_else(PoisonError::into_inner) = Some(made);
    });
    results.into_iter().filter_map(|made| made.into_inner().unwrap_or_else(PoisonError::into_inner)).collect()
}

/// Works on each index below `count`. This is not generic, so that the threads are compiled once and not for each map.
fn each(count: usize, work: &(dyn Fn(usize) + Sync)) {
    let helpers = Helpers::take(count.saturating_sub(1));
    let next = AtomicUsize::new(0);
    let all = || {
        loop {
            let index = next.fetch_add(1, Ordering::Relaxed);
            if index >= count {
                return;
            }
            work(index);
        }
    };
    thread::scope(|scope| {
        let handles: Vec<_> = (0..helpers.0).map(|_| scope.spawn(all)).collect();
        all();
        // A panic in the work is passed on to the caller.
        handles.into_iter().for_each(|h| h.join().unwrap_or_else(|e| std::panic::resume_unwind(e)));
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_are_in_order_and_threads_are_given_back() {
        let items: Vec<usize> = (0..100).collect();
        let inner = |i: &usize| map(&items, |j| i * j).iter().sum::<usize>();
        let expected: Vec<usize> = items.iter().map(|i| i * 4950).collect();
        assert_eq!(map(&items, inner), expected);
        let panicked = std::panic::catch_unwind(|| map(&items, |i| assert_ne!(*i, 57, "on purpose")));
        assert!(panicked.is_err());
        assert_eq!(HELPERS.load(Ordering::Relaxed), 0);
    }
}
