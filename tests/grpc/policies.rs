//! Rollouts of an uploaded policy give the same numbers as single steps, on any number of threads, and do not change the session.

use crate::harness::{ACTIONS, Server, Session, floats, number, step};
use crate::rollouts::parts;
use sandgait::service::proto::run_session_request::Request;
use sandgait::service::proto::run_session_response::Response;
use sandgait::service::proto::{PolicyRollout, RolloutPart};

const PPO: &[u8] = include_bytes!("../data/policy_ppo.onnx");

fn rollout(onnx: &[u8], steps: u32, trajectories: bool) -> Request {
    Request::PolicyRollout(PolicyRollout { onnx: onnx.to_vec().into(), steps, trajectories })
}

/// Observations, rewards and actions of all parts.
fn joined(parts: &[RolloutPart]) -> [Vec<f32>; 3] {
    let columns: [fn(&RolloutPart) -> &[u8]; 3] = [|p| &p.observations, |p| &p.rewards, |p| &p.actions];
    columns.map(|column| parts.iter().flat_map(|part| floats(column(part))).collect())
}

#[tokio::test]
async fn a_policys_rollout_equals_its_steps_and_changes_nothing() {
    let (envs, steps) = (20, 40);
    let limit = [("max_episode_steps", number(60.0))];
    let (one, three) = (Server::start(1).await, Server::start(3).await);
    let mut session = Session::create(one.client().await, envs as u32, &limit).await.unwrap();
    let mut other = Session::create(three.client().await, envs as u32, &limit).await.unwrap();
    assert_eq!(session.reset(3).await, other.reset(3).await);
    let parts = self::parts(&mut session, rollout(PPO, steps, true)).await;
    let other_parts = self::parts(&mut other, rollout(PPO, steps, true)).await;
    let wide = session.task.observation.len();
    let [observations, rewards, actions] = joined(&parts);
    // The server cuts a rollout into parts by time; the joined content does not depend on this.
    assert_eq!([&observations, &rewards, &actions], joined(&other_parts).each_ref(), "threads");
    assert_eq!(parts.last().unwrap().returns, other_parts.last().unwrap().returns);
    assert_eq!(actions.len(), steps as usize * envs * ACTIONS);
    for k in 0..steps as usize {
        let row = &actions[k * envs * ACTIONS..][..envs * ACTIONS];
        assert!(row.iter().any(|a| a.abs() > 0.01) && row.iter().all(|a| a.abs() <= 1.0));
        let batch = other.batch(step(row)).await;
        assert_eq!(floats(&batch.observations), observations[k * envs * wide..][..envs * wide], "step {k}");
        assert_eq!(floats(&batch.rewards), rewards[k * envs..][..envs], "step {k}");
    }
    // The rollout begins at the present state of the environments, which `session` reaches after the same steps.
    let again = self::parts(&mut session, rollout(PPO, 60, false)).await;
    let [only] = &again[..] else { panic!() };
    assert!(only.actions.is_empty() && only.observations.is_empty());
    let rest = self::parts(&mut other, rollout(PPO, 60, false)).await;
    let total = |part: &RolloutPart| -> Vec<f64> {
        part.returns.chunks_exact(8).map(|b| f64::from_le_bytes(b.try_into().unwrap())).collect()
    };
    let (whole, first, rest) = (total(only), total(parts.last().unwrap()), total(&rest[0]));
    for i in 0..envs {
        assert!((whole[i] - first[i] - rest[i]).abs() < 1e-9, "environment {i}");
    }
}

#[tokio::test]
async fn wrong_policies_are_refused() {
    let server = Server::start(1).await;
    let mut session = server.session(2).await;
    let failure = session.failure(Some(rollout(PPO, 5, false))).await;
    assert!(failure.message.contains("rollout before reset"), "{}", failure.message);
    session.reset(0).await;
    let mut undisturbed = server.session(2).await;
    undisturbed.reset(0).await;
    for (onnx, steps, word) in [
        (PPO, 0, "steps: 0 is outside [1, 500]"),
        (PPO, 501, "steps: 501"),
        (&PPO[..900], 5, "policy: this is no ONNX"),
    ] {
        let failure = session.failure(Some(rollout(onnx, steps, false))).await;
        assert!(failure.message.contains(word), "{}", failure.message);
    }
    // Weights that are not numbers are detected when the network runs; the session's state is then restored.
    let mut broken = PPO.to_vec();
    broken[1000..1500].fill(0xff); // in the first layer's
    session.send(Some(rollout(&broken, 5, true))).await;
    match session.receive().await.unwrap().1 {
        Response::Failure(failure) => assert!(failure.message.starts_with("policy: action["), "{}", failure.message),
        other => panic!("{other:?}"),
    }
    assert_eq!(session.step(0).await, undisturbed.step(0).await);
}
