//! The memory that is reserved for environments is what they take, also for the most expensive robots that a client may
//! send.

#[path = "testbed/robots.rs"]
mod robots;

use robots::{long_chain, many_shapes, robot, shape};
use sandgait::env::registry::{Blueprint, TASK_IDS};
use sandgait::env::shard::Shard;
use sandgait::sim::engine::EngineKind;
use serde_json::{Value, json};
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

const ID: &str = "sandgait/LeggedVelocity-v1";

/// Counts the bytes that this thread has in use.
struct Counted;

thread_local! {
    static NOW: Cell<isize> = const { Cell::new(0) };
}

// SAFETY: every call is passed on to the system's allocator.
unsafe impl GlobalAlloc for Counted {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        NOW.set(NOW.get() + layout.size() as isize);
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, at: *mut u8, layout: Layout) {
        NOW.set(NOW.get() - layout.size() as isize);
        unsafe { System.dealloc(at, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counted = Counted;

/// Bytes that `envs` environments take after some episodes, and that are reserved for them.
fn taken(task: &str, options: &Value, envs: usize) -> [usize; 2] {
    let before = NOW.get();
    let blueprint = Blueprint::new(task, options.clone()).unwrap();
    let mut shards: Vec<Shard> = (0..envs / 16).map(|_| Shard::new(&blueprint, 16).unwrap()).collect();
    for shard in &mut shards {
        for seed in 0..3 {
            shard.reset(|_| true, Some(&[seed; 16]), |_| None);
            shard.step(&vec![0.5; 16 * shard.actions()]);
        }
    }
    [(NOW.get() - before) as usize, blueprint.bytes(envs)]
}

#[test]
fn environments_take_what_is_reserved() {
    let many = |count: usize| robot(|r| r["bodies"][0]["shapes"] = (0..count).map(|_| shape("s")).collect());
    // All points are at the end of the first leg, so that the robot stands on all of them.
    let point = json!([0.0, 0.0, -0.18, 0.022, 1.0, 0.0, 0.0, 0.0]);
    let points = |count: usize| robot(|r| r["bodies"][3]["contacts"] = (0..count).map(|_| point.clone()).collect());
    let long =
        |r: &mut Value| r["bodies"].as_array_mut().unwrap().iter_mut().for_each(|b| b["name"] = "n".repeat(200).into());
    for (what, options) in [
        ("sandcat on rigid ground", json!({"ground": "rigid"})),
        ("sandcat on sand", json!({"ground": "poppy-close"})),
        ("sandcat on both", json!({"ground": "mixed"})),
        ("sandcat on any ground", json!({"ground": "any"})),
        ("sandcat on dunes", json!({"ground": "dunes", "measure_heights": true})),
        ("1,000 shapes", json!({"robot": many(1_000), "ground": "rigid"})),
        ("5,000 points", json!({"robot": points(5_000), "ground": "rigid"})),
        ("sandcat on sand that remembers", json!({"memory": true})),
        ("long names", json!({"robot": robot(long), "ground": "rigid"})),
    ] {
        for envs in [16, 208] {
            let [took, reserved] = taken(ID, &options, envs);
            println!("{what}: {envs} environments take {} KiB of {} KiB", took >> 10, reserved >> 10);
            // The reservation includes the copy of each episode that a rollout or a restore makes; this test makes no
            // such copy.
            assert!(took <= reserved, "{what}: {envs} environments took {took} of {reserved} bytes");
            assert!(reserved < 5 * took, "{what}: {reserved} bytes are reserved for {took}");
        }
    }
}

/// At least the used memory is reserved, and at most 6 times as much, so that not too few sessions fit. The factor is
/// our choice, because an episode may have more patches, rocks or commands than the episodes here.
#[test]
fn every_task_takes_what_is_reserved() {
    for task in TASK_IDS {
        // For rapier the resident memory is reserved, and this test counts all allocated memory, used or not.
        if Blueprint::new(task, Value::Null).unwrap().engine == EngineKind::Rapier {
            continue;
        }
        let [used, reserved] = taken(task, &Value::Null, 64);
        println!("{task}: {reserved} bytes are reserved for {used}");
        assert!(reserved >= used, "{task}: {reserved} {used}");
        assert!(reserved <= 6 * used, "{task}: {reserved} {used}");
    }
}

/// Each list of a packed robot is bounded, whatever the other lists are.
#[test]
fn no_list_of_a_packed_robot_is_free() {
    let refused = |change: &dyn Fn(&mut Value)| {
        let options = json!({"robot": robot(change), "ground": "rigid"});
        let error = Blueprint::new(ID, options).err().expect("it is refused").to_string();
        assert!(!error.contains('\n') && error.len() < 300, "{error}");
        error
    };
    assert!(refused(&many_shapes).contains("number of shapes: 40016 is outside [0, 4096]"));
    let look = json!({"body": 0, "at": [0, 0, 0, 1, 0, 0, 0], "form": {"mesh": 0}});
    let looks = |r: &mut Value| {
        r["looks"] = json!({"meshes": [{"corners": [], "faces": []}], "shapes": vec![look.clone(); 50_000]});
    };
    assert!(refused(&looks).contains("shapes in looks: 50000 is outside"));
    let corners = |r: &mut Value| {
        r["looks"] = json!({"meshes": [{"corners": vec![[0, 0, 0]; 100_000], "faces": []}], "shapes": []});
    };
    assert!(refused(&corners).contains("corners of meshes in looks: 100000 is outside"));
    let meshes = |r: &mut Value| {
        r["looks"] = json!({"meshes": vec![json!({"corners": [], "faces": []}); 100_000], "shapes": []});
    };
    assert!(refused(&meshes).contains("meshes in looks: 100000 is outside"));
    for place in ["/name", "/bodies/3/name", "/bodies/3/joint/name", "/bodies/0/shapes/0/name"] {
        let long = |r: &mut Value| *r.pointer_mut(place).unwrap() = "x".repeat(10_000).into();
        assert!(refused(&long).contains("length of a name: 10000 is outside [0, 200]"), "{place}");
    }
}

/// A chain of bodies with many feet: the search for its stance takes a bounded time. No leg of this robot reaches below the base.
#[test]
fn a_long_chain_stands_up_in_time() {
    let robot = robot(long_chain);
    let start = std::time::Instant::now();
    let made = Blueprint::new(ID, json!({"robot": robot, "ground": "rigid"}));
    assert!(made.err().is_some_and(|e| e.to_string().contains("has no legs")));
    assert!(start.elapsed().as_secs() < 10, "{:?}", start.elapsed());
    println!("a chain of 128 joints with 127 feet: {:?}", start.elapsed());
}
