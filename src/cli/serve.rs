//! `sandgait serve`

use super::signals::StopSignals;
use sandgait::service::{self, Address, Limits, Listener, Seal, ServerSetup, StateDir, Tls, Token};
use sandgait::{Error, Result};
use std::io::{IsTerminal as _, Read as _, Write as _};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::time::Duration;
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;
use tracing_subscriber::filter::Targets;
use tracing_subscriber::layer::SubscriberExt as _;
use tracing_subscriber::util::SubscriberInitExt as _;

/// Number of blocking threads beyond one for each processor: one for a study, and one so that large requests do not
/// delay small ones. (The other blocking threads create and free environments and check large requests.) Blocking
/// threads compute and never wait, so more of them would compete for the processors, and each thread needs memory
/// (tokio's default is 512).
const SPARE_THREADS: usize = 2;

/// Longest time by which a request in preparation delays the end of the process: our choice, because the server ends
/// within 5 s and saves sessions for 4 s of them.
const GRACE: Duration = Duration::from_millis(500);

/// Serve environments over gRPC until SIGTERM or Ctrl-C.
///
/// Prints one line, "listening on ADDRESS", when clients can connect. See docs/serving.md.
#[derive(clap::Args)]
#[command(
    args_override_self = true,
    after_help = "Examples:
  sandgait serve --listen unix:/tmp/sand.sock
  sandgait serve --listen 127.0.0.1:0 --threads 8      (any free port; the printed line has its number)
  sandgait serve --viewer 127.0.0.1:8080               (watch in a browser)
  sandgait serve --listen 0.0.0.0:50051 --tls-cert server.pem --tls-key server.key --token-file token
  sandgait serve --listen 0.0.0.0:50051 --insecure     (anyone who can reach this port can use the server)"
)]
pub struct ServeArgs {
    /// Address: HOST:PORT or unix:PATH (a socket that only its owner can use)
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:50051")]
    listen: Address,
    /// Number of simulating threads; 0: one for each processor
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = super::whole::<u16>(0..=super::MOST_THREADS))]
    threads: u16,
    /// Also serve DeepMind's protocol dm_env_rpc at the same address
    #[arg(long)]
    dm_env_rpc: bool,
    /// TOML file with options by their long names; options of the command line take precedence
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    #[command(flatten)]
    security: Security,
    #[command(flatten)]
    session_limits: SessionLimits,
    #[command(flatten)]
    pages: Pages,
    /// Format of the log on stderr; the variable SANDGAIT_LOG sets its filter
    #[arg(long, value_name = "FORMAT", default_value = "text")]
    log_format: LogFormat,
    /// Directory for sessions: at SIGTERM the server saves them, at the next start it restores them
    #[arg(long, value_name = "DIR")]
    state_dir: Option<PathBuf>,
    /// Also stop when stdin is closed, for example because the process that started this one has ended
    #[arg(long)]
    exit_on_stdin_close: bool,
}

/// Access to the server.
#[derive(clap::Args)]
struct Security {
    /// The server's certificate (PEM), for encryption
    #[arg(long, value_name = "FILE")]
    tls_cert: Option<PathBuf>,
    /// The private key of the server's certificate (PEM)
    #[arg(long, value_name = "FILE")]
    tls_key: Option<PathBuf>,
    /// Encrypt with a certificate that is made for this run, and write it to this file (PEM), so that clients can trust
    /// it
    #[arg(long, value_name = "FILE", conflicts_with = "tls_cert")]
    tls_self_signed: Option<PathBuf>,
    /// Clients must have certificates of this authority (PEM)
    #[arg(long, value_name = "FILE")]
    client_ca: Option<PathBuf>,
    /// Clients must send the token in this file
    #[arg(long, value_name = "FILE")]
    token_file: Option<PathBuf>,
    /// Authenticate snapshots and saved sessions with the key in this file, and refuse all others
    #[arg(long, value_name = "FILE")]
    snapshot_key: Option<PathBuf>,
    /// Allow other machines to reach the address of --listen without encryption and token
    #[arg(long)]
    insecure: bool,
}

/// Pages without encryption and token.
#[derive(clap::Args)]
struct Pages {
    /// Address that answers GET /metrics for Prometheus
    #[arg(long, value_name = "HOST:PORT")]
    metrics: Option<Address>,
    /// Allow other machines to reach the address of --metrics
    #[arg(long)]
    metrics_insecure: bool,
    /// Address at which browsers see the sessions live: http://HOST:PORT
    #[arg(long, value_name = "HOST:PORT")]
    viewer: Option<Address>,
    /// Allow other machines to reach the address of --viewer
    #[arg(long)]
    viewer_insecure: bool,
    /// Largest number of simultaneous streams of the live page
    #[arg(long, value_name = "N", default_value_t = LIMITS.watchers as u32, value_parser = super::whole::<u32>(1..=u32::MAX.into()))]
    max_watchers: u32,
}

/// The default limits, in the units of the options.
const LIMITS: Limits = Limits::DEFAULT;

/// Limits of sessions, memory and connections.
#[derive(clap::Args)]
struct SessionLimits {
    /// Largest number of sessions
    #[arg(long, value_name = "N", default_value_t = LIMITS.sessions as u32, value_parser = super::whole::<u32>(1..=u32::MAX.into()))]
    max_sessions: u32,
    /// Largest number of environments of one session
    #[arg(long, value_name = "N", default_value_t = LIMITS.environments as u32, value_parser = super::whole::<u32>(1..=u32::MAX.into()))]
    max_envs: u32,
    /// Largest memory of all environments (estimated) and large requests together [MiB]
    #[arg(long, value_name = "MIB", default_value_t = (LIMITS.memory >> 20) as u32, value_parser = super::whole::<u32>(1..=u32::MAX.into()))]
    max_memory_mib: u32,
    /// Largest size of a request [MiB]
    #[arg(long, value_name = "MIB", default_value_t = (LIMITS.request >> 20) as u32, value_parser = super::whole::<u32>(1..=4095))]
    max_message_mib: u32,
    /// The server frees a session that has been without a client for this time [s]
    #[arg(long, value_name = "S", default_value_t = LIMITS.lease.as_secs() as u32, value_parser = super::whole::<u32>(1..=u32::MAX.into()))]
    lease_seconds: u32,
    /// Largest number of connections; lower if there are not enough file descriptors
    #[arg(long, value_name = "N", default_value_t = LIMITS.connections, value_parser = super::whole::<u32>(1..=u32::MAX.into()))]
    max_connections: u32,
    /// Largest number of simultaneous calls on one connection; further calls wait
    #[arg(long, value_name = "N", default_value_t = LIMITS.streams, value_parser = super::whole::<u32>(1..=u32::MAX.into()))]
    max_streams: u32,
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum LogFormat {
    Text,
    Json,
}

impl ServeArgs {
    pub fn run(self) -> Result<String> {
        self.security.check(&self.listen)?;
        let pages = &self.pages;
        let plain = |name: &'static str, address: &Option<Address>, open: bool| {
            address.as_ref().map(|a| plain_address(name, a, open)).transpose()
        };
        let metrics = plain("--metrics", &pages.metrics, pages.metrics_insecure)?;
        let viewer = plain("--viewer", &pages.viewer, pages.viewer_insecure)?;
        self.log_format.start();
        let mut setup = self.security.setup(&self.listen)?;
        setup.threads = self.threads.into();
        setup.limits = self.limits();
        setup.others = self.dm_env_rpc.then(dm_env_rpc).transpose()?;
        setup.state = self.state_dir.as_deref().map(StateDir::new).transpose()?;
        let Security { token_file, tls_key, snapshot_key, .. } = &self.security;
        let secrets = [token_file, tls_key, snapshot_key, &self.state_dir];
        let open = setup.tls.is_none() || setup.token.is_none();
        if open && !self.listen.is_local() {
            tracing::warn!(listen = %self.listen, "other machines can reach this server without encryption or token, because of --insecure");
        }
        secrets.into_iter().flatten().for_each(|path| service::warn_if_shared(path));
        let beside = sandgait::parallel::processors() + SPARE_THREADS;
        let runtime = tokio::runtime::Builder::new_multi_thread().max_blocking_threads(beside).enable_all().build();
        let runtime = runtime.map_err(|e| Error::Exhausted(format!("cannot start threads: {e}")))?;
        let served = runtime.block_on(self.serve(setup, metrics, viewer));
        runtime.shutdown_timeout(GRACE);
        served.map(|()| String::new())
    }

    fn limits(&self) -> Limits {
        let given = &self.session_limits;
        Limits {
            sessions: given.max_sessions as usize,
            environments: given.max_envs as usize,
            memory: (given.max_memory_mib as usize) << 20,
            lease: Duration::from_secs(given.lease_seconds.into()),
            request: (given.max_message_mib as usize) << 20,
            connections: given.max_connections,
            streams: given.max_streams,
            watchers: self.pages.max_watchers as usize,
            ..LIMITS
        }
    }

    /// The log's first lines: who may come, and how much they may use.
    fn introduce(&self, setup: &ServerSetup, address: &str) {
        let security = &self.security;
        let tls = match (&setup.tls, &security.tls_self_signed, &security.client_ca) {
            (None, ..) => "none",
            (_, Some(_), _) => "self-signed",
            (.., Some(_)) => "with certificates of clients",
            _ => "yes",
        };
        let token = if setup.token.is_some() { "needed" } else { "none" };
        let version = env!("CARGO_PKG_VERSION");
        tracing::info!(version, address, tls, token, "this server");
        let Limits { sessions, environments, connections, streams, .. } = setup.limits;
        let [memory_mib, request_mib] = [setup.limits.memory, setup.limits.request].map(|bytes| bytes >> 20);
        let lease_s = setup.limits.lease.as_secs();
        let threads = if self.threads == 0 { sandgait::parallel::processors() } else { self.threads.into() };
        tracing::info!(
            sessions,
            environments,
            memory_mib,
            request_mib,
            lease_s,
            connections,
            streams,
            threads,
            "its limits"
        );
    }

    async fn serve(
        self,
        mut setup: ServerSetup,
        metrics: Option<SocketAddr>,
        viewer: Option<SocketAddr>,
    ) -> Result<()> {
        let stop = CancellationToken::new();
        on_signals(&stop, self.state_dir.as_deref())?;
        let listener = Listener::bind(&self.listen).await?;
        if let Some(address) = metrics {
            let (listener, address) = bind_plain("--metrics", address)?;
            tracing::info!(%address, "metrics are at /metrics");
            setup.metrics = Some(listener);
        }
        if let Some(address) = viewer {
            let (listener, address) = bind_plain("--viewer", address)?;
            tracing::info!("browsers see the sessions at http://{address}");
            setup.viewer = Some(listener);
        }
        let address = listener.address()?;
        self.introduce(&setup, &address.to_string());
        let line = format!("listening on {address}\n");
        let mut out = std::io::stdout();
        // The process that started this server may have closed its output.
        let _ = out.write_all(line.as_bytes()).and_then(|()| out.flush());
        if self.exit_on_stdin_close {
            stop_with_stdin(stop.clone());
        }
        service::serve(listener, setup, stop).await
    }
}

#[cfg(feature = "dm-env-rpc")]
fn dm_env_rpc() -> Result<service::AddServices> {
    Ok(sandgait_dm_env_rpc::service())
}

#[cfg(not(feature = "dm-env-rpc"))]
fn dm_env_rpc() -> Result<service::AddServices> {
    Err(Error::invalid("--dm-env-rpc", "this sandgait was built without the feature dm-env-rpc"))
}

impl Security {
    /// Refuses unsafe addresses unless the user allows them.
    fn check(&self, listen: &Address) -> Result<()> {
        let missing = |name: &str| Err(Error::invalid(name, "missing; TLS needs a certificate and its key"));
        let local =
            |option| Err(Error::invalid(option, format!("{listen} can only be used by its owner and needs no TLS")));
        match (&self.tls_cert, &self.tls_key) {
            (Some(_), None) => return missing("--tls-key"),
            (None, Some(_)) => return missing("--tls-cert"),
            (None, None) if self.client_ca.is_some() => return missing("--tls-cert"),
            (Some(_), _) if matches!(listen, Address::Unix(_)) => return local("--tls-cert"),
            _ => {}
        }
        match (&self.tls_self_signed, listen) {
            (Some(_), Address::Unix(_)) => return local("--tls-self-signed"),
            (Some(_), Address::Tcp(address)) if address.ip().is_unspecified() => {
                let reason = format!("{listen} is not an address that clients can connect to; listen on another");
                return Err(Error::invalid("--tls-self-signed", reason));
            }
            _ => {}
        }
        let encrypted = self.tls_cert.as_ref().or(self.tls_self_signed.as_ref());
        let lacking = [("--tls-cert and --tls-key", encrypted), ("--token-file", self.token_file.as_ref())];
        let lacking: Vec<_> = lacking.iter().filter(|(_, given)| given.is_none()).map(|(name, _)| *name).collect();
        if listen.is_local() || self.insecure || lacking.is_empty() {
            return Ok(());
        }
        let reason = format!(
            "{listen} can be reached from other machines; add {}, or --insecure to allow that",
            lacking.join(" and ")
        );
        Err(Error::invalid("--listen", reason))
    }

    fn setup(&self, listen: &Address) -> Result<ServerSetup> {
        let tls = match (&self.tls_cert, &self.tls_key, &self.tls_self_signed, listen) {
            (Some(certificate), Some(key), ..) => Some(Tls::load(certificate, key, self.client_ca.as_deref())?),
            (.., Some(path), Address::Tcp(address)) => {
                let (tls, certificate) = Tls::self_signed(address.ip())?;
                std::fs::write(path, certificate).map_err(|e| Error::unwritten(path, &e))?;
                Some(tls)
            }
            _ => None,
        };
        let token = self.token_file.as_deref().map(Token::load).transpose()?;
        let seal = self.snapshot_key.as_deref().map(Seal::load).transpose()?.unwrap_or_default();
        Ok(ServerSetup { tls, token, seal, ..ServerSetup::default() })
    }
}

/// Metrics and the live page have neither encryption nor token.
fn plain_address(name: &str, address: &Address, open: bool) -> Result<SocketAddr> {
    let Address::Tcp(tcp) = address else {
        return Err(Error::invalid(name, format!("{address} is not HOST:PORT")));
    };
    if !address.is_local() && !open {
        let reason = "can be reached from other machines without encryption or token; add";
        return Err(Error::invalid(name, format!("{address} {reason} {name}-insecure to allow that")));
    }
    Ok(*tcp)
}

/// A listener, and its address with the actual port if port 0 was given.
fn bind_plain(name: &str, address: SocketAddr) -> Result<(TcpListener, SocketAddr)> {
    let unusable = |e: std::io::Error| Error::invalid(name, format!("{address}: {e}"));
    let listener = service::bind_tcp(address).map_err(unusable)?;
    let address = listener.local_addr().map_err(unusable)?;
    Ok((listener, address))
}

impl LogFormat {
    fn start(self) {
        let asked = std::env::var("SANDGAIT_LOG").ok().and_then(|text| text.parse().ok());
        let least = if super::progress::is_silent() { tracing::Level::WARN } else { tracing::Level::INFO };
        let filter = asked.unwrap_or_else(|| Targets::new().with_default(least));
        let log = tracing_subscriber::registry().with(filter);
        let lines = tracing_subscriber::fmt::layer().with_writer(std::io::stderr);
        match self {
            Self::Text => {
                // As https://no-color.org says.
                let plain = std::env::var_os("NO_COLOR").is_some_and(|value| !value.is_empty());
                log.with(lines.with_ansi(!plain && std::io::stderr().is_terminal())).init();
            }
            Self::Json => log.with(lines.json()).init(),
        }
    }
}

/// `state`: the folder in which sessions are saved.
fn on_signals(stop: &CancellationToken, state: Option<&Path>) -> Result<()> {
    let mut signals = StopSignals::new().map_err(|e| Error::Exhausted(format!("cannot listen for signals: {e}")))?;
    let stop = stop.clone();
    let state = state.map(|folder| folder.display().to_string());
    tokio::spawn(async move {
        let signal = signals.next().await;
        match state {
            Some(folder) => tracing::info!(signal, folder, "this server stops and saves its sessions"),
            None => tracing::info!(signal, "this server stops; without --state-dir its sessions are not saved"),
        }
        stop.cancel();
        // Later signals are heard and change nothing.
        std::future::pending::<()>().await;
    });
    Ok(())
}

/// Reads stdin in a separate thread, because the read cannot be interrupted when the server stops for another reason.
fn stop_with_stdin(stop: CancellationToken) {
    std::thread::spawn(move || {
        let mut stdin = std::io::stdin().lock();
        while stdin.read(&mut [0; 64]).is_ok_and(|n| n > 0) {}
        stop.cancel();
    });
}
