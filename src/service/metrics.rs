//! A server's counters, as a page for Prometheus.

use super::connections;
use super::refusals::Refusals;
use crate::error::{Error, Result};
use crate::pool::{Batch, Operation};
use axum::http::header::CONTENT_TYPE;
use axum::response::IntoResponse;
use axum::routing::get;
use prometheus_client::encoding::text::encode;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::metrics::histogram::{Histogram, exponential_buckets};
use prometheus_client::registry::{Registry, Unit};
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;
use tonic::Code;

type Labels = [(&'static str, String); 1];

/// The counters of one server; `docs/serving.md` has them as a table.
pub struct Metrics {
    steps: Counter,
    autoresets: Counter,
    divergences: Counter,
    batches: Family<Labels, Histogram, fn() -> Histogram>,
    failures: Family<Labels, Counter>,
    sessions: Gauge,
    environments: Gauge,
    memory: Gauge,
    registry: Registry,
}

/// Bounds of the histogram from 0.1 ms to 3.3 s, each twice the bound before: our choice, from a step of 16
/// environments to a reset of the largest session.
fn times() -> Histogram {
    Histogram::new(exponential_buckets(1e-4, 2.0, 16))
}

impl Default for Metrics {
    fn default() -> Self {
        let mut all = Self {
            steps: Counter::default(),
            autoresets: Counter::default(),
            divergences: Counter::default(),
            batches: Family::new_with_constructor(times),
            failures: Family::default(),
            sessions: Gauge::default(),
            environments: Gauge::default(),
            memory: Gauge::default(),
            registry: Registry::with_prefix("sandgait"),
        };
        let r = &mut all.registry;
        r.register("environment_steps", "Steps of single environments, those of rollouts included", all.steps.clone());
        r.register("autoresets", "Episodes that ended, each followed by a reset", all.autoresets.clone());
        r.register("divergences", "Episodes that ended because a state was not finite", all.divergences.clone());
        let help = "Time from a checked request to its answer, without the network, by operation";
        r.register_with_unit("batch", help, Unit::Seconds, all.batches.clone());
        r.register("failures", "Calls that failed and requests that were refused, by gRPC code", all.failures.clone());
        r.register("sessions", "Sessions that have not ended", all.sessions.clone());
        r.register("environments", "Environments of these sessions", all.environments.clone());
        let help = "Memory estimated for these sessions";
        r.register_with_unit("memory_reserved", help, Unit::Bytes, all.memory.clone());
        all
    }
}

impl Metrics {
    /// Starts measuring `operation` on a batch of `envs` environments; the returned function is called with the batch
    /// when its rows are complete. Parts of rollouts are not measured in this way.
    pub fn begin(self: &Arc<Self>, operation: &Operation, envs: usize) -> impl FnOnce(&Batch) + Send + use<> {
        let (name, steps) = (operation.name(), operation.steps(envs));
        let (all, begun) = (self.clone(), Instant::now());
        move |batch| {
            all.batches.get_or_create(&[("operation", name.into())]).observe(begun.elapsed().as_secs_f64());
            all.steps.inc_by(steps as u64);
            all.ended_episodes(batch);
        }
    }

    /// Counts the episodes that ended in this step; operations other than a step set no flags.
    fn ended_episodes(&self, batch: &Batch) {
        let spec = batch.spec();
        let diverged = spec.info.iter().position(|c| c.name == "diverged");
        for rows in batch.shards().iter().map(|s| &s.rows) {
            let ended = |&i: &usize| rows.terminated[i] != 0 || rows.truncated[i] != 0;
            for i in (0..rows.terminated.len()).filter(ended) {
                self.autoresets.inc();
                let broken = diverged.is_some_and(|k| rows.infos[i * spec.info.len() + k] != 0.0);
                self.divergences.inc_by(u64::from(broken));
            }
        }
    }

    /// Counts a rollout that was carried out.
    pub fn rolled(&self, time: Duration, batch: &Batch) {
        self.batches.get_or_create(&[("operation", "rollout".into())]).observe(time.as_secs_f64());
        let steps = batch.shards().iter().flat_map(|s| &s.rollout.lengths).map(|n| u64::from(*n)).sum();
        self.steps.inc_by(steps);
    }

    /// Counts a call that ended with this code, or a request of a stream that was refused with it. OK is not counted.
    pub fn ended(&self, code: Code) {
        if code != Code::Ok {
            self.failures.get_or_create(&[("code", format!("{code:?}"))]).inc();
        }
    }

    /// The page, in the text format of Prometheus.
    fn page(&self, usage: Usage) -> Result<String> {
        self.sessions.set(usage.sessions as i64);
        self.environments.set(usage.environments as i64);
        self.memory.set(usage.memory as i64);
        let mut page = String::new();
        encode(&mut page, &self.registry).map_err(|e| Error::Exhausted(format!("metrics: {e}")))?;
        Ok(page)
    }
}

/// The present numbers of sessions and environments.
#[derive(Clone, Copy, Default)]
pub struct Usage {
    pub sessions: usize,
    pub environments: usize,
    /// Estimated [bytes].
    pub memory: usize,
}

/// Answers `GET /metrics` until `stop` is cancelled; `usage` returns the present use by sessions.
pub async fn serve(
    listener: TcpListener,
    metrics: Arc<Metrics>,
    usage: impl Fn() -> Usage + Clone + Send + Sync + 'static,
    refusals: Arc<Refusals>,
    stop: CancellationToken,
) {
    let page = async move || {
        let page = metrics.page(usage()).map_err(|e| e.to_string())?;
        Ok::<_, String>(([(CONTENT_TYPE, FORMAT)], page).into_response())
    };
    let app = axum::Router::new().route("/metrics", get(page));
    connections::pages(listener, app, connections::METRICS, refusals, stop).await;
}

const FORMAT: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";
