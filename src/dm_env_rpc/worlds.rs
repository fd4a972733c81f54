//! Worlds: sessions of one environment, and the connections that have joined them.

use super::proto::ActionObservationSpecs;
use super::settings::{NewWorld, ResetChanges};
use super::tensors::{self, WorldView};
use crate::env::AnyTask;
use crate::error::{Error, Result};
use crate::pool::{Batch, Operation, Pool};
use crate::sessions::broken;
use crate::sessions::{Sessions, StreamHold};
use crate::status::SESSION;
use parking_lot::Mutex;
use std::collections::HashMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use tokio::sync::oneshot;

/// A ResetWorld that waits for the connection that has joined the world.
pub struct PendingReset {
    pub changes: ResetChanges,
    pub done: oneshot::Sender<Result<()>>,
}

/// All worlds of a server.
pub struct Worlds {
    pub sessions: Arc<Sessions>,
    pool: Arc<Pool>,
    /// Joined worlds, by name.
    joined: Mutex<HashMap<String, Joined>>,
}

/// A world that a connection has joined.
struct Joined {
    /// The connection's attachment to the session.
    stream: u64,
    interrupt: Option<PendingReset>,
}

/// A connection's place in a world; dropping it leaves the world.
pub struct JoinedWorld {
    hold: StreamHold,
    worlds: Arc<Worlds>,
    pub task: Arc<dyn AnyTask>,
}

impl Drop for JoinedWorld {
    fn drop(&mut self) {
        let mut joined = self.worlds.joined.lock();
        self.worlds.sessions.detach(&self.hold);
        // Another connection has joined the world meanwhile if a stream of sandgait.v1 took the world from this one.
        if joined.get(&self.hold.id).is_some_and(|j| j.stream == self.hold.stream) {
            // This drops the sender of a waiting ResetWorld, which then finds the world free.
            joined.remove(&self.hold.id);
        }
    }
}

/// How ResetWorld reaches a world.
enum WorldEntry {
    /// No connection had joined it.
    Free(JoinedWorld),
    /// The connection that has joined it answers here at its next step.
    Waiting(oneshot::Receiver<Result<()>>),
}

/// A request to a world.
enum WorldRequest {
    /// Show the first observation of the present episode, which has no steps yet.
    Begin,
    /// Begin another episode.
    Reset(Box<ResetChanges>),
    Step(Vec<f32>),
}

impl WorldRequest {
    /// The operation of the request; None: the environment stays as it is.
    fn operation(self, batch: &mut Batch) -> Result<Option<Operation>> {
        match self {
            Self::Begin if batch.is_fresh() => Ok(None),
            Self::Begin => batch.reset(None, None, Default::default()).map(Some),
            Self::Reset(changes) => {
                let ResetChanges { options, seed } = *changes;
                batch.reset(None, seed.map(|s| vec![s]), options).map(Some)
            }
            Self::Step(action) => batch.step(action).map(Some),
        }
    }

    /// Can the request be prepared on the async runtime's threads? With changed options it makes a model, which takes
    /// too long.
    fn is_light(&self) -> bool {
        !matches!(self, Self::Reset(changes) if changes.options != Default::default())
    }

    /// The function that reads the operation's results.
    fn view(&self) -> fn(&Batch) -> WorldView {
        if matches!(self, Self::Step(_)) { WorldView::after_step } else { WorldView::first }
    }
}

/// Converts an error about a session to one about a world.
fn of_world(error: Error, name: &str) -> Error {
    match error {
        Error::Unknown { what: SESSION, .. } => Error::unknown(SESSION, name, &["worlds that have not been destroyed"]),
        Error::OutOfOrder(_) => Error::OutOfOrder(format!("world_name: another connection has joined {name:?}")),
        other => other,
    }
}

impl Worlds {
    pub fn new(sessions: Arc<Sessions>, pool: Arc<Pool>) -> Arc<Self> {
        Arc::new(Self { sessions, pool, joined: Mutex::default() })
    }

    /// Makes a world at the start of its first episode, and returns its name.
    pub async fn create(self: &Arc<Self>, plan: NewWorld) -> Result<String> {
        let NewWorld { task, options, seed } = plan;
        let (name, _) = self.sessions.create(task, 1, options).await?;
        // Two worlds without a seed must differ.
        let seed = Some(seed.unwrap_or_else(rand::random));
        self.join(&name)?.reset(ResetChanges { seed, ..Default::default() }).await?;
        Ok(name)
    }

    /// Joins a world that no connection has joined.
    pub fn join(self: &Arc<Self>, name: &str) -> Result<JoinedWorld> {
        let mut joined = self.joined.lock();
        self.enter(&mut joined, name)
    }

    fn enter(self: &Arc<Self>, joined: &mut HashMap<String, Joined>, name: &str) -> Result<JoinedWorld> {
        let summary = self.sessions.describe(name).map_err(|e| of_world(e, name))?;
        if summary.envs != 1 {
            let reason = format!("{name:?} is a session of {} environments, a world has one", summary.envs);
            return Err(Error::invalid("world_name", reason));
        }
        let hold = self.sessions.attach_free(name).map_err(|e| of_world(e, name))?;
        joined.insert(name.into(), Joined { stream: hold.stream, interrupt: None });
        Ok(JoinedWorld { hold, worlds: self.clone(), task: summary.blueprint.task })
    }

    /// Begins another episode in a world. If a connection has joined it, waits until that connection has been
    /// notified.
    pub async fn reset(self: &Arc<Self>, name: &str, changes: ResetChanges) -> Result<()> {
        loop {
            let told = match self.enter_or_interrupt(name, &changes)? {
                WorldEntry::Free(place) => return place.reset(changes).await.map(drop),
                WorldEntry::Waiting(told) => told,
            };
            // If there is no answer, the other connection has left, and the world is free.
            if let Ok(result) = told.await {
                return result;
            }
        }
    }

    fn enter_or_interrupt(self: &Arc<Self>, name: &str, changes: &ResetChanges) -> Result<WorldEntry> {
        let mut joined = self.joined.lock();
        match joined.get_mut(name) {
            None => self.enter(&mut joined, name).map(WorldEntry::Free),
            Some(Joined { interrupt: Some(waiting), .. }) if !waiting.done.is_closed() => {
                Err(Error::OutOfOrder(format!("world_name: another reset_world of {name:?} is waiting")))
            }
            // A ResetWorld whose client has left makes room.
            Some(Joined { interrupt, .. }) => {
                let (done, told) = oneshot::channel();
                *interrupt = Some(PendingReset { changes: changes.clone(), done });
                Ok(WorldEntry::Waiting(told))
            }
        }
    }

    /// Ends a world that no connection has joined.
    pub fn destroy(&self, name: &str) -> Result<()> {
        self.sessions.close_free(name).map_err(|e| match of_world(e, name) {
            Error::OutOfOrder(joined) => Error::OutOfOrder(format!("{joined}; it must leave first")),
            other => other,
        })
    }
}

impl JoinedWorld {
    pub fn name(&self) -> &str {
        &self.hold.id
    }

    pub fn specs(&self) -> ActionObservationSpecs {
        tensors::specs(self.task.spec())
    }

    /// A ResetWorld of another connection that waits for this connection, if there is one.
    pub fn interrupt(&self) -> Option<PendingReset> {
        self.worlds.joined.lock().get_mut(self.name()).and_then(|joined| joined.interrupt.take())
    }

    /// The first observation of the present episode, which has no steps yet.
    pub async fn begin(&self) -> Result<WorldView> {
        self.run(WorldRequest::Begin).await
    }

    /// Begins another episode, with `changes`.
    pub async fn reset(&self, changes: ResetChanges) -> Result<WorldView> {
        self.run(WorldRequest::Reset(Box::new(changes))).await
    }

    /// One control step; `action` is one row within its bounds.
    pub async fn step(&self, action: Vec<f32>) -> Result<WorldView> {
        self.run(WorldRequest::Step(action)).await
    }

    /// Runs `request` on the pool. An operation is always finished and its environment returned, even if no caller
    /// waits for the answer any more.
    async fn run(&self, request: WorldRequest) -> Result<WorldView> {
        let gone = || Error::Cancelled(format!("world_name: {:?} was closed or taken by another stream", self.name()));
        let mut guard = self.worlds.sessions.take(&self.hold).await.ok_or_else(gone)?;
        let (sender, answer) = oneshot::channel();
        let pool = self.worlds.pool.clone();
        let (light, view) = (request.is_light(), request.view());
        let begin = move || {
            // The receiver may be gone, so the results of `send` are ignored.
            let operation = match request.operation(guard.batch()) {
                Ok(Some(operation)) => operation,
                unmoved => {
                    let seen = unmoved.map(|_| view(guard.batch()));
                    drop(guard);
                    let _ = sender.send(seen);
                    return;
                }
            };
            let changed = guard.batch().bytes_during(&operation);
            if let Some(Err(error)) = changed.map(|bytes| guard.reserve(&operation.field(), bytes)) {
                drop(guard);
                let _ = sender.send(Err(error));
                return;
            }
            let batch = guard.take();
            let ran = guard.sessions.metrics.begin(&operation, batch.envs());
            pool.run(batch, operation, move |done| {
                let seen = done.map(|batch| {
                    let seen = view(&batch);
                    ran(&batch);
                    guard.sessions.watchers.saw(&guard.id, &batch);
                    guard.put(batch);
                    if changed.is_some() {
                        guard.release();
                    }
                    seen
                });
                if let Err(error) = &seen {
                    guard.lose(error);
                }
                drop(guard);
                let _ = sender.send(seen);
            });
        };
        let begin = move || drop(catch_unwind(AssertUnwindSafe(begin)));
        if light {
            begin();
        } else {
            tokio::task::spawn_blocking(begin);
        }
        // If there is no answer, the server has ended or the work has panicked.
        let stop = self.worlds.sessions.stop();
        answer.await.unwrap_or_else(|_| Err(if stop.is_cancelled() { gone() } else { broken() }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::env::registry::TASK_IDS;
    use sandgait_service::limits::Limits;
    use serde_json::Value;
    use tokio_util::sync::CancellationToken;

    async fn world() -> (Arc<Worlds>, String) {
        let sessions = Sessions::new(Limits::default(), Default::default(), CancellationToken::new());
        let worlds = Worlds::new(sessions, Arc::new(Pool::new(1)));
        let name =
            worlds.create(NewWorld { task: TASK_IDS[0].into(), options: Value::Null, seed: Some(1) }).await.unwrap();
        (worlds, name)
    }

    /// A stream of `sandgait.v1` takes the world from the first connection, and then leaves it. The second connection
    /// joins the world, and then the first one notices this and leaves. In an earlier version the world could now be
    /// destroyed.
    #[tokio::test]
    async fn a_world_in_use_is_not_destroyed() {
        let (worlds, name) = world().await;
        let first = worlds.join(&name).unwrap();
        let stream = worlds.sessions.attach(&name).unwrap();
        let refused = worlds.destroy(&name).unwrap_err().to_string();
        assert!(refused.contains("another connection has joined"), "{refused}");
        worlds.sessions.detach(&stream);
        let second = worlds.join(&name).unwrap();
        drop(first);
        assert!(matches!(worlds.destroy(&name), Err(Error::OutOfOrder(_))));
        second.begin().await.unwrap();
        drop(second);
        worlds.destroy(&name).unwrap();
    }

    /// A connection requests a ResetWorld of a world that another connection has joined, and leaves before the answer.
    /// In an earlier version every later ResetWorld was refused.
    #[tokio::test]
    async fn an_abandoned_reset_makes_room() {
        let (worlds, name) = world().await;
        let place = worlds.join(&name).unwrap();
        let reset = || worlds.reset(&name, ResetChanges { seed: Some(2), ..Default::default() });
        let wait = std::time::Duration::from_millis(20);
        assert!(tokio::time::timeout(wait, reset()).await.is_err(), "nobody steps");
        let (later, _) = tokio::join!(reset(), async {
            tokio::time::sleep(wait).await;
            let PendingReset { changes, done } = place.interrupt().unwrap();
            let _ = done.send(place.reset(changes).await.map(drop));
        });
        later.unwrap();
    }
}
