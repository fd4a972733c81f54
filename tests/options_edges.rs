//! The least and the greatest value of every option of every task, as the tables of options state them: what is made
//! can be stepped, gives finite numbers, and can be saved and restored as a restarted server does it.

use sandgait::env::options::OptionRow;
use sandgait::env::registry::{Blueprint, TASK_IDS};
use sandgait::pool::{Batch, Pool, Seal, Snapshot};
use sandgait::sim::engine::EngineKind;
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;

/// A number whose reciprocal is infinite.
const TINY: f64 = 1e-310;

/// The keys that lead to a number of an option, and the number's bounds.
struct EdgePath {
    keys: Vec<&'static str>,
    bounds: [f64; 2],
}

fn paths(before: &[&'static str], row: &OptionRow, all: &mut Vec<EdgePath>) {
    let keys = [before, &[row.name]].concat();
    row.keys.iter().for_each(|key| paths(&keys, key, all));
    all.extend(row.bounds.map(|bounds| EdgePath { keys, bounds }));
}

/// All options of a task with bounds, by the names of the option and of its last key: options that differ only in
/// between, such as the delays of all sensors, are set together.
fn edges(blueprint: &Blueprint) -> BTreeMap<(&'static str, &'static str), Vec<EdgePath>> {
    let mut all = Vec::new();
    for option in blueprint.keywords() {
        let (at_reset, help) = (option.at_reset, option.help);
        paths(
            &[],
            &OptionRow { name: option.name, help, at_reset, bounds: option.bounds, is_range: false, keys: option.keys },
            &mut all,
        );
    }
    let mut groups: BTreeMap<_, Vec<_>> = BTreeMap::new();
    all.into_iter()
        .for_each(|path| groups.entry((path.keys[0], path.keys[path.keys.len() - 1])).or_default().push(path));
    groups
}

/// `value` at the end of the keys, and the options that the task needs with it.
fn options(paths: &[EdgePath], value: &Value) -> Value {
    let mut all = Map::new();
    for EdgePath { keys, .. } in paths {
        let (last, between) = keys.split_last().unwrap();
        let mut at = &mut all;
        for key in between {
            at = at.entry(*key).or_insert_with(|| json!({})).as_object_mut().unwrap();
        }
        at.insert((*last).into(), value.clone());
    }
    Value::Object(all)
}

/// The forms that a number can have: alone, as a whole number, as a range, a vector, or by names.
fn forms(x: f64) -> Vec<Value> {
    let mut all = vec![json!(x), json!([x, x]), json!([x, x, x]), json!({".*": x})];
    if x.fract() == 0.0 && x.abs() < 1e9 {
        all.push(json!(x as i64));
    }
    all
}

fn step(pool: &Pool, batch: Batch) -> Batch {
    let operation = batch.step(vec![0.5; batch.envs() * batch.spec().action.len()]).unwrap();
    pool.wait(batch, operation).unwrap()
}

fn rows(batch: &Batch) -> Vec<f32> {
    let all = batch.shards().iter().map(|shard| &shard.rows);
    all.flat_map(|rows| [&rows.observations, &rows.rewards, &rows.infos, &rows.final_observations])
        .flatten()
        .copied()
        .collect()
}

/// Makes, steps, saves and restores; the error of the making.
fn live(pool: &Pool, id: &str, options: &Value) -> Result<(), String> {
    let blueprint = Blueprint::new(id, options.clone()).map_err(|e| e.to_string())?;
    let mut batch = Batch::new(&blueprint, 2).map_err(|e| e.to_string())?;
    let reset = batch.reset(None, Some(vec![3, 4]), Default::default()).unwrap();
    batch = pool.wait(batch, reset).unwrap();
    let finite =
        |batch: &Batch| assert!(rows(batch).iter().all(|x| x.is_finite()), "{id} {options}: {:?}", rows(batch));
    for _ in 0..3 {
        finite(&batch);
        batch = step(pool, batch);
    }
    finite(&batch);
    // What a server writes to its disk, and what another one reads.
    let mut keywords = Vec::new();
    let all = blueprint.keywords().into_iter().map(|k| (k.name.to_owned(), k.value)).collect();
    ciborium::into_writer(&Value::Object(all), &mut keywords).unwrap();
    let saved = batch.save().unwrap().to_bytes(&Seal::default()).unwrap();
    let keywords: Value = ciborium::from_reader(&keywords[..]).unwrap();
    let again = Blueprint::new(id, keywords).unwrap_or_else(|e| panic!("{id} {options}: its options: {e}"));
    let mut restored = Batch::new(&again, 2).unwrap();
    let snapshot = Snapshot::from_bytes(&saved, &Seal::default()).unwrap();
    let restore = restored.restore(snapshot, None).unwrap_or_else(|e| panic!("{id} {options}: {e}"));
    restored = step(pool, pool.wait(restored, restore).unwrap());
    batch = step(pool, batch);
    let [own, other] = [&batch, &restored].map(|b| rows(b).iter().map(|x| x.to_bits()).collect::<Vec<_>>());
    assert_eq!(own, other, "{id} {options}");
    Ok(())
}

/// Can the dictionary that has this key be given? A sensor that a task neither observes nor can add cannot.
fn is_usable(id: &str, EdgePath { keys, .. }: &EdgePath) -> bool {
    let parent = EdgePath { keys: keys[..keys.len() - 1].to_vec(), bounds: [0.0; 2] };
    keys.len() < 3 || Blueprint::new(id, options(&[parent], &json!({}))).is_ok()
}

/// Tries all forms of `x`; the reasons why none of them can be made.
fn tried(pool: &Pool, id: &str, paths: &[EdgePath], x: f64) -> Option<Vec<String>> {
    let mut reasons = Vec::new();
    for form in forms(x) {
        match live(pool, id, &options(paths, &form)) {
            Ok(()) => return None,
            Err(reason) => reasons.push(reason),
        }
    }
    Some(reasons)
}

#[test]
fn what_options_allow_can_be_saved_and_restored() {
    let pool = Pool::new(1);
    for id in TASK_IDS {
        let plain = Blueprint::new(id, Value::Null).unwrap();
        let (mut all, mut refused) = (0, Vec::new());
        for ((option, key), mut paths) in edges(&plain) {
            // A carriage moves joints by their speeds, so it has no motors.
            if option == "actuator" && plain.engine == EngineKind::Carriage {
                continue;
            }
            paths.retain(|path| is_usable(id, path));
            let Some(EdgePath { bounds: [low, high], .. }) = paths.first() else { continue };
            all += 1;
            let reasons: Vec<_> =
                [*low, *high].into_iter().filter_map(|x| Some((x, tried(&pool, id, &paths, x)?))).collect();
            for (x, said) in &reasons {
                let own = [format!("{key}: {x} is outside"), format!("{key}[0]: {x} is outside")];
                let is_own = |line: &String| own.iter().any(|o| line.contains(o));
                assert!(!said.iter().any(is_own), "{id} {option} {key}: {said:?}");
            }
            if reasons.len() == 2 {
                refused.push(format!("{option} {key}: {:?}", reasons[0].1));
            }
            if (*low..=*high).contains(&TINY) {
                // It is refused, or gives finite numbers.
                tried(&pool, id, &paths, TINY);
            }
        }
        println!("{id}: {all} options; neither end alone: {refused:#?}");
        assert!(all >= 15 && 8 * refused.len() <= all, "{id}: {all} options; neither end alone: {refused:#?}");
    }
}
