//! The environments of `sandgait train --address`: a session on a server.

use super::address::ServerAddress;
use super::call::{close_session, create_session};
use super::stream::{PATIENCE, Stream};
use super::{runtime, wait};
use crate::error::{Error, Result};
use crate::service::proto::run_session_request::Request as SessionRequest;
use crate::service::proto::run_session_response::Response as Answer;
use crate::service::proto::{Batch, Column, CreateSessionResponse, Failure, Reset, Restore, RunSessionRequest};
use crate::service::proto::{Save, Snapshot, Step, Task};
use crate::train::remote::{Pause, RemoteEnvironments};
use sandgait_env::Spec;
use sandgait_env::registry::Blueprint;
use sandgait_env::shard::Rows;
use serde_json::Value;
use std::pin::pin;
use std::time::{Duration, Instant};
use tonic::{Code, Status};

/// Time during which the client tries to reach a lost server again: `RETRY_RESUME` of the Python client. A server that
/// stops takes up to 5 s to save its sessions, and it may start on another machine.
const RETRY: Duration = Duration::from_secs(60);

/// The first and the longest pause between two attempts, the same as in the Python client. Each pause is twice as long
/// as the one before.
const PAUSES: [Duration; 2] = [Duration::from_millis(10), Duration::from_secs(1)];

/// Longest wait for a server to free a session that is no longer needed: our choice, so that a training's end is not
/// held up. Without an answer, the session ends with its lease.
const CLOSING: Duration = Duration::from_secs(2);

/// A session with one request in flight at most. After a lost connection it goes on, and if the server has lost the
/// session, or has an older state of it, the session is made anew from the last snapshot and the requests after it.
pub struct TrainingSession {
    place: ServerAddress,
    id: String,
    /// None while the connection is lost.
    stream: Option<Stream>,
    sequence: u64,
    order: SessionOrder,
    /// The snapshot of the last save, and the requests after it that changed the environments.
    snapshot: Option<Snapshot>,
    since: Vec<SessionRequest>,
    /// How often the connection was opened again, and how often the session was made anew.
    repairs: [usize; 2],
    observation: usize,
    /// Number of info columns; 0 if the server's info columns differ from the columns of this version.
    info: usize,
}

/// What a session is made from.
struct SessionOrder {
    task: String,
    options: Value,
    envs: usize,
}

/// The error for a server's refusal or a lost connection.
fn failed(place: &ServerAddress, status: &Status) -> Error {
    let (server, message) = (&place.address, status.message());
    match status.code() {
        Code::Unavailable => Error::lost(server, format!("it cannot be reached: {message}")),
        Code::DeadlineExceeded | Code::NotFound | Code::Cancelled | Code::Aborted => Error::lost(server, message),
        Code::ResourceExhausted => Error::Exhausted(format!("server {server}: {message}")),
        _ => Error::invalid(format!("server {server}"), message),
    }
}

/// Was the connection lost before the answer came?
fn is_lost(status: &Status) -> bool {
    matches!(status.code(), Code::Unavailable | Code::DeadlineExceeded)
}

/// May a server that does not give the session back now do it later? It may be starting, stopping, or full.
fn is_passing(status: &Status) -> bool {
    is_lost(status) || matches!(status.code(), Code::Cancelled | Code::NotFound | Code::ResourceExhausted)
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
        let order = SessionOrder { task: spec.id.into(), options: options.clone(), envs };
        let created = create(&place, &order, pause)?.map_err(|e| failed(&place, &e))?;
        let stream = Stream::open(place.clone(), created.session_id.clone(), pause)?;
        let stream = Some(stream.map_err(|e| failed(&place, &e))?);
        let observation = spec.observation.len();
        let task = created.task.unwrap_or_default();
        let info = if names(&task.info).eq(own(&spec.info)) { spec.info.len() } else { 0 };
        let (snapshot, since, repairs) = (None, Vec::new(), [0; 2]);
        let id = created.session_id;
        let session = Self { place, id, stream, sequence: 0, order, snapshot, since, repairs, observation, info };
        if !is_same(&task, spec) {
            let reason = format!("its {} has other observations, actions or options than this version's", spec.id);
            return Err(Error::invalid(format!("server {}", session.place.address), reason));
        }
        Ok(session)
    }

    /// The answer to `asked`. Requests are numbered, so no request is carried out twice.
    fn ask(&mut self, asked: SessionRequest, pause: Pause) -> Result<Answer> {
        self.sequence += 1;
        self.send(&asked);
        let mut lost: Option<Instant> = None;
        let answer = loop {
            let status = match self.answer(pause)? {
                Ok(answer) => break answer,
                Err(status) => status,
            };
            if !is_lost(&status) {
                return Err(failed(&self.place, &status));
            }
            self.stream = None;
            let until = *lost.get_or_insert_with(Instant::now) + RETRY;
            self.reopen(status, until, pause)?;
            self.send(&asked);
        };
        self.remember(asked, &answer);
        Ok(answer)
    }

    /// Sends a request with the present number. If the stream breaks, [`Self::answer`] gets the error.
    fn send(&self, asked: &SessionRequest) {
        if let Some(stream) = &self.stream {
            let (session_id, sequence) = (String::new(), self.sequence);
            stream.send(RunSessionRequest { session_id, sequence, request: Some(asked.clone()) }, true);
        }
    }

    /// The answer to the request with the present number.
    fn answer(&self, pause: Pause) -> Result<std::result::Result<Answer, Status>> {
        let Some(stream) = &self.stream else { return Ok(Err(Status::unavailable("the connection is closed"))) };
        loop {
            match stream.receive(PATIENCE) {
                None => pause()?,
                Some(Ok(answer)) if answer.sequence < self.sequence => {}
                Some(Ok(answer)) => match answer.response {
                    Some(Answer::Failure(Failure { code, message })) => {
                        return Ok(Err(Status::new(Code::from(code), message)));
                    }
                    Some(answer) => return Ok(Ok(answer)),
                    None => return Err(self.wrong()),
                },
                Some(Err(status)) => return Ok(Err(status)),
            }
        }
    }

    /// Opens a new stream; if the server does not have the session in its last state, makes it anew. Tries until
    /// `until`; `reason` says why the last stream broke.
    fn reopen(&mut self, reason: Status, until: Instant, pause: Pause) -> Result<()> {
        let mut wait = PAUSES[0];
        loop {
            let status = match self.attach(until, pause)? {
                Ok(()) => return Ok(()),
                Err(status) if status.code() == Code::NotFound => match self.make_anew(until, pause)? {
                    Ok(()) => return Ok(()),
                    Err(status) => status,
                },
                Err(status) => status,
            };
            if !is_passing(&status) {
                return Err(failed(&self.place, &status));
            }
            if Instant::now() > until {
                return Err(failed(&self.place, &reason));
            }
            let next = Instant::now() + wait;
            while Instant::now() < next {
                std::thread::sleep(PATIENCE.min(wait));
                pause()?;
            }
            wait = PAUSES[1].min(2 * wait);
        }
    }

    /// Opens a stream to the session, which must have answered the present request or the one before it. NotFound: the
    /// server has no such session, or an older state of it.
    fn attach(&mut self, until: Instant, pause: Pause) -> Result<std::result::Result<(), Status>> {
        let stream = match open(&self.place, &self.id, until, pause)? {
            Ok(stream) => stream,
            Err(status) => return Ok(Err(status)),
        };
        let last = stream.last_sequence;
        if last != self.sequence && last + 1 != self.sequence {
            stream.close();
            self.close();
            return Ok(Err(Status::not_found("the server has an older state of the session")));
        }
        self.stream = Some(stream);
        self.repairs[0] += 1;
        Ok(Ok(()))
    }

    /// Makes the session again, restores the last snapshot and repeats all requests after it.
    fn make_anew(&mut self, until: Instant, pause: Pause) -> Result<std::result::Result<(), Status>> {
        let created = match create(&self.place, &self.order, pause)? {
            Ok(created) => created,
            Err(status) => return Ok(Err(status)),
        };
        let restore = self.snapshot.clone().map(|saved| Restore { snapshot: saved.data, ..Restore::default() });
        let past: Vec<_> = restore.map(SessionRequest::Restore).into_iter().chain(self.since.iter().cloned()).collect();
        // From now on the present request has this number. A session without the past is older, and is made anew.
        let next = past.len() as u64 + 1;
        (self.id, self.sequence) = (created.session_id, next);
        let stream = match open(&self.place, &self.id, until, pause)? {
            Ok(stream) => stream,
            Err(status) => return Ok(Err(status)),
        };
        self.stream = Some(stream);
        for (request, number) in past.iter().zip(1..) {
            self.sequence = number;
            self.send(request);
            if let Err(status) = self.answer(pause)? {
                (self.stream, self.sequence) = (None, next);
                return Ok(Err(status));
            }
        }
        self.sequence = next;
        self.repairs[1] += 1;
        Ok(Ok(()))
    }

    /// Stores what [`Self::make_anew`] needs after this answer.
    fn remember(&mut self, asked: SessionRequest, answer: &Answer) {
        match (asked, answer) {
            (SessionRequest::Save(_), Answer::Snapshot(snapshot)) => {
                self.snapshot = Some(snapshot.clone());
                self.since.clear();
            }
            (restore @ SessionRequest::Restore(_), _) => {
                self.snapshot = None;
                self.since = vec![restore];
            }
            (asked @ (SessionRequest::Reset(_) | SessionRequest::Step(_)), _) => self.since.push(asked),
            _ => {}
        }
    }

    /// Frees the session on the server. If the server does not answer, it frees it at the end of its lease.
    fn close(&self) {
        if let Ok(runtime) = runtime() {
            let _ = runtime.block_on(close_session(&self.place, self.id.clone(), CLOSING));
        }
    }

    fn rows(&mut self, asked: SessionRequest, pause: Pause) -> Result<Rows> {
        match self.ask(asked, pause)? {
            Answer::Batch(batch) => {
                unpacked(&batch, self.order.envs, [self.observation, self.info]).ok_or_else(|| self.wrong())
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

    fn notices(&self) -> Vec<String> {
        let server = &self.place.address;
        let said = |count: usize, what: &str| match count {
            0 => None,
            1 => Some(format!("server {server}: {what} once")),
            n => Some(format!("server {server}: {what} {n} times")),
        };
        let [opened, made] = self.repairs;
        let made = said(made, "the session was lost, and made anew from the training's own data,");
        said(opened, "the connection was lost and opened again").into_iter().chain(made).collect()
    }
}

impl Drop for TrainingSession {
    fn drop(&mut self) {
        if let Some(stream) = &self.stream {
            stream.close();
        }
        self.close();
    }
}

/// A new session at `place`.
fn create(
    place: &ServerAddress,
    order: &SessionOrder,
    pause: Pause,
) -> Result<std::result::Result<CreateSessionResponse, Status>> {
    let runtime = match runtime() {
        Ok(runtime) => runtime,
        Err(status) => return Ok(Err(status)),
    };
    let mut call = pin!(create_session(place, order.task.clone(), order.envs as u32, &order.options));
    loop {
        match wait(&runtime, call.as_mut(), PATIENCE) {
            Some(created) => return Ok(created),
            None => pause()?,
        }
    }
}

/// A stream to session `id`, if it can be opened until `until`.
fn open(place: &ServerAddress, id: &str, until: Instant, pause: Pause) -> Result<std::result::Result<Stream, Status>> {
    let stopped = || match Instant::now() > until {
        true => Err(Error::lost(&place.address, "it cannot be reached: no answer")),
        false => pause(),
    };
    Stream::open(place.clone(), id.to_owned(), stopped)
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
