//! Drives a stream's connection while no caller waits for an answer.

use parking_lot::{Condvar, Mutex};
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::runtime::Runtime;

/// After this time without a caller, the keeper drives the connection: our choice, much less than the server's time
/// limit for pings.
const IDLE: Duration = Duration::from_secs(1);

/// Length of one turn of driving: our choice. Shorter turns wake the thread more often; after longer turns it notices
/// later that a caller drives the connection.
const SLICE: Duration = Duration::from_millis(20);

struct ConnectionUse {
    used: Instant,
    /// A request was sent, and no caller waits for its answer yet.
    ahead: bool,
    closed: bool,
}

/// Tells the keeper how a connection is used.
pub struct Keeper(Arc<(Mutex<ConnectionUse>, Condvar)>);

impl Keeper {
    pub fn new(runtime: Arc<Runtime>) -> std::io::Result<Self> {
        let state = ConnectionUse { used: Instant::now(), ahead: false, closed: false };
        let shared = Arc::new((Mutex::new(state), Condvar::new()));
        let own = shared.clone();
        std::thread::Builder::new().name("sandgait-wire".into()).spawn(move || keep(&own, &runtime))?;
        Ok(Self(shared))
    }

    /// Something was sent, and the caller does not wait for its answer now.
    pub fn ahead(&self) {
        self.0.0.lock().ahead = true;
        self.0.1.notify_one();
    }

    /// The caller waits, and drives the connection itself.
    pub fn waits(&self) {
        let mut state = self.0.0.lock();
        (state.ahead, state.used) = (false, Instant::now());
    }
}

impl Drop for Keeper {
    fn drop(&mut self) {
        self.0.0.lock().closed = true;
        self.0.1.notify_one();
    }
}

fn keep(shared: &(Mutex<ConnectionUse>, Condvar), runtime: &Runtime) {
    let mut state = shared.0.lock();
    while !state.closed {
        let idle = state.used.elapsed();
        if state.ahead || idle >= IDLE {
            drop(state);
            runtime.block_on(async { tokio::time::sleep(SLICE).await });
            state = shared.0.lock();
        } else {
            shared.1.wait_for(&mut state, IDLE - idle);
        }
    }
}
