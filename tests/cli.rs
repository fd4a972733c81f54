//! The command line: names, keys, columns and exit codes. Wrong use gives one line on stderr and writes no file.

use std::io::{BufRead as _, BufReader};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

fn sandgait(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_sandgait")).args(arguments).output().unwrap()
}

fn text(arguments: &[&str]) -> String {
    let output = sandgait(arguments);
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

fn json(arguments: &[&str]) -> serde_json::Value {
    serde_json::from_str(&text(arguments)).unwrap()
}

/// Exit code 2, nothing on stdout, one line on stderr that contains `words`.
fn refused(arguments: &[&str], words: &[&str]) {
    let output = sandgait(arguments);
    let line = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(2), "{arguments:?}: {line}");
    assert!(output.stdout.is_empty() && line.ends_with('\n') && line.lines().count() == 1, "{arguments:?}: {line:?}");
    for word in words {
        assert!(line.contains(word), "{arguments:?}: {line:?} lacks {word:?}");
    }
}

#[test]
fn walk_reports_the_speed() {
    let walk = json(&["walk", "--leg", "L", "--frequency", "2", "--json"]);
    for key in ["speed", "base_height", "real_time_factor"] {
        assert!(walk[key].as_f64().is_some_and(|x| x > 0.0), "{key}: {walk}");
    }
    let stand = json(&["walk", "--leg", "revL", "--frequency", "0", "--json"]);
    assert!(stand["sink"].is_number() && stand["drift"].is_number(), "{stand}");
    assert!(text(&["walk", "--frequency", "1", "--slope-deg", "-5", "--medium", "zeta=0.4"]).contains("m/s"));
}

#[test]
fn intrude_writes_the_sweep() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("force.csv");
    text(&["intrude", "--shape", "xi=-30", "--hip-height", "0.02", "--law", "li2013", "--csv", file.to_str().unwrap()]);
    let csv = std::fs::read_to_string(file).unwrap();
    let mut lines = csv.lines();
    assert_eq!(lines.next(), Some("theta,Fx,Fz,Ty"));
    let rows: Vec<Vec<f64>> = lines.map(|l| l.split(',').map(|x| x.parse().unwrap()).collect()).collect();
    assert_eq!((rows.len(), rows[0][0], rows[350][0]), (351, -1.75, 1.75));
    assert!(rows.iter().any(|r| r[2] > 1.0));
}

#[test]
fn media_and_tasks_are_listed() {
    assert!(text(&["media"]).contains("poppy-loose") && text(&["media"]).contains("poppy-close"));
    assert_eq!(json(&["media", "--json"])[0]["name"], "poppy-loose");
    let list = text(&["tasks"]);
    assert!(list.contains("sandgait/HexapodGait-v1") && list.lines().count() < 40, "{list}");
    assert_eq!(json(&["tasks", "--json"])[0]["action"].as_array().unwrap().len(), 6);
}

/// A task has several names; its description and every table fit a terminal of 80 columns and have their units.
#[test]
fn texts_fit_a_terminal() {
    let names = ["HexapodGait", "HexapodGait-v1", "sandgait/HexapodGait-v1"].map(|name| text(&["tasks", name]));
    assert!(names.iter().all(|t| *t == names[0]) && names[0].starts_with("sandgait/HexapodGait-v1\n"));
    assert_eq!(json(&["tasks", "LeggedVelocity", "--json"])["id"], "sandgait/LeggedVelocity-v1");
    refused(
        &["tasks", "HexapodGate"],
        &["task \"HexapodGate\" is unknown; did you mean \"sandgait/HexapodGait-v1\"? known: sandgait/HexapodGait-v1"],
    );
    refused(&["tasks", "HexapodGait", "--markdown", "x"], &["--markdown"]);
    let robot = text(&["robot", "robots/sandcat.urdf"]);
    for unit in ["[kg]", "[kg·m²]", "[rad]", "[N·m]", "[rad/s]", "[N·m·s/rad]", "[N·m/rad]"] {
        assert!(robot.contains(unit), "{unit}: {robot}");
    }
    let figures =
        text(&["evaluate", "tripod:2", "--seeds", "2", "--media", "poppy-loose,poppy-close", "--slopes", "0,10"]);
    assert_eq!(figures.matches("poppy-close").count(), 6, "{figures}");
    for text in [&names[0], &text(&["tasks"]), &text(&["tasks", "LeggedVelocity"]), &robot, &figures] {
        let wide: Vec<_> = text.lines().filter(|l| l.chars().count() > 80).collect();
        assert!(wide.is_empty(), "{wide:#?}");
    }
}

/// A robot whose links all have doubtful inertias gives one warning. Links that are plausible with what is fixed to them stay.
#[test]
fn a_warning_of_a_kind_is_one_line() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("robot.urdf");
    let urdf = std::fs::read_to_string("robots/sandcat.urdf").unwrap();
    // One moment a little above the sum of the others, so that the size stays plausible.
    let doubtful = urdf.lines().map(|line| {
        let value =
            |name: &str| line.split_once(&format!("{name}=\"")).map(|(_, rest)| rest.split('"').next().unwrap());
        let (Some(x), Some(y), Some(z)) = (value("ixx"), value("iyy"), value("izz")) else {
            return format!("{line}\n");
        };
        let sum: f64 = [x, y].map(|x| x.parse::<f64>().unwrap()).iter().sum();
        format!("{}\n", line.replace(&format!("izz=\"{z}\""), &format!("izz=\"{}\"", 1.1 * sum)))
    });
    std::fs::write(&file, doubtful.collect::<String>()).unwrap();
    let option = format!("robot={}", file.display());
    let legged =
        ["bench", "--task", "sandgait/LeggedVelocity-v1", "--option", &option, "--envs", "1", "--seconds", "0.01"];
    let output = sandgait(&legged);
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success() && said.lines().count() == 1, "{said}");
    assert!(
        said.contains("9 bodies: their inertias are replaced")
            && said.contains(" and 4 more: ")
            && said.ends_with("used as it is\n"),
        "{said}"
    );
}

#[test]
fn bench_takes_the_task_options() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("sand.toml");
    let medium = sandgait::sand::Medium::named("poppy-loose").unwrap();
    let mut sand = sandgait::sand::SandDescription::plain(&medium);
    sand.mechanisms.inertial_drag = 1.0;
    std::fs::write(&file, sand.to_toml().unwrap()).unwrap();
    let sand = format!("sand={}", file.display());
    let quick = ["bench", "--envs", "4", "--repeats", "5", "--seconds", "0.001"];
    let bench = |more: &[&str]| json(&[&quick[..], &["--json"], more].concat());
    let report = bench(&["--option", &sand, "--option", "slope_deg=5", "--option", "leg=C"]);
    assert!(report["env_steps_per_second"].as_f64().is_some_and(|x| x > 0.0), "{report}");
    assert_eq!(report["options"][1], "slope_deg=5", "{report}");
    let all = bench(&["--task", "all", "--actions", "zero"]);
    assert_eq!(all.as_array().map(Vec::len), Some(sandgait::env::registry::TASK_IDS.len()), "{all}");
    assert_eq!(all[1]["actions"], "zero", "{all}");
    let unfelt = directory.path().join("unfelt.toml");
    let mut sand = sandgait::sand::SandDescription::plain(&medium);
    sand.mechanisms.added_mass = 1.0;
    std::fs::write(&unfelt, sand.to_toml().unwrap()).unwrap();
    let warned = sandgait(&[&quick[..], &["--option", &format!("sand={}", unfelt.display())]].concat());
    let said = String::from_utf8(warned.stderr).unwrap();
    assert!(warned.status.success() && said.contains("added_mass has no effect on a walking robot"), "{said:?}");
    let refuse = |more: &[&str], words: &[&str]| refused(&[&quick[..], more].concat(), words);
    refuse(&["--actions", "policy"], &["--actions", "--policy FOLDER"]);
    refuse(&["--policy", "x.onnx"], &["x.onnx"]);
    refuse(&["--policy", "x.onnx", "--actions", "zero"], &["--policy", "--actions policy"]);
    refuse(&["--actions", "policy", "--policy", "Cargo.toml"], &["policy"]);
    refuse(&["--option", "slope_deg"], &["--option", "slope_deg", "NAME=VALUE"]);
    refuse(&["--option", "slope_deg=80"], &["slope_deg", "80", "35"]);
    refuse(&["--option", "slop=1"], &["slop"]);
    let hardware = directory.path().join("hardware.toml");
    std::fs::write(&hardware, "[actuator]\ntorque_limit = { value = 0.03, interval = [0.02, 0.04] }\n").unwrap();
    let drawn = format!("domain_rand={{\"hardware\": {:?}}}", hardware.to_str().unwrap());
    let report = bench(&["--option", &format!("hardware={}", hardware.display()), "--option", &drawn]);
    assert!(report["env_steps_per_second"].as_f64().is_some_and(|x| x > 0.0), "{report}");
    refuse(&["--option", "hardware=/no/such/hardware.toml"], &["/no/such/hardware.toml"]);
    std::fs::write(&hardware, "[actuator]\npower = { value = 3.0, interval = [2.0, 4.0] }\n").unwrap();
    refuse(&["--option", &format!("hardware={}", hardware.display())], &["hardware", "actuator.power"]);
    refuse(&["--engine", "lanes", "--option", "engine=rapier"], &["--option", "engine", "twice"]);
}

#[test]
fn evaluate_prints_and_writes() {
    let directory = tempfile::tempdir().unwrap();
    let path = |name: &str| directory.path().join(name).to_str().unwrap().to_owned();
    let quick = ["evaluate", "tripod:2", "--seeds", "4", "--options", r#"{"max_episode_steps": 50}"#];
    let table = text(&[&quick[..], &["--slopes", "0,-5", "--json", &path("a.json"), "--csv", &path("a.csv")]].concat());
    for words in
        ["tripod at 2 Hz", "seeds 1000000 to 1000003", "slope [°]", "cost of transport", "poppy-loose  -5", "Wilson"]
    {
        assert!(table.contains(words), "{table:?} lacks {words}");
    }
    let read = |name| std::fs::read_to_string(directory.path().join(name)).unwrap();
    let report: serde_json::Value = serde_json::from_str(&read("a.json")).unwrap();
    assert_eq!((&report["results"][1]["slope_deg"], &report["results"][1]["episodes"]), (&(-5.0).into(), &4.0.into()));
    let csv = read("a.csv");
    assert!(
        csv.starts_with("medium,slope_deg,episodes,return,return_low,return_high,speed,") && csv.lines().count() == 3
    );
    let standing = text(&["evaluate", "standing", "--seeds", "2", "--options", r#"{"max_episode_steps": 2}"#]);
    assert!(standing.contains("standing, sandgait/HexapodGait-v1"), "{standing}");
    let refuse = |more: &[&str], words: &[&str]| refused(&[&["evaluate"], more].concat(), words);
    refuse(&["crawl", "--csv", &path("b.csv")], &["crawl", "tripod"]);
    refuse(&["tripod:9"], &["tripod", "9", "[-5, 5]"]);
    refuse(&["random", "--seeds", "0"], &["seeds", "0"]);
    refuse(&["random", "--options", "leg=C"], &["--options", "JSON"]);
    refuse(&["random", "--options", r#"{"legs": 3}"#], &["legs", "leg"]);
    refuse(&["random", "--media", "moon", "--csv", &path("b.csv")], &["moon"]);
    refuse(&["tests/data/policy_ppo.onnx", "--task", "sandgait/HexapodLegs-v1"], &["41 numbers a row", "83"]);
    refuse(&["no-such.onnx"], &["no-such.onnx"]);
    refuse(&["random", "--csv", "/no/such/folder/f.csv"], &["/no/such/folder/f.csv"]);
    assert!(!directory.path().join("b.csv").exists());
}

#[test]
fn wrong_use_is_one_line() {
    refused(&["wlak"], &["wlak", "walk"]);
    refused(&["walk"], &["--frequency"]);
    refused(&["walk", "--frequency", "two"], &["two", "--frequency"]);
    refused(&["walk", "--frequency", "NaN"], &["frequency", "NaN"]);
    refused(&["walk", "--frequency", "2", "--leg", "Q"], &["Q", "revL"]);
    refused(&["walk", "--frequency", "2", "--engine", "warp"], &["warp", "lanes", "rapier"]);
    refused(&["walk", "--frequency", "2", "--medium", "moon"], &["moon", "poppy-loose", "zeta=VALUE"]);
    refused(&["walk", "--frequency", "2", "--slope-deg", "50"], &["slope_deg", "50", "[-35, 35]"]);
    refused(&["walk", "--frequency", "2", "--robot", "no-such-file.toml"], &["no-such-file.toml"]);
    refused(&["media", "--jsno"], &["--jsno", "--json"]);
    refused(&["serve", "--listen", "nowhere"], &["nowhere", "HOST:PORT", "unix:PATH"]);
    refused(&["serve", "--listen", "0.0.0.0:0"], &["0.0.0.0:0", "--insecure"]);
}

/// Arguments that would be ignored, and gaits that do not suit a task.
#[test]
fn contradictions_are_refused() {
    let sweep = |arguments: &[&str], words: &[&str]| {
        refused(&[&["sweep", "--vary", "frequency=1:2:2", "--out", "/none/study"], arguments].concat(), words);
    };
    sweep(&["--vary", "frequency=3:4:2"], &["--vary: frequency is given already by --vary"]);
    sweep(&["--frequency", "3"], &["--vary: frequency is given already by --frequency"]);
    sweep(&["--set", "frequency=3"], &["--set: frequency is given already by --vary"]);
    sweep(&["--set", "kp=1", "--set", "kp=2"], &["--set: kp is given already by --set"]);
    sweep(&["--set", "zeta=0.3", "--medium", "poppy-close"], &["--set: zeta is given already by --medium"]);
    for option in [&["--memory"] as &[&str], &["--mu-s", "0.3"], &["--surface", "s.csv"]] {
        refused(&[&["intrude", "--shape", "L"], option].concat(), &["--shape", option[0]]);
    }
    refused(&["robot", "sandcat", "--pack", "--ground", "poppy-close"], &["--pack", "--ground"]);
    refused(&["robot", "sandcat", "--picture", "x.gif"], &["--picture: \"x.gif\" does not end with .png"]);
    let tasks = "known: sandgait/HexapodGait-v1, sandgait/HexapodRocks-v1";
    refused(&["evaluate", "tripod", "--task", "LegStroke"], &["policy: a tripod is a gait of other tasks", tasks]);
    refused(&["evaluate", "tripod", "--commands"], &["policy: it follows no commands; give FILE.onnx"]);
    refused(&["evaluate", "tripod", "--task", "Nope"], &["task \"Nope\" is unknown"]);
    let listed = ["--option", "weights=[5]", "--seconds", "0.01"];
    refused(&[&["bench"], &listed[..]].concat(), &["weights: list, expected a dictionary"]);
    assert_eq!(text(&["help", "--help"]), text(&["help"]));
}

#[test]
fn wrong_use_writes_nothing() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("force.csv");
    let csv = file.to_str().unwrap();
    refused(&["intrude", "--shape", "L", "--law", "newton", "--csv", csv], &["newton", "li2013"]);
    refused(&["intrude", "--shape", "xi=95", "--csv", csv], &["95", "90"]);
    refused(&["intrude", "--shape", "L", "--chord", "-1", "--csv", csv], &["-1"]);
    assert!(!file.exists());
    refused(&["intrude", "--shape", "L", "--csv", "/no/such/folder/f.csv"], &["/no/such/folder/f.csv"]);
}

#[test]
fn help_has_examples() {
    assert!(text(&["--help"]).contains("Examples:"));
    for command in ["serve", "walk", "intrude", "evaluate"] {
        assert!(text(&[command, "--help"]).contains("Examples:"), "{command}");
    }
    // A newcomer types the name of the program.
    assert!(text(&[]).contains("Examples:") && text(&[]).contains("diagnose"));
    assert!(text(&["--version"]).contains(env!("CARGO_PKG_VERSION")));
}

#[test]
fn shells_complete_commands_and_options() {
    for shell in ["bash", "zsh", "fish"] {
        let script = text(&["completions", shell]);
        assert!(["diagnose", "experiment", "max-memory-mib"].iter().all(|word| script.contains(word)), "{shell}");
    }
    refused(&["completions", "csh"], &["csh", "bash", "fish"]);
}

/// A server that has printed its address.
struct Served(Child);

impl Drop for Served {
    fn drop(&mut self) {
        // `kill` fails if the server has ended already.
        let _ = self.0.kill();
    }
}

impl Served {
    fn start(arguments: &[&str]) -> (Self, String) {
        let mut command = Command::new(env!("CARGO_BIN_EXE_sandgait"));
        command.arg("serve").args(arguments).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::null());
        let mut child = command.spawn().unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        (Self(child), line)
    }

    fn exit_code(mut self) -> Option<i32> {
        let start = Instant::now();
        while start.elapsed() < Duration::from_secs(5) {
            if let Some(status) = self.0.try_wait().unwrap() {
                return status.code();
            }
            std::thread::sleep(Duration::from_millis(10));
        }
        panic!("still running after 5 s");
    }

    fn terminate(&self) {
        let id = self.0.id().to_string();
        assert!(Command::new("kill").args(["-TERM", &id]).status().unwrap().success());
    }
}

#[test]
fn serve_prints_its_address_and_ends_with_a_signal() {
    let (server, line) = Served::start(&["--listen", "127.0.0.1:0"]);
    let address = line.trim_end().strip_prefix("listening on ").unwrap().to_owned();
    std::net::TcpStream::connect(&address).unwrap();
    server.terminate();
    assert_eq!(server.exit_code(), Some(0));
    assert!(std::net::TcpStream::connect(&address).is_err());
}

#[test]
fn serve_ends_with_its_parent() {
    let (mut server, _) = Served::start(&["--listen", "127.0.0.1:0", "--exit-on-stdin-close"]);
    drop(server.0.stdin.take());
    assert_eq!(server.exit_code(), Some(0));
}

#[test]
fn a_socket_file_belongs_to_one_server() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("sock");
    let address = format!("unix:{}", path.display());
    let (first, line) = Served::start(&["--listen", &address]);
    assert_eq!(line, format!("listening on {address}\n"));
    let second = sandgait(&["serve", "--listen", &address]);
    assert_eq!(second.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&second.stderr).contains("another server listens there"));
    first.terminate();
    assert_eq!(first.exit_code(), Some(0));
    assert!(!path.exists());
}

#[test]
fn a_stale_socket_is_replaced_and_another_file_is_not() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("sock");
    drop(std::os::unix::net::UnixListener::bind(&path).unwrap());
    let address = format!("unix:{}", path.display());
    let (server, _) = Served::start(&["--listen", &address]);
    server.terminate();
    assert_eq!(server.exit_code(), Some(0));
    std::fs::write(&path, "precious").unwrap();
    let refused = sandgait(&["serve", "--listen", &address]);
    assert_eq!(refused.status.code(), Some(1));
    assert_eq!(std::fs::read_to_string(&path).unwrap(), "precious");
}

#[test]
fn a_recorded_walk_is_replayed() {
    let directory = tempfile::tempdir().unwrap();
    let [file, page, none] = ["walk.rec", "walk.html", "none.html"].map(|n| directory.path().join(n));
    let [file, page, none] = [&file, &page, &none].map(|p| p.to_str().unwrap());
    let plain = ["walk", "--leg", "L", "--frequency", "2", "--json"];
    let speed = |arguments: &[&str]| json(arguments)["speed"].as_f64().unwrap();
    let recorded = speed(&[&plain[..], &["--record", file]].concat());
    assert_eq!(recorded, speed(&plain), "who looks changes nothing");
    let summary = &json(&["replay", file, "--json"])[0];
    assert_eq!((&summary["robot"], &summary["medium"]), (&"xplorer".into(), &"poppy-loose".into()));
    // The recording has a hundred moments a second, over 0.5 s of hold and ramp and six strides of 0.5 s. The mean
    // speed includes hold and ramp.
    assert!((350..=352).contains(&summary["moments"].as_u64().unwrap()), "{summary}");
    let mean = summary["mean_speed"].as_f64().unwrap();
    assert!(mean > 0.7 * recorded && mean < recorded, "{mean} {recorded}");
    assert!(std::fs::metadata(file).unwrap().len() < 400_000);
    text(&["replay", file, "--html", page]);
    let html = std::fs::read_to_string(page).unwrap();
    assert!(html.starts_with("<!doctype html>") && html.contains("walk.rec") && html.contains("id=\"recording\""));
    refused(&["replay", page], &["walk.html", "not one of sandgait's"]);
    refused(&["replay", page, "--html", none], &["walk.html"]);
    refused(&["replay", "/nowhere.rec"], &["/nowhere.rec"]);
    let cut = std::fs::read(file).unwrap();
    std::fs::write(file, &cut[..cut.len() / 2]).unwrap();
    refused(&["replay", file, "--html", none], &["cut off"]);
    assert!(!std::path::Path::new(none).exists());
    refused(&["walk", "--frequency", "1", "--record", "/nowhere/walk.rec"], &["/nowhere/walk.rec"]);
}

/// Colour is for terminals, and for whoever asks for it.
#[test]
fn lines_have_colour_where_it_is_asked_for() {
    let refusal = |variable: &str| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_sandgait"));
        command.args(["walk", "--leg", "L"]).env(variable, "1");
        String::from_utf8(command.output().unwrap().stderr).unwrap()
    };
    let plain = "sandgait: missing: --frequency <HZ>\n";
    assert_eq!(refusal("NO_COLOR"), plain);
    assert_eq!(refusal("CLICOLOR_FORCE"), plain.replace("sandgait:", "\u{1b}[1m\u{1b}[31msandgait:\u{1b}[0m"));
}
