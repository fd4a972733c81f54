//! The dearest value of every option of every task takes what is reserved for it. The options are those of the tasks'
//! tables, so this test covers an option that is added later.

#[path = "testbed/counted.rs"]
mod counted;

use counted::in_use;
use sandgait::env::registry::{Blueprint, Keyword, TASK_IDS};
use sandgait::env::shard::Shard;
use sandgait::env::{ResetOptions, options::OptionRow};
use sandgait::pool::{Batch, Pool};
use sandgait::sim::resident;
use serde_json::{Map, Value, json};

/// The allocator counts what all threads have in use.
static ALONE: std::sync::Mutex<()> = std::sync::Mutex::new(());

/// Environments, and tasks with options of their own.
const ENVS: usize = 48;
const TASKS: usize = 24;

/// What is dear [bytes]: must be reserved within the two bounds of what is allocated after resets. In the course of an
/// episode more is allocated, twice as much by engine rapier, and resident memory is larger: see
/// `tests/faults/environments.rs`.
const DEAR: usize = 3 << 20;
const WITHIN: [f64; 2] = [0.8, 3.0];

/// Values that may make an option of this present value dear: the largest and smallest numbers, long lists and texts.
/// Those that the option does not accept are left out.
fn probes(present: &Value, keys: &[OptionRow]) -> Vec<Value> {
    let mut all = match present {
        Value::Bool(_) => vec![json!(true), json!(false)],
        Value::Number(_) => [0.0, 1.0, 64.0, 1e3, 1e6, 1e-3, 1e-6].iter().map(|x| whole(*x)).collect(),
        Value::Array(_) => vec![json!([1.0, 1.0]), json!([0.5, 0.5]), json!([0.0, 0.0])],
        _ => Vec::new(),
    };
    let text = "a long comment, twenty thousand bytes of it; ".repeat(450);
    let names = ["lanes", "rapier", "C", "mixed", "dunes", "any", "rigid", "xplorer18", "torque", "agarwal2023"];
    all.extend(names.map(Value::from));
    all.extend([
        json!(format!("medium = \"poppy-close\"\nlaw = \"li2013\"\n# {text}")),
        json!(format!("source = {text:?}")),
    ]);
    all.extend([json!(format!("# {text}\n"))]);
    // Patterns of joints' names.
    all.push((1..200).map(|k| ("*".repeat(k), json!(0.1))).collect::<Map<_, _>>().into());
    all.extend([json!(vec!["joint_torque"; 1000]), json!(vec![vec![0.01; 128]; 128])]);
    if !keys.is_empty() {
        let empty = |row: &OptionRow| (row.name.to_owned(), json!({}));
        all.extend([json!({}), keys.iter().map(empty).collect::<Map<_, _>>().into()]);
    }
    all.push(Value::Null);
    all
}

/// A number as a user writes it.
fn whole(x: f64) -> Value {
    if x.fract() == 0.0 { json!(x as u64) } else { json!(x) }
}

/// An option as a dictionary that sets it, with what a value of it is.
struct Place {
    path: Vec<&'static str>,
    present: Value,
    keys: Vec<OptionRow>,
    at_reset: bool,
}

impl Place {
    fn with(&self, value: Value) -> Value {
        self.path.iter().rev().fold(value, |inside, name| json!({ *name: inside }))
    }
}

/// All options of a task, down to the keys of dictionaries.
fn places(blueprint: &Blueprint) -> Vec<Place> {
    fn add(all: &mut Vec<Place>, path: &[&'static str], row: OptionRow, present: &Value) {
        let path = [path, &[row.name]].concat();
        for key in &row.keys {
            add(all, &path, key.clone(), present.get(key.name).unwrap_or(&Value::Null));
        }
        all.push(Place { path, present: present.clone(), keys: row.keys, at_reset: row.at_reset });
    }
    let mut all = Vec::new();
    for Keyword { name, help, value, at_reset, keys, .. } in blueprint.keywords() {
        add(&mut all, &[], OptionRow { name, help, at_reset, bounds: None, is_range: false, keys }, &value);
    }
    all
}

/// Memory that environments with these options take after episodes that ended, while copies of them are kept, and what is
/// reserved for them; None if the task refuses the options.
fn environments(task: &str, options: &Value) -> Option<[usize; 2]> {
    let before = in_use();
    let blueprint = Blueprint::new(task, options.clone()).ok()?;
    let size = blueprint.engine.shard_size();
    let mut shards: Vec<Shard> = (0..ENVS / size).map(|_| Shard::new(&blueprint, size).ok()).collect::<Option<_>>()?;
    for shard in &mut shards {
        let seeds: Vec<u64> = (0..size as u64).collect();
        shard.reset(|_| true, Some(&seeds), |_| None);
        shard.reset(|_| true, None, |_| None);
        shard.keep_all();
        shard.reset(|_| true, None, |_| None);
    }
    Some([in_use() - before, blueprint.bytes(ENVS)])
}

/// Memory that the tasks of environments take which have options of their own, and what is reserved for them. None if no
/// reset changes the option, or the task refuses the value.
fn changed(task: &str, place: &Place, value: &Value) -> Option<[usize; 2]> {
    let pool = Pool::new(1);
    let mut batch = Batch::new(&Blueprint::new(task, Value::Null).ok()?, TASKS).ok()?;
    let reset = batch.reset(None, None, ResetOptions::default()).ok()?;
    batch = pool.wait(batch, reset).ok()?;
    let (before, reserved) = (in_use(), batch.bytes());
    for env in 0..TASKS {
        let chosen = (0..TASKS).map(|i| i == env).collect();
        let options = ResetOptions::new(place.with(value.clone())).ok()?;
        let reset = batch.reset(Some(chosen), None, options).ok()?;
        batch = pool.wait(batch, reset).ok()?;
    }
    Some([in_use().saturating_sub(before), batch.bytes() - reserved.min(batch.bytes())])
}

fn check(what: &str, [took, reserved]: [usize; 2], failures: &mut Vec<String>) {
    let ratio = reserved as f64 / took as f64;
    let line = format!("{what}: {} KiB are reserved for {} KiB, {ratio:.2}", reserved >> 10, took >> 10);
    if took.max(reserved) >= DEAR {
        println!("{line}");
        if !(WITHIN[0]..=WITHIN[1]).contains(&ratio) {
            failures.push(line);
        }
    }
}

#[test]
fn the_dearest_value_of_every_option_takes_what_is_reserved() {
    let _alone = ALONE.lock();
    let (mut failures, mut tried, mut accepted) = (Vec::new(), 0, 0);
    for task in TASK_IDS {
        let blueprint = Blueprint::new(task, Value::Null).unwrap();
        let plain = environments(task, &Value::Null).unwrap();
        for place in places(&blueprint) {
            let name = place.path.join(".");
            let mut dearest: Option<([usize; 2], Value)> = None;
            let mut of_resets: Option<([usize; 2], Value)> = None;
            // A part of a dictionary often needs another part.
            let alone = place.path.len() == 1;
            tried += usize::from(alone);
            for value in probes(&place.present, &place.keys) {
                let options = place.with(value.clone());
                if let Some(sizes) = environments(task, &options) {
                    let larger = dearest.as_ref().is_none_or(|(most, _)| sizes[0] > most[0]);
                    dearest = if larger { Some((sizes, value.clone())) } else { dearest };
                }
                if place.at_reset
                    && let Some(sizes) = changed(task, &place, &value)
                {
                    let larger = of_resets.as_ref().is_none_or(|(most, _)| sizes[0] > most[0]);
                    of_resets = if larger { Some((sizes, value)) } else { of_resets };
                }
            }
            let short = |value: &Value| value.to_string().chars().take(40).collect::<String>();
            for (how, found) in [("made", dearest), ("reset", of_resets)] {
                let Some((sizes, value)) = found else { continue };
                accepted += usize::from(alone && how == "made");
                // What the option adds.
                let added = |k: usize| sizes[k].saturating_sub(if how == "made" { plain[k] } else { 0 });
                let sizes = [added(0), added(1)];
                check(&format!("{task} {how} with {name} = {}", short(&value)), sizes, &mut failures);
            }
        }
    }
    println!("{accepted} of {tried} options accepted a value");
    assert!(accepted > tried * 3 / 4, "{accepted} of {tried}");
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

/// Memory that environments take when each has ended an episode and an operation keeps copies of all, when most is in
/// use [bytes each], and what the task says of one without the resident share of the allocator.
fn at_most(task: &str, options: &Value) -> [usize; 2] {
    let blueprint = Blueprint::new(task, options.clone()).unwrap();
    let size = blueprint.engine.shard_size();
    let before = in_use();
    let mut shards: Vec<Shard> = (0..16 / size).map(|_| Shard::new(&blueprint, size).unwrap()).collect();
    for shard in &mut shards {
        shard.reset(|_| true, Some(&(0..size as u64).collect::<Vec<_>>()), |_| None);
        for step in 0..15 {
            let action = |k: usize| ((k * 3 + step) as f32 * 0.37).sin();
            shard.step(&(0..size * shard.actions()).map(action).collect::<Vec<_>>());
            if shard.rows.ended.len() == size {
                break;
            }
        }
        shard.keep_all();
    }
    [(in_use() - before) / 16, blueprint.bytes_per_env()]
}

/// The sizes in `sim/memory.rs` and `env/setup.rs` are those of what is allocated.
#[test]
fn sizes_of_environments_are_what_is_allocated() {
    let _alone = ALONE.lock();
    let short = json!({"max_episode_steps": 12});
    let with = |more: Value| {
        let mut all = short.clone();
        all.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
        all
    };
    let mut wrong = Vec::new();
    for (task, options) in [
        ("HexapodGait-v1", short.clone()),
        ("HexapodLegs-v2", short.clone()),
        ("LeggedVelocity-v1", short.clone()),
        ("LegStroke-v0", json!({})),
        ("HexapodGait-v1", with(json!({"engine": "rapier"}))),
        ("HexapodLegs-v2", with(json!({"engine": "rapier"}))),
        ("HexapodRocks-v1", short.clone()),
        ("HexapodRocks-v1", with(json!({"rocks": {"count": 64}}))),
        ("HexapodGait-v1", with(json!({"history": 64}))),
    ] {
        let [took, said] = at_most(&format!("sandgait/{task}"), &options);
        // The task says resident bytes.
        let said = said as f64 * 1e3 / resident(1000) as f64;
        let ratio = said / took as f64;
        println!("{task} {options}: {took} bytes, the task says {said:.0}, {ratio:.2}");
        if !(0.8..=1.25).contains(&ratio) {
            wrong.push(format!("{task} {options}: {ratio:.2}"));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
