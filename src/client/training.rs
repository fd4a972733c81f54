//! The environments of `sandgait train --address`: a session on a server.

use super::address::ServerAddress;
use super::call::{close_session, create_session};
use super::stream::{PATIENCE, Stream};
use super::{runtime, wait};
use crate::error::{Error, Result};
use crate::service::proto::run_session_request::Request as SessionRequest;
use crate::service::proto::run_session_response::Response as Answer;
use crate::service::proto::{Batch, Column, Reset, Restore, RunSessionRequest, Save, Step, Task};
use crate::train::remote::{Pause, RemoteEnvironments};
use sandgait_env::Spec;
use sandgait_env::registry::Blueprint;
use sandgait_env::shard::Rows;
use serde_json::Value;
use std::pin::pin;
use std::time::{Duration, Instant};
use tonic::{Code, Status};

/// Time during which the client tries to reach a server again, the same as in the Python client.
const RETRY: Duration = Duration::from_secs(2);

/// Longest wait for a server to free a session that is no longer needed: our choice, so that a training's end is not
/// held up. Without an answer, the session ends with its lease.
const CLOSING: Duration = Duration::from_secs(2);

/// A session with one request in flight at most.
pub struct TrainingSession {
    place: ServerAddress,
    id: String,
    stream: Stream,
    sequence: u64,
    envs: usize,
    observation: usize,
    /// Number of info columns; 0 if the server's info columns differ from the columns of this version.
    info: usize,
}

/// The error for a server's refusal or a lost connection.
fn failed(place: &ServerAddress, status: &Status) -> Error {
    let what = if status.code() == Code::Unavailable { "it cannot be reached: " } else { "" };
    Error::invalid(format!("server {}", place.address), format!("{what}{}", status.message()))
}

impl TrainingSession {
    /// `envs` environments of `blueprint`, made with `options`.
    pub fn new(
        place: ServerAddress,
        blueprint: &Blueprint,
        options: &Value,
        envs: usize,
        pause: Pause,
    ) -> Result<Self> {
        let spec = blueprint.task.spec();
        let runtime = runtime().map_err(|e| failed(&place, &e))?;
        let created = {
            let mut call = pin!(create_session(&place, spec.id.into(), envs as u32, options));
            loop {
                match wait(&runtime, call.as_mut(), PATIENCE) {
                    Some(created) => break created.map_err(|e| failed(&place, &e))?,
                    None => pause()?,
                }
            }
        };
        let stream = open(&place, &created.session_id, pause)?;
        let observation = spec.observation.len();
        let task = created.task.unwrap_or_default();
        let info = if names(&task.info).eq(own(&spec.info)) { spec.info.len() } else { 0 };
        let session = Self { place, id: created.session_id, stream, sequence: 0, envs, observation, info };
        if !is_same(&task, spec) {
            let reason = format!("its {} has other observations, actions or options than this version's", spec.id);
            return Err(Error::invalid(format!("server {}", session.place.address), reason));
        }
        Ok(session)
    }

    /// The answer to `asked`. If the stream breaks, new streams are tried for a while. Requests are numbered, so no
    /// request is carried out twice.
    fn ask(&mut self, asked: SessionRequest, pause: Pause) -> Result<Answer> {
        self.sequence += 1;
        let request = RunSessionRequest { session_id: String::new(), sequence: self.sequence, request: Some(asked) };
        self.stream.send(request.clone(), true);
        let mut lost: Option<Instant> = None;
        loop {
            let status = match self.stream.receive(PATIENCE) {
                None => {
                    pause()?;
                    continue;
                }
                Some(Ok(answer)) if answer.sequence < self.sequence => continue,
                Some(Ok(answer)) => match answer.response {
                    Some(Answer::Failure(failure)) => {
                        return Err(failed(&self.place, &Status::new(Code::InvalidArgument, failure.message)));
                    }
                    Some(answer) => return Ok(answer),
                    None => return Err(self.wrong()),
                },
                Some(Err(status)) => status,
            };
            let since = *lost.get_or_insert_with(Instant::now);
            if status.code() != Code::Unavailable || since.elapsed() > RETRY {
                return Err(failed(&self.place, &status));
            }
            std::thread::sleep(PATIENCE);
            pause()?;
            match open(&self.place, &self.id, pause) {
                Ok(stream) => {
                    self.stream = stream;
                    self.stream.send(request.clone(), true);
                }
                // Try again, because the old stream still reports that it is broken.
                Err(Error::Invalid { reason, .. })
                    if since.elapsed() <= RETRY && reason.starts_with("it cannot be reached") => {}
                Err(error) => return Err(error),
            }
        }
    }

    fn rows(&mut self, asked: SessionRequest, pause: Pause) -> Result<Rows> {
        match self.ask(asked, pause)? {
            Answer::Batch(batch) => {
                unpacked(&batch, self.envs, [self.observation, self.info]).ok_or_else(|| self.wrong())
            }
            _ => Err(self.wrong()),
        }
    }

    fn wrong(&self) -> Error {
        Error::invalid(format!("server {}", self.place.address), "its answer does not match the request")
    }
}

impl RemoteEnvironments for TrainingSession {
    fn reset(&mut self, seeds: &[u64], pause: Pause) -> Result<Rows> {
        self.rows(SessionRequest::Reset(Reset { seeds: seeds.to_vec(), ..Reset::default() }), pause)
    }

    fn step(&mut self, actions: &[f32], pause: Pause) -> Result<Rows> {
        let actions: Vec<u8> = actions.iter().flat_map(|x| x.to_le_bytes()).collect();
        self.rows(SessionRequest::Step(Step { actions: actions.into(), ..Step::default() }), pause)
    }

    fn save(&mut self, pause: Pause) -> Result<Option<Vec<u8>>> {
        match self.ask(SessionRequest::Save(Save {}), pause)? {
            Answer::Snapshot(snapshot) => Ok(Some(snapshot.data.to_vec())),
            _ => Err(self.wrong()),
        }
    }

    fn restore(&mut self, snapshot: &[u8], pause: Pause) -> Result<Rows> {
        let snapshot = snapshot.to_vec().into();
        self.rows(SessionRequest::Restore(Restore { snapshot, ..Restore::default() }), pause)
    }

    fn terms(&mut self) -> Result<Option<Vec<(String, f64)>>> {
        Ok((self.info == 0).then(Vec::new))
    }
}

impl Drop for TrainingSession {
    fn drop(&mut self) {
        self.stream.close();
        if let Ok(runtime) = runtime() {
            // If the server does not answer, it frees the session at the end of its lease.
            let _ = runtime.block_on(close_session(&self.place, self.id.clone(), CLOSING));
        }
    }
}

fn open(place: &ServerAddress, id: &str, pause: Pause) -> Result<Stream> {
    Stream::open(place.clone(), id.to_owned(), pause)?.map_err(|e| failed(place, &e))
}

fn names(columns: &[Column]) -> impl Iterator<Item = &str> {
    columns.iter().map(|column| column.name.as_str())
}

fn own(columns: &[sandgait_env::Column]) -> impl Iterator<Item = &str> {
    columns.iter().map(|column| column.name.as_str())
}

/// Does the server's task have the columns of `spec`, and episodes of the same length?
fn is_same(task: &Task, spec: &Spec) -> bool {
    names(&task.observation).eq(own(&spec.observation))
        && names(&task.action).eq(own(&spec.action))
        && task.max_episode_steps == spec.max_episode_steps
}

/// A batch's bytes as numbers; None if their lengths are wrong.
fn unpacked(batch: &Batch, envs: usize, [observation, info]: [usize; 2]) -> Option<Rows> {
    let floats = |bytes: &[u8], count: usize| -> Option<Vec<f32>> {
        let (all, rest) = bytes.as_chunks::<4>();
        (rest.is_empty() && all.len() == count).then(|| all.iter().map(|b| f32::from_le_bytes(*b)).collect())
    };
    let flags = |bytes: &[u8]| (bytes.len() == envs).then(|| bytes.to_vec());
    let (ended, rest) = batch.final_indices.as_chunks::<4>();
    let ended: Vec<u32> = ended.iter().map(|b| u32::from_le_bytes(*b)).collect();
    if !rest.is_empty() || ended.iter().any(|i| *i as usize >= envs) {
        return None;
    }
    Some(Rows {
        infos: if info > 0 { floats(&batch.infos, envs * info)? } else { Vec::new() },
        observations: floats(&batch.observations, envs * observation)?,
        rewards: floats(&batch.rewards, envs)?,
        terminated: flags(&batch.terminated)?,
        truncated: flags(&batch.truncated)?,
        final_observations: floats(&batch.final_observations, ended.len() * observation)?,
        ended,
    })
}
