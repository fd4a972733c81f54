//! Signals that ask a program to stop: SIGTERM and SIGINT, and on Windows Ctrl-Break and Ctrl-C.

use std::io::Result;

#[cfg(unix)]
use tokio::signal::unix::{Signal, SignalKind, signal};
#[cfg(windows)]
use tokio::signal::windows::{CtrlBreak, CtrlC, ctrl_break, ctrl_c};

/// From when this exists, the signals do not end the process.
pub struct StopSignals {
    #[cfg(unix)]
    both: [Signal; 2],
    #[cfg(windows)]
    both: (CtrlBreak, CtrlC),
}

impl StopSignals {
    /// Needs a tokio runtime.
    pub fn new() -> Result<Self> {
        #[cfg(unix)]
        return Ok(Self { both: [signal(SignalKind::terminate())?, signal(SignalKind::interrupt())?] });
        #[cfg(windows)]
        return Ok(Self { both: (ctrl_break()?, ctrl_c()?) });
    }

    /// The name of the next signal.
    pub async fn next(&mut self) -> &'static str {
        #[cfg(unix)]
        let (names, [terminate, interrupt]) = (["SIGTERM", "SIGINT"], &mut self.both);
        #[cfg(windows)]
        let (names, (terminate, interrupt)) = (["Ctrl-Break", "Ctrl-C"], &mut self.both);
        tokio::select! {
            _ = terminate.recv() => names[0],
            _ = interrupt.recv() => names[1],
        }
    }
}
