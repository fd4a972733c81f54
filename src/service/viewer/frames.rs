//! Frames for watchers: the present moments of one environment, encoded once for all its watchers.
//!
//! ```text
//!  thread that stepped ──ViewedState──▶ latest ──▶ task that encodes ──ViewerFrame──▶ watchers
//!                        (copied)   (only the newest waits)       (who is slow misses some)
//! ```

use crate::env::{AnyTask, EnvView};
use crate::session::view;
use crate::sim::{Model, State};
use bytes::Bytes;
use sandgait_view::recording::{head_block, rows_block};
use std::sync::Arc;
use tokio::sync::broadcast::error::RecvError;
use tokio::sync::{broadcast, watch};

/// Largest number of frames that wait for a slow browser: our choice, about as many as come in one second.
const WAITING: usize = 64;

/// A copy of an environment's visible state.
pub struct ViewedState {
    model: Arc<Model>,
    state: State,
    footing: Vec<f64>,
    episode: (u64, u64),
    time: f64,
    action: Vec<f32>,
    reward: f32,
    info: Vec<f32>,
}

impl ViewedState {
    pub fn of(look: EnvView<'_>) -> Self {
        let state = look.whole_state();
        let EnvView { model, footing, episode, time, action, reward, info, .. } = look;
        let (model, footing, action) = (model.clone(), footing.to_vec(), action.to_vec());
        Self { model, state, footing, episode, time, action, reward, info }
    }

    /// The recording's row.
    fn row(&self) -> Vec<f32> {
        let Self { model, state, footing, time, action, reward, info, .. } = self;
        let moment = sandgait_view::RecordedState { time: *time, state, footing, action, reward: *reward, info };
        sandgait_view::row(model, &moment)
    }

    /// Do both belong to the same section of a recording?
    fn continues(&self, other: &Self) -> bool {
        self.episode == other.episode && Arc::ptr_eq(&self.model, &other.model)
    }
}

/// A moment of a recording, and the header of the section that it belongs to.
#[derive(Clone)]
pub struct ViewerFrame {
    pub head: Bytes,
    pub rows: Bytes,
}

/// The next blocks for a watcher that has the header `head`: a row, with a header before it if the header has changed.
/// A slow watcher misses some rows. None when no more frames will come.
pub async fn next_blocks(frames: &mut broadcast::Receiver<ViewerFrame>, head: &mut Bytes) -> Option<Bytes> {
    loop {
        match frames.recv().await {
            Ok(frame) if frame.head == *head => return Some(frame.rows),
            Ok(frame) => {
                *head = frame.head;
                return Some([&head[..], &frame.rows].concat().into());
            }
            Err(RecvError::Lagged(_)) => {}
            Err(RecvError::Closed) => return None,
        }
    }
}

/// Sender of moments.
pub type Latest = watch::Sender<Option<Arc<ViewedState>>>;

/// Source of frames.
pub type Frames = broadcast::Sender<ViewerFrame>;

/// Encodes moments of `task` until their sender is dropped. Needs a tokio runtime.
pub fn encode(task: Arc<dyn AnyTask>) -> (Latest, Frames) {
    let (latest, mut moments) = watch::channel(None::<Arc<ViewedState>>);
    let frames = broadcast::Sender::new(WAITING);
    // This async task does not keep the sender alive, so that receivers notice when no more frames will come.
    let weak = frames.downgrade();
    tokio::spawn(async move {
        let mut section: Option<(Arc<ViewedState>, Bytes)> = None;
        while moments.changed().await.is_ok() {
            let Some(moment) = moments.borrow_and_update().clone() else { continue };
            let head = match &section {
                Some((first, head)) if first.continues(&moment) => head.clone(),
                _ => {
                    let head = head_block(&view::header(task.spec(), &moment.model, moment.episode));
                    section.insert((moment.clone(), head.into())).1.clone()
                }
            };
            let Some(frames) = weak.upgrade() else { return };
            // The last watcher may just have left.
            let _ = frames.send(ViewerFrame { head, rows: rows_block(&moment.row()).into() });
        }
    });
    (latest, frames)
}
