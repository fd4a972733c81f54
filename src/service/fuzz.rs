//! 100,000 malformed messages are refused or carried out, and none causes a panic.

#[path = "../../tests/grpc/mutate.rs"]
mod mutate;

use super::limits::Limits;
use super::proto::run_session_request::Request;
use super::proto::{CreateSessionRequest, PolicyRollout, Reset, Restore, Rollout, RunSessionRequest, SetCommand, Step};
use super::sessions::Sessions;
use super::{decode, fields, values};
use crate::env::Task;
use crate::env::registry::{Blueprint, TASK_IDS};
use crate::env::rocks::HexapodRocks;
use crate::env::stroke::LegStroke;
use crate::pool::{Batch, Operation, Pool, Seal};
use ciborium::Value as Cbor;
use prost::Message as _;
use rand::{Rng as _, SeedableRng as _};
use rand_xoshiro::Xoshiro256PlusPlus;
use serde_json::{Value, json};
use sha2::{Digest as _, Sha256};

/// Environments of a session: our choice, few, so that a case is fast, but more than one.
const ENVS: usize = 3;

/// A policy for the first of [`TASK_IDS`].
const PPO: &[u8] = include_bytes!("../../tests/data/policy_ppo.onnx");

fn options(json: &Value) -> Option<prost_types::Struct> {
    let fields = json.as_object()?.iter().map(|(k, v)| (k.clone(), values::from_json(v))).collect();
    Some(prost_types::Struct { fields })
}

fn floats(count: usize) -> bytes::Bytes {
    (0..count).flat_map(|k| (k as f32 * 0.37).sin().to_le_bytes()).collect()
}

/// A batch in the middle of its episodes.
fn begun(task: &str, pool: &Pool) -> Batch {
    let batch = Batch::new(&Blueprint::new(task, Value::Null).unwrap(), ENVS).unwrap();
    let reset = batch.reset(None, Some(vec![1, 2, 3]), Default::default()).unwrap();
    pool.wait(batch, reset).unwrap()
}

/// One valid request of each kind.
fn requests(batch: &Batch) -> Vec<Vec<u8>> {
    let width = batch.spec().action.len();
    let changes = options(&json!({"leg": "C", "slope_deg": 2.5, "command": [0.1, 0.4], "medium": "poppy-close"}));
    let snapshot = batch.save().unwrap().to_bytes(&Seal::default()).unwrap();
    let all = [
        Request::Reset(Reset { seeds: vec![1, 2, u64::MAX], mask: vec![1, 0, 1].into(), options: None }),
        Request::Reset(Reset { seeds: Vec::new(), mask: bytes::Bytes::new(), options: changes }),
        Request::Step(Step { actions: floats(ENVS * width), held: bytes::Bytes::new() }),
        Request::Step(Step { actions: floats(ENVS * width), held: vec![1, 0, 1].into() }),
        Request::SetCommand(SetCommand { commands: floats(3 * ENVS) }),
        Request::Rollout(Rollout { actions: floats(4 * ENVS * width), trajectories: true }),
        Request::Restore(Restore { snapshot: snapshot.into(), sources: vec![0; 4 * ENVS].into() }),
        Request::PolicyRollout(PolicyRollout { onnx: PPO.into(), steps: 4, trajectories: true }),
    ];
    let message = |request| RunSessionRequest { session_id: "0123".into(), sequence: 7, request: Some(request) };
    all.into_iter().map(|request| message(request).encode_to_vec()).collect()
}

/// A changed snapshot with the right checksum, as somebody who knows the format can make it. The change is either in
/// the bytes or in values of the CBOR.
fn with_checksum(snapshot: &[u8], random: &mut Xoshiro256PlusPlus) -> Option<Vec<u8>> {
    let start = b"sandgait snapshot\n".len();
    let digest = start + 1 + usize::from(*snapshot.get(start)?);
    let (head, body) = (snapshot.get(..digest)?, snapshot.get(digest + 32..)?);
    let body = match random.random_bool(0.8) {
        true => (0..random.random_range(1..3)).fold(body.to_vec(), |body, _| with_another_value(random, &body)),
        false => mutate::mutated(random, body, &[]),
    };
    Some([head, Sha256::digest(&body).as_slice(), &body].concat())
}

/// Changes one value, which may be in CBOR nested in a byte string.
fn with_another_value(random: &mut Xoshiro256PlusPlus, bytes: &[u8]) -> Vec<u8> {
    let Ok(mut value) = ciborium::from_reader::<Cbor, _>(bytes) else { return mutate::mutated(random, bytes, &[]) };
    change(random, &mut value);
    let mut changed = Vec::new();
    ciborium::into_writer(&value, &mut changed).unwrap();
    changed
}

fn change(random: &mut Xoshiro256PlusPlus, value: &mut Cbor) {
    let what = random.random_range(0..40);
    match value {
        Cbor::Map(all) if !all.is_empty() => {
            let k = random.random_range(0..all.len());
            match what {
                0 => drop(all.remove(k)),
                1 => all.push(all[k].clone()),
                2 => all[k].0 = Cbor::Text("other".into()),
                _ => change(random, &mut all[k].1),
            }
        }
        Cbor::Array(all) if !all.is_empty() => {
            let k = random.random_range(0..all.len());
            match what {
                0 => drop(all.remove(k)),
                1 => all.push(all[k].clone()),
                2 => all.extend(vec![all[k].clone(); 300]),
                3 => all.clear(),
                _ => change(random, &mut all[k]),
            }
        }
        Cbor::Bytes(inside) => *inside = with_another_value(random, inside),
        leaf => *leaf = wrong_leaf(random, leaf),
    }
}

fn wrong_leaf(random: &mut Xoshiro256PlusPlus, leaf: &Cbor) -> Cbor {
    let numbers = [f64::NAN, f64::INFINITY, f64::MAX, -1e300, 1e-320, 0.0, -0.0, 1.0, -1.0, 1e3, 1e9, 0.999];
    let counts = [0, 1, 6_000, 100_000, i64::from(u32::MAX), i64::MAX, -1];
    match random.random_range(0..8) {
        0 => Cbor::Null,
        1 => Cbor::Bool(true),
        2 => Cbor::Text("x".repeat(random.random_range(0..300))),
        3 => Cbor::Array(Vec::new()),
        4 => Cbor::Integer(counts[random.random_range(0..counts.len())].into()),
        5 => Cbor::Float(numbers[random.random_range(0..numbers.len())]),
        // Most values are still in range.
        _ => match leaf {
            Cbor::Float(x) => Cbor::Float(x * random.random_range(0.5..2.0)),
            Cbor::Integer(_) => Cbor::Integer(random.random_range(0..100).into()),
            other => other.clone(),
        },
    }
}

/// A request with wrong contents, whose message can still be decoded.
fn spoiled(random: &mut Xoshiro256PlusPlus, mut request: Request) -> Request {
    let mut spoil = |field: &mut bytes::Bytes| *field = mutate::mutated(random, field, &[]).into();
    match &mut request {
        Request::Step(step) if step.held.is_empty() => spoil(&mut step.actions),
        Request::Step(step) => spoil(&mut step.held),
        Request::Rollout(rollout) => spoil(&mut rollout.actions),
        Request::SetCommand(set) => spoil(&mut set.commands),
        Request::PolicyRollout(rollout) => spoil(&mut rollout.onnx),
        Request::Reset(reset) => {
            spoil(&mut reset.mask);
            reset.seeds.truncate(random.random_range(0..5));
        }
        Request::Restore(restore) => {
            spoil(&mut restore.sources);
            restore.snapshot = with_checksum(&restore.snapshot, random).unwrap_or_default().into();
        }
        _ => {}
    }
    request
}

/// The operation that a request asks for, decided as in a stream; None if the request is refused.
fn operation(batch: &mut Batch, request: Option<Request>) -> Option<Operation> {
    match request {
        Some(Request::Rollout(rollout)) => {
            let roll = decode::floats("actions", &rollout.actions).and_then(|a| batch.roll(a, rollout.trajectories));
            roll.ok().and_then(|r| r.next(2)).map(Operation::Roll)
        }
        Some(Request::PolicyRollout(PolicyRollout { onnx, steps, trajectories })) => {
            let roll = batch.roll_network(&onnx, steps, trajectories).ok();
            roll.and_then(|r| r.next(2)).map(Operation::Roll)
        }
        request => decode::operation(batch, request, &Seal::default()).ok(),
    }
}

#[test]
fn wrong_requests_are_refused_or_carried_out() {
    let pool = Pool::new(1);
    let mut random = Xoshiro256PlusPlus::seed_from_u64(20);
    let (mut read, mut carried_out) = (0, 0);
    let mut asked = 0;
    let layout = fields::of_method("/sandgait.v1.EnvironmentService/RunSession").unwrap();
    for task in TASK_IDS {
        let mut batch = begun(task, &pool);
        let valid = requests(&batch);
        // Worlds of rapier take longer.
        let count = if task == HexapodRocks::ID { 8_000 } else { 22_000 };
        asked += count;
        for k in 0..count {
            let [one, other] = [(); 2].map(|()| &valid[random.random_range(0..valid.len())]);
            let request = if k % 2 == 0 {
                let message = mutate::mutated(&mut random, one, other);
                let sized = layout.check(&message).is_ok();
                sized.then(|| RunSessionRequest::decode(&message[..]).ok()).flatten().map(|message| message.request)
            } else {
                layout.check(one).unwrap();
                let whole = RunSessionRequest::decode(&one[..]).unwrap().request;
                Some(whole.map(|request| spoiled(&mut random, request)))
            };
            let Some(request) = request else { continue };
            read += 1;
            let Some(operation) = operation(&mut batch, request) else { continue };
            carried_out += 1;
            batch = pool.wait(batch, operation).expect("no worker panics");
        }
    }
    println!("of {asked} requests {read} could be read and {carried_out} were carried out");
    // The messages are neither all invalid nor all valid.
    assert!(read > asked / 2 && carried_out > asked / 20 && carried_out < asked / 2, "{read} {carried_out}");
}

/// A value that an option seldom has.
fn wrong_value(random: &mut Xoshiro256PlusPlus) -> prost_types::Value {
    let number = |x| prost_types::Value { kind: Some(prost_types::value::Kind::NumberValue(x)) };
    let numbers = [f64::NAN, f64::INFINITY, -f64::INFINITY, f64::MAX, -1.0, -0.0, 1e-320, 0.5, 1.0, 1e9, 4e18];
    let others =
        [json!(null), json!(true), json!(""), json!("C"), json!("xi=1e400"), json!([]), json!([0.1, 0.2]), json!({})];
    let k = random.random_range(0..numbers.len() + others.len());
    numbers.get(k).map_or_else(|| values::from_json(&others[k - numbers.len()]), |x| number(*x))
}

#[tokio::test]
async fn wrong_sessions_are_refused_or_made() {
    let limits = Limits { environments: 64, sessions: 4, ..Limits::default() };
    let sessions = Sessions::new(limits, Seal::default(), tokio_util::sync::CancellationToken::new());
    let mut random = Xoshiro256PlusPlus::seed_from_u64(21);
    let keywords =
        json!({"leg": "L", "slope_deg": 1.0, "dt": 0.001, "max_episode_steps": 50, "sand": "[sand]\nzeta = 0.5"});
    let create = |task: &str, keywords: &Value| CreateSessionRequest {
        task_id: task.into(),
        num_envs: 3,
        options: options(keywords),
        protocol: super::PROTOCOL,
    };
    let stroke = json!({"law": "agarwal2023", "max_episode_steps": 50, "sand": "[sand]\nzeta = 0.5"});
    let valid: Vec<_> = TASK_IDS
        .iter()
        .flat_map(|task| match *task {
            LegStroke::ID => [create(task, &stroke), create(task, &json!({"medium": "poppy-close"}))],
            _ => [create(task, &keywords), create(task, &json!({"leg": "C"}))],
        })
        .collect();
    let valid: Vec<_> = valid.iter().map(prost::Message::encode_to_vec).collect();
    let (mut decoded, mut made) = (0, 0);
    for k in 0..15_000 {
        let [one, other] = [(); 2].map(|()| &valid[random.random_range(0..valid.len())]);
        let message = if k % 2 == 0 { mutate::mutated(&mut random, one, other) } else { one.clone() };
        let Ok(mut message) = CreateSessionRequest::decode(&message[..]) else { continue };
        if k % 2 == 1 {
            let fields = message.options.iter_mut().flat_map(|o| o.fields.values_mut());
            let wrong = wrong_value(&mut random);
            fields.take(random.random_range(1..4)).for_each(|value| *value = wrong.clone());
            message.num_envs = [0, 1, 3, 65, u32::MAX][random.random_range(0..5)];
        }
        decoded += 1;
        let Ok(keywords) = values::to_json(message.options) else { continue };
        if let Ok((id, _)) = sessions.create(message.task_id, message.num_envs as usize, keywords).await {
            made += 1;
            sessions.close(&id).unwrap();
        }
    }
    println!("of 15000 sessions {decoded} could be read and {made} were made");
    assert!(decoded > 7_500 && made > 100 && made < decoded, "{decoded} {made}");
}
