//! Studies over gRPC: the same numbers and errors as on the command line, progress that only grows, and cancellation.

#[path = "answers.rs"]
mod answers;
#[path = "trials.rs"]
mod trials;

use crate::harness::Server;
use crate::{long, testbed};
use answers::{first_progress, request, whole, with_file};
use sandgait::sand::SandDescription;
use sandgait::service::Limits;
use sandgait::service::proto::study_service_client::StudyServiceClient;
use sandgait::service::proto::{File, Series, StudyRequest, StudyResult, Table};
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};
use tonic::transport::Channel;
use tonic::{Code, Status};

type Client = StudyServiceClient<Channel>;

async fn client(server: &Server) -> Client {
    Client::new(server.channel().await).max_decoding_message_size(usize::MAX)
}

/// The line on stderr of a refused command.
fn command_line(arguments: &[&str]) -> String {
    let output = Command::new(env!("CARGO_BIN_EXE_sandgait")).args(arguments).output().unwrap();
    assert_eq!(output.status.code(), Some(2), "{arguments:?}");
    String::from_utf8(output.stderr).unwrap().trim_start_matches("sandgait: ").trim_end().to_owned()
}

fn refused<T>(answer: Result<T, Status>, says: &str) {
    let status = answer.err().unwrap_or_else(|| panic!("not refused: {says}"));
    assert_eq!((status.code(), status.message()), (Code::InvalidArgument, says));
}

fn walk(frequencies: &str) -> StudyRequest {
    request("walk", &[&format!("--frequency={frequencies}")])
}

fn leg(words: &[&str]) -> StudyRequest {
    request("intrude", words)
}

/// A grid that takes minutes.
fn long_sweep() -> StudyRequest {
    request("sweep", &["--vary=xi=-75:74.5:300", "--vary=frequency=1:3.99:300"])
}

/// A diagnosis takes some 24 KiB for each row.
#[tokio::test]
async fn a_diagnosis_that_needs_more_than_the_servers_memory_is_refused() {
    let server = Server::with_limits(1, Limits { memory: 8 << 20, ..Limits::default() }).await;
    let mut client = StudyServiceClient::new(server.channel().await);
    let refused = client.study(diagnose()).await.unwrap_err();
    assert_eq!(refused.code(), Code::ResourceExhausted);
    assert!(refused.message().contains("MiB, more than this server's 8 MiB"), "{}", refused.message());
}

fn diagnosis(data: (&str, &str), experiment: (&str, &str)) -> StudyRequest {
    let call = request("diagnose", &[&format!("--experiment={}", experiment.0), "--", data.0]);
    with_file(with_file(call, data.0, data.1), experiment.0, experiment.1)
}

fn diagnose() -> StudyRequest {
    let hidden = testbed::Hidden { causes: vec![("inertial_drag", 0.4)] };
    diagnosis(("force.csv", &testbed::log(3, &hidden, 0.05).noisy), ("experiment.toml", testbed::EXPERIMENT))
}

fn column<'a>(table: &'a Table, name: &str) -> &'a Series {
    table.columns.iter().find(|c| c.name == name).unwrap()
}

fn numbers(table: &Table, name: &str) -> Vec<f64> {
    column(table, name).numbers.chunks_exact(8).map(|b| f64::from_le_bytes(b.try_into().unwrap())).collect()
}

async fn done(client: &mut Client, request: StudyRequest) -> StudyResult {
    whole(client.study(request).await.unwrap().into_inner()).await.1
}

async fn walked(client: &mut Client, request: StudyRequest) -> Table {
    done(client, request).await.tables.swap_remove(0)
}

#[tokio::test]
async fn wrong_arguments_are_refused_as_on_the_command_line() {
    let server = Server::start(1).await;
    let mut client = client(&server).await;
    let directory = tempfile::tempdir().unwrap();
    let out = directory.path().to_str().unwrap();
    for words in [
        &["intrude", "--shape=Q"] as &[&str],
        &["intrude", "--shape=xi=95"],
        &["intrude", "--shape=L", "--chord=-1"],
        &["intrude", "--shape=L", "--omega=NaN"],
        &["intrude", "--shape=L", "--medium=moon"],
        &["walk", "--frequency=2", "--law=newton"],
        &["walk", "--frequency=21"],
        &["walk", "--frequency=[]"],
        &["walk", "--frequency=2", "--slope-deg=50"],
        &["walk", "--frequency=2", "--engine=warp"],
        &["walk", "--frequency=2", "--robot=nobody"],
        &["walk", "--frequency=2", "--option=torque_limit=-1"],
        &["walk", "--frequency=2", "--option=control=torque"],
        &["sweep", "--vary=mood=1"],
        &["sweep", "--vary=xi=0,95"],
        &["sweep", "--vary=width=0.01,-1"],
        &["sweep", "--vary=xi=steep"],
        &["sweep", "--vary=xi=3", "--optimize=speed"],
        &["sweep", "--vary=xi=0,3", "--optimize=joy"],
        &["sweep", "--vary=xi=3", "--set=kp=-1"],
        &["sweep", "--vary=xi=3", "--set=xi=4"],
        &["sweep", "--vary=xi=3", "--frequency=2", "--set=frequency=4"],
        &["sweep", "--vary=zeta=0.3", "--medium=poppy-close"],
        &["evaluate", "--", "tripod", "--task=Nope"],
        &["reproduce", "--figure=6"],
    ] {
        let end = if words[0] == "sweep" { vec!["--out", out] } else { Vec::new() };
        let own: Vec<&str> = words.iter().copied().filter(|word| *word != "--").chain(end).collect();
        let mut asked: Vec<&str> = words[1..].iter().copied().filter(|word| *word != "--").collect();
        // Words without a name come last.
        asked.sort_by_key(|word| !word.starts_with("--"));
        // A request names arguments by keywords.
        let said = command_line(&own).replace("--", "");
        refused(client.study(request(words[0], &asked)).await, &said);
    }
    let thousand: Vec<String> = (0..1000).map(|i| (1.0 + 1e-3 * f64::from(i)).to_string()).collect();
    let [frequency, width] = ["frequency", "width"].map(|name| format!("--vary={name}={}", thousand.join(",")));
    let huge = request("sweep", &[&frequency, &width]);
    refused(client.study(huge).await, "number of walks: 1000000 is outside [1, 500000]");
}

#[tokio::test]
async fn requests_that_no_command_makes_are_refused() {
    let server = Server::start(1).await;
    let mut client = client(&server).await;
    let sand = format!("medium = \"poppy-loose\"\n#{}", "x".repeat(256 << 10));
    let words = vec!["--frequency=2"; 1025];
    for (request, says) in [
        (with_file(request("walk", &["--frequency=2", "--sand=s.toml"]), "s.toml", sand), "more than the 262144"),
        (request("walk", &words), "number of arguments: 1025"),
        (request("dance", &[]), "study \"dance\" is unknown; did you mean \"diagnose\"? known: walk, intrude"),
        (request("walk", &[]), "frequency: missing"),
        (request("walk", &["--frequency=fast"]), "frequency: \"fast\" is no number"),
        (request("walk", &["--frequency=2", "--help"]), "--help"),
        (request("walk", &["--frequency=2", "--csv=/tmp/x.csv"]), "--csv"),
        (request("walk", &["--frequency=2", "--sand=/etc/passwd"]), "/etc/passwd: a server reads no files"),
        (request("walk", &["--frequency=2", "--robot=/etc/passwd.toml"]), "/etc/passwd.toml: a server reads no files"),
        (request("walk", &["--frequency=2", "--option=sand=/etc/passwd"]), "sand"),
        (request("intrude", &["--shape=L", "--sand=x.toml", "--law=li2013"]), "cannot be given with"),
        (request("validate", &["--data=/etc"]), "/etc/validation.toml: a server reads no files"),
    ] {
        let status = client.study(request).await.err().unwrap_or_else(|| panic!("not refused: {says}"));
        assert_eq!(status.code(), Code::InvalidArgument, "{status}");
        assert!(status.message().contains(says) && !status.message().contains('\n'), "{says}: {status}");
    }
}

/// The status that a diagnosis ends with.
async fn failed(client: &mut Client, request: StudyRequest) -> Result<(), Status> {
    let mut stream = client.study(request).await?.into_inner();
    while stream.message().await?.is_some() {}
    Ok(())
}

#[tokio::test]
async fn wrong_data_are_refused_as_on_the_command_line() {
    let server = Server::start(1).await;
    let mut client = client(&server).await;
    let directory = tempfile::tempdir().unwrap();
    let data = testbed::log(3, &testbed::Hidden { causes: vec![("inertial_drag", 0.4)] }, 0.05).noisy;
    let spoiled = data.replacen("revL", "wheel", 1);
    let headless = data.replacen("Fx", "force", 1);
    let cases = [
        (spoiled.as_str(), testbed::EXPERIMENT),
        (headless.as_str(), testbed::EXPERIMENT),
        ("", testbed::EXPERIMENT),
        (data.as_str(), "kind = \"digging\""),
        (data.as_str(), "kind = \"intrusion\"\nmedium = \"moon\""),
    ];
    for (data, experiment) in cases {
        let [d, e] = ["force.csv", "experiment.toml"].map(|n| directory.path().join(n));
        std::fs::write(&d, data).unwrap();
        std::fs::write(&e, experiment).unwrap();
        let [d, e] = [&d, &e].map(|p| p.to_str().unwrap());
        let out = directory.path().join("out");
        let said = command_line(&["diagnose", d, "--experiment", e, "--out", out.to_str().unwrap()]);
        assert!(!out.exists(), "a folder was left");
        refused(failed(&mut client, diagnosis((d, data), (e, experiment))).await, &said);
    }
    let values = diagnosis(("force.csv", &data), ("experiment", r#"{"kind": "intrusion", "mood": "x"}"#));
    let status = failed(&mut client, values).await.unwrap_err();
    assert!(status.code() == Code::InvalidArgument && status.message().contains("mood"), "{status}");
    let large = diagnosis(("force.csv", &"x".repeat(66 << 20)), ("experiment.toml", testbed::EXPERIMENT));
    assert_eq!(failed(&mut client, large).await.unwrap_err().code(), Code::ResourceExhausted);
}

/// Path and text of a file of tests/data/trajectory.
fn walk_log(name: &str) -> (String, Vec<u8>) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/trajectory").join(name);
    (path.to_str().unwrap().into(), std::fs::read(path).unwrap())
}

#[tokio::test]
async fn a_diagnosis_takes_tables_alone() {
    let server = Server::start(1).await;
    let mut client = client(&server).await;
    let call = |data: (String, Vec<u8>), experiment: (String, Vec<u8>)| {
        let words = [format!("--experiment={}", experiment.0), "--".into(), data.0.clone()];
        let call = request("diagnose", &words.each_ref().map(String::as_str));
        with_file(with_file(call, &data.0, data.1), &experiment.0, experiment.1)
    };
    let request = call(walk_log("walk.csv"), walk_log("walk.toml"));
    // The log is taken: it has been read and is compared with the model. tests/trajectory_logs.rs checks the result of this log.
    let mut stream = client.study(request.clone()).await.unwrap().into_inner();
    while first_progress(&mut stream).await.stage.contains("reading") {}
    drop(stream);
    for request in long::first(0, [request]) {
        let result = done(&mut client, request).await;
        assert!(
            text(&result, "report.json").contains("\"named\"") && text(&result, "sand.toml").contains("inertial_drag")
        );
    }
    let out = tempfile::tempdir().unwrap();
    for log in ["walk.mcap", "walk.parquet", "walk.csv"] {
        // The experiment file lists runs, as walk.csv does too.
        let (data, wrong) = (walk_log(log), walk_log("walk_mcap.toml"));
        let out = out.path().join("x");
        let said = command_line(&["diagnose", &data.0, "--experiment", &wrong.0, "--out", out.to_str().unwrap()]);
        assert!(said.contains("sandgait.logs") == (log != "walk.csv"), "{said}");
        refused(failed(&mut client, call(data, wrong)).await, &said);
    }
}

/// The text of a file of a result.
fn text<'a>(result: &'a StudyResult, name: &str) -> &'a str {
    let file: &File = result.files.iter().find(|file| file.name == name).unwrap();
    std::str::from_utf8(&file.content).unwrap()
}

#[tokio::test]
async fn a_sweep_reports_progress_and_gives_one_row_a_design() {
    let server = Server::start(1).await;
    let mut client = client(&server).await;
    let frequencies: Vec<f64> = (0..60).map(|i| 1.0 + 0.05 * f64::from(i)).collect();
    let listed = frequencies.iter().map(f64::to_string).collect::<Vec<_>>().join(",");
    let sweep = request("sweep", &["--vary=leg=L,C", &format!("--vary=frequency={listed}")]);
    let (told, result) = whole(client.study(sweep).await.unwrap().into_inner()).await;
    let table = &result.tables[0];
    assert!(told.len() > 3 && told.iter().all(|p| p.ahead == 0 && !p.stage.is_empty()), "{told:?}");
    assert!(told.is_sorted_by(|a, b| a.fraction <= b.fraction), "{told:?}");
    assert!(told.iter().all(|p| (0.0..=1.0).contains(&p.fraction)) && told.last().unwrap().fraction > 0.5);
    assert_eq!(column(table, "leg").names.len(), 120);
    assert_eq!(numbers(table, "frequency")[60..], frequencies);
    assert!(table.columns.iter().all(|c| c.names.len() == 120 || (c.numbers.len() == 8 * 120 && !c.unit.is_empty())));
    // The same bits as a walk of this design alone.
    let alone = walked(&mut client, request("walk", &["--frequency=1.5", "--leg=C"])).await;
    assert_eq!(numbers(table, "speed")[60 + 10], numbers(&alone, "speed")[0]);
}

#[tokio::test]
async fn a_search_reports_progress_and_gives_the_best_design() {
    let server = Server::start(1).await;
    let request = request("sweep", &["--vary=xi=0,75", "--optimize=speed"]);
    let (told, result) = whole(client(&server).await.study(request).await.unwrap().into_inner()).await;
    let table = &result.tables[0];
    assert!(told.len() > 20 && told.is_sorted_by(|a, b| a.fraction <= b.fraction), "{told:?}");
    assert!((0.0..=75.0).contains(&numbers(table, "xi")[0]) && numbers(table, "speed")[0] > 0.1);
}

#[tokio::test]
async fn walks_of_both_engines_and_of_standing_robots() {
    let server = Server::start(1).await;
    let mut client = client(&server).await;
    let table = walked(&mut client, walk("2,0,-1")).await;
    let speed = numbers(&table, "speed");
    assert!(speed[0] > 0.05 && speed[2] < 0.0, "{speed:?}");
    assert!(numbers(&table, "sink")[1].abs() < 1e-3 && numbers(&table, "cost_of_transport")[1].is_nan());
    let other = walked(&mut client, request("walk", &["--frequency=2", "--engine=rapier"])).await;
    assert!((numbers(&other, "speed")[0] / speed[0] - 1.0).abs() < 0.03);
}

#[tokio::test]
async fn extrapolated_sand_comes_with_a_warning() {
    let server = Server::start(1).await;
    let result = done(&mut client(&server).await, leg(&["--shape=L", "--medium=mu=1.3,rho=1500"])).await;
    assert!(result.warnings[0].contains("extrapolated"), "{:?}", result.warnings);
}

/// A walk says which mechanisms of its sand have no effect, as the command does.
#[tokio::test]
async fn mechanisms_without_effect_are_named() {
    let server = Server::start(1).await;
    let mut sand = SandDescription::named("poppy-loose", "li2013").unwrap();
    sand.mechanisms.added_mass = 0.1;
    let sand = sand.to_toml().unwrap();
    let walk = with_file(request("walk", &["--frequency=2", "--sand=s.toml"]), "s.toml", sand);
    let result = done(&mut client(&server).await, walk).await;
    assert!(result.warnings[0].contains("added_mass has no effect on a walking robot"), "{:?}", result.warnings);
}

/// A leg is computed at once, beside a sweep of minutes.
#[tokio::test]
async fn quick_studies_do_not_wait() {
    let server = Server::start(1).await;
    let mut client = client(&server).await;
    let mut sweep = client.study(long_sweep()).await.unwrap().into_inner();
    first_progress(&mut sweep).await;
    let quick = tokio::time::timeout(Duration::from_secs(10), done(&mut client, leg(&["--shape=L"]))).await;
    assert_eq!(quick.unwrap().tables[0].name, "intrusion");
}

/// Clients of earlier versions are told what to do.
#[tokio::test]
async fn calls_of_older_clients_are_refused_with_advice() {
    let server = Server::start(1).await;
    let mut client = tonic::client::Grpc::new(server.channel().await);
    for method in ["Walk", "Intrude", "Trials", "Sweep", "Evaluate", "Diagnose"] {
        client.ready().await.unwrap();
        let path = format!("/sandgait.v1.StudyService/{method}").parse().unwrap();
        let codec = tonic_prost::ProstCodec::<StudyRequest, StudyResult>::default();
        let refused = client.unary(tonic::Request::new(StudyRequest::default()), path, codec).await.unwrap_err();
        assert_eq!(refused.code(), Code::Unimplemented);
        assert!(refused.message().contains("use rpc Study; update the client"), "{refused}");
    }
}

/// A sweep of several minutes is cancelled; the walk that waits for its place is then answered soon.
#[tokio::test]
async fn a_cancelled_sweep_frees_its_place_and_the_cores() {
    let server = Server::start(1).await;
    let (mut first, mut second) = (client(&server).await, client(&server).await);
    let mut sweep = first.study(long_sweep()).await.unwrap().into_inner();
    assert_eq!(first_progress(&mut sweep).await.ahead, 0);
    let mut waiting = second.study(walk("2")).await.unwrap().into_inner();
    let told = first_progress(&mut waiting).await;
    assert!(told.ahead == 1 && told.stage.contains("waiting"), "{told:?}");
    let more = tokio::time::timeout(Duration::from_millis(300), waiting.message()).await;
    assert!(more.is_err(), "the walk did not wait its turn");
    drop(sweep);
    let rest = tokio::time::timeout(Duration::from_secs(10), whole(waiting)).await.expect("the slot was not freed");
    assert_eq!(rest.1.tables.len(), 1);
}

/// A request that is cancelled while it waits leaves the queue, so the next one gets its place.
#[tokio::test]
async fn the_queue_is_limited_and_can_be_left() {
    let server = Server::start(1).await;
    let mut client = client(&server).await;
    let mut streams = Vec::new();
    for _ in 0..16 {
        streams.push(client.study(long_sweep()).await.unwrap().into_inner());
    }
    let status = client.study(walk("2")).await.unwrap_err();
    assert_eq!(status.code(), Code::ResourceExhausted);
    assert!(status.message().contains("all 16 places"), "{status}");
    streams.clear();
    crate::harness::until(async || client.study(walk("2")).await.is_ok()).await;
}

#[tokio::test]
async fn a_diagnosis_reports_progress_and_a_cancelled_one_frees_the_slot() {
    let server = Server::start(1).await;
    let mut client = client(&server).await;
    let start = Instant::now();
    let (told, result) = whole(client.study(diagnose()).await.unwrap().into_inner()).await;
    let whole_time = start.elapsed();
    assert!(told.len() > 4 && told.is_sorted_by(|a, b| a.fraction <= b.fraction), "{told:?}");
    assert!(
        text(&result, "report.json").contains("\"named\"") && text(&result, "report.json").contains("inertial_drag")
    );
    assert!(text(&result, "report.html").starts_with("<!doctype html>"));
    assert!(text(&result, "sand.toml").contains("inertial_drag"));
    let curves = result.tables[0].clone();
    let rows = column(&curves, "trial").names.len();
    for name in ["progress", "Fx", "Fx_plain", "Fz_extended", "Ty_sd"] {
        assert_eq!(numbers(&curves, name).len(), rows, "{name}");
    }
    let mut stream = client.study(diagnose()).await.unwrap().into_inner();
    first_progress(&mut stream).await;
    drop(stream);
    let start = Instant::now();
    walked(&mut client, walk("5")).await;
    let wait = start.elapsed();
    assert!(wait < whole_time / 2, "the walk waited {wait:?}; a whole diagnosis takes {whole_time:?}");
}

#[tokio::test]
async fn a_server_that_stops_ends_its_studies() {
    let mut server = Server::start(1).await;
    let mut stream = client(&server).await.study(long_sweep()).await.unwrap().into_inner();
    first_progress(&mut stream).await;
    server.stop.cancel();
    let ended = async {
        while stream.message().await?.is_some() {}
        Ok::<(), Status>(())
    };
    let status = tokio::time::timeout(Duration::from_secs(5), ended).await.unwrap().unwrap_err();
    assert_eq!((status.code(), status.message()), (Code::Unavailable, "the server stops"));
    tokio::time::timeout(Duration::from_secs(5), server.done.take().unwrap()).await.unwrap().unwrap().unwrap();
}
