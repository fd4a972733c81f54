//! Threads that compute the phases of a training. A phase has a number of items, and each free thread takes the next
//! item.
//!
//! No phase waits for a thread that has no item: if other programs use some processors, the running threads take
//! all items. The result of an item must not depend on the thread that computes it; then the number of threads has
//! no effect.

use parking_lot::{Condvar, Mutex};
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};

/// Number of times that a thread looks for work before it sleeps: our choice, some 20 µs, about the time between two
/// phases.
const LOOKS: usize = 2_000;

/// Computes an item of a phase.
type PhaseWork<'a, P> = &'a (dyn Fn(P, usize) + Sync);

struct CrewOrder<P> {
    /// Counts phases from 1.
    number: u32,
    phase: Option<P>,
    items: usize,
    over: bool,
}

/// The crew's leader: its thread starts the phases and works on them too.
pub struct WorkCrew<'a, P> {
    order: Mutex<CrewOrder<P>>,
    changed: Condvar,
    /// Number of the phase in the upper half, next item in the lower.
    next: AtomicU64,
    done: AtomicUsize,
    panicked: AtomicBool,
    work: PhaseWork<'a, P>,
}

/// Calls `lead`, which starts phases on `threads` threads, its own included.
pub fn with<P: Copy + Send, R>(threads: usize, work: PhaseWork<'_, P>, lead: impl FnOnce(&WorkCrew<'_, P>) -> R) -> R {
    let crew = WorkCrew {
        order: Mutex::new(CrewOrder { number: 0, phase: None, items: 0, over: false }),
        changed: Condvar::new(),
        next: AtomicU64::new(0),
        done: AtomicUsize::new(0),
        panicked: AtomicBool::new(false),
        work,
    };
    std::thread::scope(|scope| {
        for _ in 1..threads {
            scope.spawn(|| crew.serve());
        }
        let outcome = catch_unwind(AssertUnwindSafe(|| lead(&crew)));
        crew.order.lock().over = true;
        crew.next.store(u64::MAX, Ordering::Release);
        crew.changed.notify_all();
        outcome.unwrap_or_else(|panic| resume_unwind(panic))
    })
}

impl<P: Copy + Send> WorkCrew<'_, P> {
    /// Runs `items` items of `phase`; returns when all are done.
    pub fn run(&self, phase: P, items: usize) {
        let number = {
            let mut order = self.order.lock();
            order.number = order.number.wrapping_add(1) & 0x7fff_ffff;
            (order.phase, order.items) = (Some(phase), items);
            self.done.store(0, Ordering::Relaxed);
            self.next.store(u64::from(order.number) << 32, Ordering::Release);
            order.number
        };
        if items > 1 {
            self.changed.notify_all();
        }
        self.carry_out(number, phase, items);
        let mut looks = 0;
        while self.done.load(Ordering::Acquire) < items {
            looks += 1;
            if looks < LOOKS { std::hint::spin_loop() } else { std::thread::yield_now() }
        }
        assert!(!self.panicked.load(Ordering::Relaxed), "a thread of the training failed");
    }

    fn carry_out(&self, number: u32, phase: P, items: usize) {
        while let Some(item) = self.claim(number, items) {
            if catch_unwind(AssertUnwindSafe(|| (self.work)(phase, item))).is_err() {
                self.panicked.store(true, Ordering::Relaxed);
            }
            self.done.fetch_add(1, Ordering::Release);
        }
    }

    /// The next free item of phase `number`; None if the phase is over.
    fn claim(&self, number: u32, items: usize) -> Option<usize> {
        let mut seen = self.next.load(Ordering::Acquire);
        loop {
            let item = (seen & u64::from(u32::MAX)) as usize;
            if seen >> 32 != u64::from(number) || item >= items {
                return None;
            }
            match self.next.compare_exchange_weak(seen, seen + 1, Ordering::AcqRel, Ordering::Acquire) {
                Ok(_) => return Some(item),
                Err(now) => seen = now,
            }
        }
    }

    /// Works on phases until the leader ends.
    fn serve(&self) {
        let mut last = 0;
        loop {
            for _ in 0..LOOKS {
                if self.next.load(Ordering::Acquire) >> 32 != u64::from(last) {
                    break;
                }
                std::hint::spin_loop();
            }
            let mut order = self.order.lock();
            while order.number == last && !order.over {
                self.changed.wait(&mut order);
            }
            if order.over {
                return;
            }
            last = order.number;
            let (phase, items) = (order.phase, order.items);
            drop(order);
            if let Some(phase) = phase {
                self.carry_out(last, phase, items);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every item of every phase is computed once, for any number of threads.
    #[test]
    fn each_item_once() {
        for threads in [1, 2, 5] {
            let counts: Vec<AtomicUsize> = (0..64).map(|_| AtomicUsize::new(0)).collect();
            let work = |phase: usize, item: usize| {
                assert!(item <= phase);
                counts[item].fetch_add(1, Ordering::Relaxed);
            };
            with(threads, &work, |crew| {
                for round in 0..500 {
                    crew.run(round % 64, round % 64 + 1);
                }
            });
            let expected = (0..64).map(|item| (0..500).filter(|round| round % 64 >= item).count());
            assert!(counts.iter().map(|c| c.load(Ordering::Relaxed)).eq(expected));
        }
    }

    /// A panic in the work ends the training, and no thread waits for ever.
    #[test]
    fn a_panic_is_passed_on() {
        let work = |_: (), item: usize| assert!(item != 3, "on purpose");
        let outcome = catch_unwind(AssertUnwindSafe(|| with(2, &work, |crew| crew.run((), 8))));
        assert!(outcome.is_err());
    }
}
