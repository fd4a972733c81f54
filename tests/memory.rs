//! The memory that is reserved for environments is the memory that they take, counted by the allocator.

use sandgait::env::registry::{Blueprint, TASK_IDS};
use sandgait::pool::{Batch, Pool};
use sandgait::sim::engine::EngineKind;
use serde_json::Value;
use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering};

static USED: AtomicUsize = AtomicUsize::new(0);

struct Counting;

#[global_allocator]
static ALLOCATOR: Counting = Counting;

// SAFETY: the calls are passed on unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        USED.fetch_add(layout.size(), Ordering::Relaxed);
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, address: *mut u8, layout: Layout) {
        USED.fetch_sub(layout.size(), Ordering::Relaxed);
        unsafe { System.dealloc(address, layout) }
    }
}

/// Memory of `envs` environments after some steps [bytes].
fn used(blueprint: &Blueprint, envs: usize, pool: &Pool) -> usize {
    let before = USED.load(Ordering::Relaxed);
    let mut batch = Batch::new(blueprint, envs).unwrap();
    let reset = batch.reset(None, Some((0..envs as u64).collect()), Default::default()).unwrap();
    batch = pool.wait(batch, reset).unwrap();
    for _ in 0..3 {
        let width = batch.spec().action.len();
        let step = batch.step(vec![0.5; envs * width]).unwrap();
        batch = pool.wait(batch, step).unwrap();
    }
    let used = USED.load(Ordering::Relaxed) - before;
    drop(batch);
    used
}

/// At least the memory that is used, and not so much that few sessions fit: our choice, a factor of 6, because an
/// episode may have more patches, rocks or commands than these.
#[test]
fn what_is_reserved_is_what_is_used() {
    let pool = Pool::new(1);
    for task in TASK_IDS {
        let blueprint = Blueprint::new(task, Value::Null).unwrap();
        // Its constant is for resident memory, and this test counts what is allocated, used or not.
        if blueprint.engine == EngineKind::Rapier {
            continue;
        }
        let envs = 64;
        let (reserved, used) = (blueprint.bytes(envs), used(&blueprint, envs, &pool));
        println!("{task}: {} bytes an environment reserved, {} used", reserved / envs, used / envs);
        assert!(reserved >= used, "{task}: {reserved} {used}");
        assert!(reserved <= 6 * used, "{task}: {reserved} {used}");
    }
}
