//! `sandgait play`

use super::{OptionArgs, say};
use sandgait::env::Shard;
use sandgait::env::Task;
use sandgait::env::gait::HexapodGait;
use sandgait::env::legged::LeggedVelocity;
use sandgait::env::registry::{Blueprint, task_id};
use sandgait::policy::{self, Network};
use sandgait::service::{Address, PlayedEnvironment, bind_tcp, resting};
use sandgait::study::trained::{TrainedTask, policy_file};
use sandgait::{Error, Result, files};
use serde_json::{Value, json};
use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::path::Path;
use std::time::{Duration, Instant};
use tokio_util::sync::CancellationToken;

/// Walk a robot with the arrow keys, in a browser on this machine or, with --listen, on a phone.
///
/// POLICY is the folder of `sandgait train`, its ONNX file with settings.json beside it, or the task HexapodGait, whose policy is part of this
/// program. Up and down: forward and back; left and right: turn; with Shift: to the side. A gamepad's sticks do the same, and on a touch screen the page has sticks. A
/// policy follows only the commands of its training: that of HexapodGait walks forward at 0.1 to 0.4 m/s and does not turn,
/// and without a key it walks at 0.1 m/s. The page names the keys that have an effect. The address that is printed has the key
/// that steering needs. Ctrl-C ends it.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  sandgait play HexapodGait
  sandgait play runs/go1
  sandgait play runs/go1 --option ground=rigid --no-browser
  sandgait play HexapodGait --listen 0.0.0.0:8080      (a phone in the same network can steer)")]
pub struct PlayArgs {
    /// Folder of a training, FILE.onnx, or HexapodGait
    policy: String,
    #[command(flatten)]
    options: OptionArgs,
    /// Port of the page; 0: any free one
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = super::whole::<u16>(0..=u16::MAX.into()))]
    port: u16,
    /// Address of the page, in place of one that only this machine can reach; port 0: any free one. Other machines see
    /// the robot, and those that have the whole address steer it. Nothing is encrypted
    #[arg(long, value_name = "HOST:PORT", conflicts_with = "port")]
    listen: Option<Address>,
    /// Do not open a browser
    #[arg(long)]
    no_browser: bool,
    /// End after this time [s]
    #[arg(long, value_name = "S", hide = true)]
    seconds: Option<f64>,
}

/// The policy that this program contains: the policy in `examples/policies/HexapodGait-ppo`.
const HEXAPOD: &[u8] = include_bytes!("../../examples/policies/HexapodGait-ppo/policy.onnx");
const HEXAPOD_SETTINGS: &str = include_str!("../../examples/policies/HexapodGait-ppo/settings.json");

/// Control steps of an episode: our choice, an hour.
const STEPS: u32 = 180_000;

impl PlayArgs {
    pub fn run(self) -> Result<String> {
        let (onnx, trained) = self.read()?;
        let (blueprint, network) = self.prepare(&onnx, &trained)?;
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build();
        let runtime = runtime.map_err(|e| Error::Exhausted(format!("cannot start threads: {e}")))?;
        let stop = CancellationToken::new();
        let signalled = stop.clone();
        runtime.spawn(async move {
            let _ = tokio::signal::ctrl_c().await;
            signalled.cancel();
        });
        let key = format!("{:032x}", rand::random::<u128>());
        let _inside = runtime.enter();
        let page = PlayedEnvironment::new(blueprint.task.clone(), &key);
        let place = self.place()?;
        let name = if self.listen.is_some() { "--listen" } else { "--port" };
        let unusable = |e: std::io::Error| Error::invalid(name, format!("{place}: {e}"));
        let listener = bind_tcp(place).map_err(unusable)?;
        let bound = listener.local_addr().map_err(unusable)?;
        if !bound.ip().is_loopback() {
            say::warning(
                "other machines can reach this page, without encryption: all of them see the robot, and those \
                 that know the address below steer it",
            );
        }
        let address = format!("http://{}/#key={key}", reached(bound));
        println!("{address}");
        runtime.spawn(page.clone().serve(listener, stop.clone()));
        if !self.no_browser {
            open(&address);
        }
        let walked = walk(&blueprint, &network, &page, self.seconds, &stop);
        stop.cancel();
        runtime.shutdown_timeout(Duration::from_secs(1));
        walked.map(|()| String::new())
    }

    fn place(&self) -> Result<SocketAddr> {
        match &self.listen {
            None => Ok(SocketAddr::from((Ipv4Addr::LOCALHOST, self.port))),
            Some(Address::Tcp(place)) => Ok(*place),
            Some(other) => Err(Error::invalid("--listen", format!("{other} is not HOST:PORT"))),
        }
    }

    /// The network's bytes, and the task and options of its training.
    fn read(&self) -> Result<(Vec<u8>, TrainedTask)> {
        if task_id(&self.policy) == HexapodGait::ID {
            let own = TrainedTask::from_settings(Path::new("settings.json"), HEXAPOD_SETTINGS.as_bytes())?;
            return Ok((HEXAPOD.to_vec(), own));
        }
        let path = policy_file(Path::new(&self.policy));
        if path.extension().is_none_or(|ending| ending != "onnx") {
            let reason = format!(
                "{:?} is neither the folder of a training, nor an .onnx file, nor HexapodGait, the task whose policy is part of this program",
                self.policy
            );
            return Err(Error::invalid("policy", reason));
        }
        let onnx = files::read(&path, policy::MOST_BYTES as u64)?;
        let missing =
            || Error::file(&path, "there is no settings.json beside it, which names the task and its options");
        Ok((onnx, TrainedTask::beside(&path)?.ok_or_else(missing)?))
    }

    /// The task, without randomness and with long episodes, and its policy.
    fn prepare(&self, onnx: &[u8], trained: &TrainedTask) -> Result<(Blueprint, Network)> {
        let (task, mut options) = (trained.id.as_str(), trained.options(&self.options, super::read_files)?);
        options["max_episode_steps"] = json!(STEPS);
        if task == LeggedVelocity::ID {
            options["domain_rand"] = Value::Null;
            options["curriculum"] = Value::Null;
        }
        let blueprint = Blueprint::new(task, options)?;
        if blueprint.task.command_ranges().is_none() {
            return Err(Error::invalid("policy", format!("{task} has no commands to steer by")));
        }
        let network = Network::new(onnx, blueprint.task.spec())?;
        Ok((blueprint, network))
    }
}

/// Steps one environment in real time, under the page's commands, until `stop` is cancelled or `seconds` are over.
fn walk(
    blueprint: &Blueprint,
    network: &Network,
    page: &PlayedEnvironment,
    seconds: Option<f64>,
    stop: &CancellationToken,
) -> Result<()> {
    let Some(ranges) = blueprint.task.command_ranges() else { return Ok(()) };
    let mut shard = Shard::new(blueprint, 1)?;
    shard.reset(|_| true, Some(&[0]), |_| None);
    let mut action = vec![0.0; shard.actions()];
    let period = Duration::from_secs_f64(1.0 / blueprint.task.spec().control_rate);
    let (start, mut due) = (Instant::now(), Instant::now());
    while !stop.is_cancelled() && seconds.is_none_or(|s| start.elapsed().as_secs_f64() < s) {
        let shares = page.command();
        shard.set_command(0, std::array::from_fn(|k| commanded(ranges[k], shares[k])));
        network.act(&shard.rows.observations, &mut action)?;
        shard.step(&action);
        page.show(shard.look(0, false));
        due += period;
        match due.checked_duration_since(Instant::now()) {
            Some(early) => std::thread::sleep(early),
            // The machine is too slow for real time. The clock starts again, so that later steps do not hurry.
            None => due = Instant::now(),
        }
    }
    Ok(())
}

/// An address at which browsers reach a page that listens on `bound`. In place of all addresses of this machine, it is
/// the one from which the machine reaches others.
fn reached(bound: SocketAddr) -> SocketAddr {
    if !bound.ip().is_unspecified() {
        return bound;
    }
    // Nothing is sent: connecting a UDP socket only chooses the route. The addresses are reserved for documentation
    // (RFC 5737, RFC 3849).
    let own = |from: &str, to: &str| {
        let socket = UdpSocket::bind(from).ok()?;
        socket.connect(to).ok()?;
        socket.local_addr().ok().map(|own| own.ip())
    };
    let way = if bound.is_ipv4() { None } else { own("[::]:0", "[2001:db8::1]:9") };
    let way = way.or_else(|| own("0.0.0.0:0", "192.0.2.1:9"));
    SocketAddr::new(way.unwrap_or(Ipv4Addr::LOCALHOST.into()), bound.port())
}

/// The command in the range [`low`, `high`] at a share from −1 (the low end) to 1 (the high end). A share of 0 is the
/// command next to standing still that the policy was trained with.
fn commanded([low, high]: [f64; 2], share: f64) -> f64 {
    let rest = resting([low, high]);
    let end = if share < 0.0 { low } else { high };
    rest + share.abs() * (end - rest)
}

/// Opens a browser, if this machine has the usual program for it.
fn open(address: &str) {
    let program = if cfg!(target_os = "macos") { "open" } else { "xdg-open" };
    let quiet = std::process::Stdio::null;
    let _ = std::process::Command::new(program).arg(address).stdin(quiet()).stdout(quiet()).stderr(quiet()).spawn();
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A policy gets no command outside of its training.
    #[test]
    fn commands_stay_in_the_ranges_of_the_training() {
        let at = |range| [-1.0, 0.0, 0.5, 1.0].map(|share| commanded(range, share));
        assert_eq!(at([0.25, 0.75]), [0.25, 0.25, 0.5, 0.75]);
        assert_eq!(at([0.0, 0.0]), [0.0; 4]);
        assert_eq!(at([-1.0, 2.0]), [-1.0, 0.0, 1.0, 2.0]);
        assert_eq!(at([-0.75, -0.25]), [-0.75, -0.25, -0.25, -0.25]);
    }
}
