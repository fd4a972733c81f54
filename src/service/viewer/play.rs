//! The page of one environment that its viewers steer: the live page, and also arrow keys, a gamepad, or sticks on a
//! touch screen.
//!
//! ```text
//!  GET /, /sessions, /watch/play/0    as the live page of a server
//!  POST /steer                        a command of keys, gamepad or sticks, with the key of this page as a bearer token
//! ```

use super::frames::{Frames, Latest, ViewedState, encode, next_blocks};
use super::{json, page, recording, same_machine};
use crate::connections;
use crate::env::{AnyTask, EnvView};
use crate::refusals::Refusals;
use crate::security::Token;
use axum::body::{Body, Bytes};
use axum::extract::State;
use axum::http::header::AUTHORIZATION;
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use axum::{Router, middleware};
use futures_util::stream;
use parking_lot::Mutex;
use serde_json::json as value;
use std::convert::Infallible;
use std::sync::Arc;
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;

/// Largest number of browsers: our choice.
const MOST: usize = 16;
/// Largest message of a page [bytes]: our choice; three numbers need fewer.
const MESSAGE: usize = 256;

/// One environment on a page.
pub struct PlayedEnvironment {
    task: Arc<dyn AnyTask>,
    key: Token,
    latest: Latest,
    frames: Frames,
    command: Mutex<[f64; 3]>,
}

impl PlayedEnvironment {
    /// Pages that send `key` steer. Needs a tokio runtime.
    pub fn new(task: Arc<dyn AnyTask>, key: &str) -> Arc<Self> {
        let (latest, frames) = encode(task.clone());
        Arc::new(Self { task, key: Token::new(key), latest, frames, command: Mutex::default() })
    }

    /// Shows the environment's present state.
    pub fn show(&self, look: EnvView<'_>) {
        self.latest.send_replace(Some(Arc::new(ViewedState::of(look))));
    }

    /// The last command of a page, as three shares of the largest command: from −1 (backward) to 1 (forward), from −1
    /// (right) to 1 (left), and from −1 to 1 for the yaw rate.
    pub fn command(&self) -> [f64; 3] {
        *self.command.lock()
    }

    /// Does the request have this page's key?
    fn admits(&self, headers: &HeaderMap) -> bool {
        headers.get(AUTHORIZATION).is_some_and(|value| self.key.admits(value.as_bytes()))
    }

    /// Answers browsers until `stop` is cancelled.
    pub async fn serve(self: Arc<Self>, listener: TcpListener, stop: CancellationToken) {
        let refusals = Arc::new(Refusals::default());
        connections::pages(listener, self.routes(), MOST, refusals, stop).await;
    }

    fn routes(self: Arc<Self>) -> Router {
        Router::new()
            .route("/", get(async || page("sandgait play")))
            .route("/sessions", get(list))
            .route("/watch/play/0", get(watch))
            .route("/steer", post(steer))
            .layer(axum::extract::DefaultBodyLimit::max(MESSAGE))
            .with_state(self)
            .layer(middleware::from_fn(same_machine))
    }
}

async fn list(State(play): State<Arc<PlayedEnvironment>>) -> Response {
    let ranges = play.task.command_ranges().unwrap_or_default();
    let axes = ranges.map(|[low, high]| low < high);
    let (keys, task) = (keys(&ranges), play.task.spec().id);
    json(&value!([{"name": "play", "task": task, "envs": 1, "steered": true, "keys": keys, "axes": axes}]))
}

/// The command in the range [`low`, `high`] that is nearest to standing still.
pub fn resting([low, high]: [f64; 2]) -> f64 {
    if low > 0.0 { low } else { high.min(0.0) }
}

/// What the keys do, for ranges of speeds forward, to the left [m/s] and yaw [rad/s]. Keys without an effect are left
/// out.
fn keys(ranges: &[[f64; 2]; 3]) -> String {
    let [forward, aside, turn] = ranges;
    let number = |x: f64| format!("{}", (x * 100.0).round() / 100.0).replace('-', "−");
    let part = |[low, high]: [f64; 2], keys: [&str; 2], does: [&str; 2], unit: &str| {
        let rest = resting([low, high]);
        let has = [high > rest, low < rest];
        let of = |words: [&str; 2], and: &str| match has {
            [true, true] => words.join(and),
            [true, false] => words[0].to_owned(),
            _ => words[1].to_owned(),
        };
        let range = format!("{}: {}, {} to {} {unit}", of(keys, " "), of(does, " and "), number(low), number(high));
        let still = if rest == 0.0 { String::new() } else { format!(" (without a key {})", number(rest)) };
        has.contains(&true).then(|| range + &still)
    };
    let parts = [
        part(*forward, ["↑", "↓"], ["forward", "back"], "m/s"),
        part(*turn, ["←", "→"], ["turn left", "right"], "rad/s"),
        part(*aside, ["Shift ←", "Shift →"], ["to the left", "right"], "m/s"),
    ];
    let parts: Vec<_> = parts.into_iter().flatten().collect();
    match parts[..] {
        [] => "The policy was trained with one command only.".into(),
        _ => format!("{}. Or a gamepad, or the sticks on a touch screen.", parts.join("; ")),
    }
}

/// A watcher without the key gives way to others, so that strangers lock nobody out.
async fn watch(State(play): State<Arc<PlayedEnvironment>>, headers: HeaderMap) -> Response {
    let start = (play.frames.subscribe(), Bytes::new());
    let blocks = stream::unfold(start, |(mut frames, mut head)| async move {
        let block = next_blocks(&mut frames, &mut head).await?;
        Some((Ok::<_, Infallible>(block), (frames, head)))
    });
    let mut answer = recording(Body::from_stream(blocks));
    if !play.admits(&headers) {
        answer.extensions_mut().insert(connections::GivesWay);
    }
    answer
}

/// A JSON list of three shares from −1 to 1.
async fn steer(State(play): State<Arc<PlayedEnvironment>>, headers: HeaderMap, body: Bytes) -> Response {
    if !play.admits(&headers) {
        return (
            StatusCode::UNAUTHORIZED,
            "open this page by the address that sandgait play printed; it has the key\n",
        )
            .into_response();
    }
    match serde_json::from_slice::<[f64; 3]>(&body) {
        Ok(command) if command.iter().all(|c| (-1.0..=1.0).contains(c)) => {
            *play.command.lock() = command;
            StatusCode::NO_CONTENT.into_response()
        }
        _ => (StatusCode::BAD_REQUEST, "expected three numbers from -1 to 1\n").into_response(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_keys_with_an_effect_are_named() {
        let [none, both] = [[0.0, 0.0], [-1.0, 1.5]];
        for (ranges, said) in [
            (
                [[0.1, 0.4], none, none],
                "↑: forward, 0.1 to 0.4 m/s (without a key 0.1). Or a gamepad, or the sticks on a touch screen.",
            ),
            ([[-0.2, 0.0], none, none], "↓: back, −0.2 to 0 m/s. Or a gamepad, or the sticks on a touch screen."),
            (
                [both, [-0.5, 0.5], both],
                "↑ ↓: forward and back, −1 to 1.5 m/s; ← →: turn left and right, −1 to 1.5 rad/s; \
                 Shift ← Shift →: to the left and right, −0.5 to 0.5 m/s. Or a gamepad, or the sticks on a touch screen.",
            ),
            ([[0.3, 0.3], none, none], "The policy was trained with one command only."),
        ] {
            assert_eq!(keys(&ranges), said);
        }
    }
    use crate::env::registry::Blueprint;
    use axum::http::Request;
    use tower_service::Service as _;

    /// Connections whose requests never come to their end do not keep others out.
    #[tokio::test]
    async fn unfinished_requests_make_room() {
        use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
        let blueprint = Blueprint::new("sandgait/HexapodGait-v1", serde_json::Value::Null).unwrap();
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let stop = CancellationToken::new();
        tokio::spawn(PlayedEnvironment::new(blueprint.task, "secret").serve(listener, stop.clone()));
        let connect = async |request: &str| {
            let mut stream = tokio::net::TcpStream::connect(address).await.unwrap();
            stream.write_all(request.as_bytes()).await.unwrap();
            stream
        };
        let mut unfinished = Vec::new();
        for k in 0..2 * MOST {
            let head = "POST /steer HTTP/1.1\r\nhost: localhost\r\nauthorization: Bearer secret\r\n";
            let body = if k % 2 == 0 { "content-length: 9\r\n\r\n[1, " } else { "" };
            unfinished.push(connect(&format!("{head}{body}")).await);
        }
        tokio::time::sleep(std::time::Duration::from_millis(200)).await;
        let mut stream = connect("GET /sessions HTTP/1.1\r\nhost: localhost\r\n\r\n").await;
        let mut answer = String::new();
        let read = tokio::time::timeout(std::time::Duration::from_secs(5), stream.read_to_string(&mut answer));
        read.await.expect("an answer").unwrap();
        assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
        stop.cancel();
    }

    /// Finished requests for the picture, without the key, make room for viewers with the key.
    #[tokio::test]
    async fn strangers_who_watch_make_room() {
        use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
        let blueprint = Blueprint::new("sandgait/HexapodGait-v1", serde_json::Value::Null).unwrap();
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let (address, stop) = (listener.local_addr().unwrap(), CancellationToken::new());
        tokio::spawn(PlayedEnvironment::new(blueprint.task, "secret").serve(listener, stop.clone()));
        let watch = async |key: &str| {
            let mut stream = tokio::net::TcpStream::connect(address).await.unwrap();
            let head = format!("GET /watch/play/0 HTTP/1.1\r\nhost: localhost\r\nauthorization: Bearer {key}\r\n\r\n");
            stream.write_all(head.as_bytes()).await.unwrap();
            let mut start = [0; 12];
            let read = tokio::time::timeout(std::time::Duration::from_secs(5), stream.read_exact(&mut start)).await;
            let answered = matches!(read, Ok(Ok(_))) && start.ends_with(b"200");
            (stream, answered)
        };
        let (_own, answered) = watch("secret").await;
        assert!(answered);
        let mut strangers = Vec::new();
        for _ in 0..2 * MOST {
            strangers.push(watch("").await);
        }
        let (_late, answered) = watch("secret").await;
        assert!(answered, "a viewer with the key finds a place");
        stop.cancel();
    }

    /// Only a message with the key and three numbers changes the command; requests with the name of another site are
    /// refused.
    #[tokio::test]
    async fn steering_needs_the_key() {
        let blueprint = Blueprint::new("sandgait/HexapodGait-v1", serde_json::Value::Null).unwrap();
        let play = PlayedEnvironment::new(blueprint.task, "secret");
        let send = |key: &'static str, host: &'static str, body: &'static str| {
            let mut routes = play.clone().routes();
            let request = Request::post("/steer").header("host", host).header("authorization", format!("Bearer {key}"));
            let request = request.body(Body::from(body)).unwrap();
            async move { routes.call(request).await.unwrap().status().as_u16() }
        };
        assert_eq!(send("wrong", "127.0.0.1:1", "[1, 0, 0]").await, 401);
        assert_eq!(send("secret", "evil.example", "[1, 0, 0]").await, 403);
        assert_eq!(play.command(), [0.0; 3]);
        assert_eq!(send("secret", "127.0.0.1:1", "[0.5, 0, -1]").await, 204);
        assert_eq!(play.command(), [0.5, 0.0, -1.0]);
        for wrong in ["[2, 0, 0]", "[1, 0]", "{}", "[null, 0, 0]"] {
            assert_eq!(send("secret", "127.0.0.1:1", wrong).await, 400, "{wrong}");
        }
        assert_eq!(play.command(), [0.5, 0.0, -1.0]);
    }
}
