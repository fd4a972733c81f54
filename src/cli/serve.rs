//! `sandgait serve`

use sandgait::service::{self, Address, Limits, Listener};
use sandgait::{Error, Result};
use std::io::{IsTerminal as _, Read as _, Write as _};
use std::time::Duration;
use tokio::signal::unix::{SignalKind, signal};
use tokio_util::sync::CancellationToken;

/// How long a request that is being prepared may hold up the end of the process.
const GRACE: Duration = Duration::from_millis(500);

/// Serve environments over gRPC until SIGTERM or Ctrl-C.
///
/// Prints one line, "listening on ADDRESS", when clients can connect.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  sandgait serve --listen unix:/tmp/sand.sock
  sandgait serve --listen 127.0.0.1:0 --threads 8      (any free port; the line printed says which)
  sandgait serve --listen 0.0.0.0:50051 --insecure     (anyone who reaches this port can use it)")]
pub struct Serve {
    /// HOST:PORT or unix:PATH (a socket only its owner can use)
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:50051")]
    listen: Address,
    /// Threads that simulate; 0: one for each processor
    #[arg(long, value_name = "N", default_value_t = 0)]
    threads: u16,
    /// Allow addresses that other machines reach, without encryption or token
    #[arg(long)]
    insecure: bool,
    /// Also speak dm_env_rpc, DeepMind's protocol, on the same address
    #[arg(long)]
    dm_env_rpc: bool,
    /// Also stop when stdin is closed, as it is when the process that started this one ends
    #[arg(long)]
    exit_on_stdin_close: bool,
}

impl Serve {
    pub fn run(self) -> Result<String> {
        if !self.listen.is_local() && !self.insecure {
            let reason = format!("{} can be reached from other machines; add --insecure to allow that", self.listen);
            return Err(Error::invalid("--listen", reason));
        }
        let filter = tracing_subscriber::EnvFilter::try_from_env("SANDGAIT_LOG").unwrap_or_else(|_| "info".into());
        let colour = std::io::stderr().is_terminal();
        tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr).with_ansi(colour).init();
        let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build();
        let runtime = runtime.map_err(|e| Error::Exhausted(format!("cannot start threads: {e}")))?;
        let served = runtime.block_on(self.serve());
        runtime.shutdown_timeout(GRACE);
        served.map(|()| String::new())
    }

    async fn serve(self) -> Result<()> {
        let stop = CancellationToken::new();
        on_signals(&stop)?;
        let listener = Listener::bind(&self.listen).await?;
        let line = format!("listening on {}\n", listener.address()?);
        let mut out = std::io::stdout();
        // Whoever started this server may not care for its output.
        let _ = out.write_all(line.as_bytes()).and_then(|()| out.flush());
        if self.exit_on_stdin_close {
            stop_with_stdin(stop.clone());
        }
        let limits = Limits { dm_env_rpc: self.dm_env_rpc, ..Limits::default() };
        service::serve(listener, self.threads.into(), limits, stop).await
    }
}

fn on_signals(stop: &CancellationToken) -> Result<()> {
    for kind in [SignalKind::terminate(), SignalKind::interrupt()] {
        let mut signal = signal(kind).map_err(|e| Error::Exhausted(format!("cannot listen for signals: {e}")))?;
        let stop = stop.clone();
        tokio::spawn(async move {
            signal.recv().await;
            stop.cancel();
        });
    }
    Ok(())
}

/// A thread of its own: a read of stdin cannot be interrupted when the server stops for another reason.
fn stop_with_stdin(stop: CancellationToken) {
    std::thread::spawn(move || {
        let mut stdin = std::io::stdin().lock();
        while stdin.read(&mut [0; 64]).is_ok_and(|n| n > 0) {}
        stop.cancel();
    });
}
