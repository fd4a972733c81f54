//! Whatever arrives: 100,000 messages that are wrong in some way are refused or carried out, and nothing panics.

#[path = "../../tests/grpc/mutate.rs"]
mod mutate;

use super::proto::run_session_request::Request;
use super::proto::{CreateSessionRequest, Reset, Restore, Rollout, RunSessionRequest, Step};
use super::sessions::{Limits, Sessions};
use super::{decode, values};
use crate::env::task::{Blueprint, TASK_IDS};
use crate::pool::{Batch, Operation, Pool};
use prost::Message as _;
use rand::{Rng as _, SeedableRng as _};
use rand_xoshiro::Xoshiro256PlusPlus;
use serde_json::{Value, json};
use sha2::{Digest as _, Sha256};

const ENVS: usize = 3;

fn options(json: &Value) -> Option<prost_types::Struct> {
    let fields = json.as_object()?.iter().map(|(k, v)| (k.clone(), values::from_json(v))).collect();
    Some(prost_types::Struct { fields })
}

fn floats(count: usize) -> bytes::Bytes {
    (0..count).flat_map(|k| (k as f32 * 0.37).sin().to_le_bytes()).collect()
}

/// A batch in the middle of its episodes.
fn begun(task: &str, pool: &Pool) -> Batch {
    let mut batch = Batch::new(&Blueprint::new(task, Value::Null).unwrap(), ENVS).unwrap();
    let reset = batch.reset(None, Some(vec![1, 2, 3]), Default::default()).unwrap();
    pool.wait(batch, reset).unwrap()
}

/// One valid request of each kind.
fn requests(batch: &Batch) -> Vec<Vec<u8>> {
    let width = batch.spec().action.len();
    let changes = options(&json!({"leg": "C", "slope_deg": 2.5, "command": [0.1, 0.4], "medium": "poppy-close"}));
    let snapshot = batch.save().unwrap().to_bytes().unwrap();
    let all = [
        Request::Reset(Reset { seeds: vec![1, 2, u64::MAX], mask: vec![1, 0, 1].into(), options: None }),
        Request::Reset(Reset { seeds: Vec::new(), mask: bytes::Bytes::new(), options: changes }),
        Request::Step(Step { actions: floats(ENVS * width) }),
        Request::Rollout(Rollout { actions: floats(4 * ENVS * width), trajectories: true }),
        Request::Restore(Restore { snapshot: snapshot.into(), sources: vec![0; 4 * ENVS].into() }),
    ];
    let message = |request| RunSessionRequest { session_id: "0123".into(), sequence: 7, request: Some(request) };
    all.into_iter().map(|request| message(request).encode_to_vec()).collect()
}

/// A snapshot that is changed inside, as someone does who knows the format: its checksum is right.
fn with_checksum(snapshot: &[u8], random: &mut Xoshiro256PlusPlus) -> Option<Vec<u8>> {
    let start = b"sandgait snapshot\n".len();
    let digest = start + 1 + usize::from(*snapshot.get(start)?);
    let (head, body) = (snapshot.get(..digest)?, snapshot.get(digest + 32..)?);
    let body = mutate::mutated(random, body, &[]);
    Some([head, Sha256::digest(&body).as_slice(), &body].concat())
}

/// What a stream does with a message.
fn operation(batch: &mut Batch, request: Option<Request>) -> Option<Operation> {
    match request {
        Some(Request::Rollout(rollout)) => {
            let roll = decode::floats("actions", &rollout.actions).and_then(|a| batch.roll(a, rollout.trajectories));
            roll.ok().and_then(|r| r.next(2)).map(Operation::Roll)
        }
        request => decode::operation(batch, request).ok(),
    }
}

#[test]
fn wrong_requests_are_refused_or_carried_out() {
    let pool = Pool::new(1);
    let mut random = Xoshiro256PlusPlus::seed_from_u64(20);
    let (mut decoded, mut carried_out) = (0, 0);
    for task in &TASK_IDS[..2] {
        let mut batch = begun(task, &pool);
        let valid = requests(&batch);
        for _ in 0..45_000 {
            let [one, other] = [(); 2].map(|()| &valid[random.random_range(0..valid.len())]);
            let message = mutate::mutated(&mut random, one, other);
            let Ok(mut message) = RunSessionRequest::decode(&message[..]) else { continue };
            decoded += 1;
            if let Some(Request::Restore(restore)) = &mut message.request {
                let damaged = with_checksum(&restore.snapshot, &mut random);
                restore.snapshot = damaged.map_or_else(|| restore.snapshot.clone(), Into::into);
            }
            let Some(operation) = operation(&mut batch, message.request) else { continue };
            carried_out += 1;
            batch = pool.wait(batch, operation).expect("no worker panics");
        }
    }
    // Neither only noise nor only what was right before.
    assert!(decoded > 30_000 && carried_out > 3_000 && carried_out < 60_000, "{decoded} {carried_out}");
}

#[tokio::test]
async fn wrong_sessions_are_refused_or_made() {
    let limits = Limits { environments: 64, sessions: 4, ..Limits::default() };
    let sessions = Sessions::new(limits, tokio_util::sync::CancellationToken::new());
    let mut random = Xoshiro256PlusPlus::seed_from_u64(21);
    let keywords =
        json!({"leg": "L", "slope_deg": 1.0, "dt": 0.001, "max_episode_steps": 50, "sand": "[sand]\nzeta = 0.5"});
    let create = |task: &str, keywords: &Value| CreateSessionRequest {
        task_id: task.into(),
        num_envs: 3,
        options: options(keywords),
        protocol: super::PROTOCOL,
    };
    let valid: Vec<_> = TASK_IDS.iter().flat_map(|t| [create(t, &keywords), create(t, &json!({"leg": "C"}))]).collect();
    let valid: Vec<_> = valid.iter().map(prost::Message::encode_to_vec).collect();
    let (mut decoded, mut made) = (0, 0);
    for _ in 0..10_000 {
        let [one, other] = [(); 2].map(|()| &valid[random.random_range(0..valid.len())]);
        let message = mutate::mutated(&mut random, one, other);
        let Ok(message) = CreateSessionRequest::decode(&message[..]) else { continue };
        decoded += 1;
        let created = values::to_json(message.options)
            .and_then(|keywords| sessions.create(&message.task_id, message.num_envs as usize, keywords));
        if let Ok((id, _)) = created {
            made += 1;
            sessions.close(&id).unwrap();
        }
    }
    assert!(decoded > 2_000 && made > 50 && made < decoded, "{decoded} {made}");
}
