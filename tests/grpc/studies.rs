//! Studies over gRPC: the same numbers and errors as on the command line, progress that only grows, and cancellation.

#[path = "answers.rs"]
mod answers;
#[path = "trials.rs"]
mod trials;

use crate::harness::Server;
use crate::{long, testbed};
use answers::{first_progress, whole};
use sandgait::service::Limits;
use sandgait::service::proto::study_service_client::StudyServiceClient;
use sandgait::service::proto::{DiagnoseRequest, diagnose_request, diagnose_response};
use sandgait::service::proto::{File, IntrudeRequest, Robot, Sand, Series, SweepRequest, Table};
use sandgait::service::proto::{TrialsRequest, Variation, WalkRequest, table_response, trials_request};
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

fn file(name: &str, content: &str) -> Option<File> {
    Some(File { name: name.into(), content: content.to_owned().into() })
}

fn walk(frequency: &[f64]) -> WalkRequest {
    WalkRequest { frequency: frequency.to_vec(), ..Default::default() }
}

fn vary(parameter: &str, numbers: &[f64]) -> Variation {
    Variation { parameter: parameter.into(), numbers: numbers.to_vec(), names: Vec::new() }
}

/// A grid that takes minutes.
fn long_sweep() -> SweepRequest {
    let many = |low: f64, step: f64| (0..300).map(|i| low + step * f64::from(i)).collect::<Vec<_>>();
    let vary = vec![vary("xi", &many(-75.0, 0.5)), vary("frequency", &many(1.0, 0.01))];
    SweepRequest { vary, ..Default::default() }
}

/// A diagnosis takes some 24 KiB for each row.
#[tokio::test]
async fn a_diagnosis_that_needs_more_than_the_servers_memory_is_refused() {
    let server = Server::with_limits(1, Limits { memory: 8 << 20, ..Limits::default() }).await;
    let mut client = StudyServiceClient::new(server.channel().await);
    let refused = client.diagnose(diagnose()).await.unwrap_err();
    assert_eq!(refused.code(), Code::ResourceExhausted);
    let words = "rows are more than 341, which a diagnosis within this server's 8 MiB may have";
    assert!(refused.message().contains(words), "{}", refused.message());
}

fn diagnose() -> DiagnoseRequest {
    let hidden = testbed::Hidden { causes: vec![("inertial_drag", 0.4)] };
    DiagnoseRequest {
        data: file("force.csv", &testbed::log(3, &hidden, 0.05).noisy),
        experiment: file("experiment.toml", testbed::EXPERIMENT).map(diagnose_request::Experiment::File),
    }
}

fn column<'a>(table: &'a Table, name: &str) -> &'a Series {
    table.columns.iter().find(|c| c.name == name).unwrap()
}

fn numbers(table: &Table, name: &str) -> Vec<f64> {
    column(table, name).numbers.chunks_exact(8).map(|b| f64::from_le_bytes(b.try_into().unwrap())).collect()
}

async fn walked(client: &mut Client, request: WalkRequest) -> Table {
    match whole(client.walk(request).await.unwrap().into_inner()).await.1.event {
        Some(table_response::Event::Table(table)) => table,
        other => panic!("{other:?}"),
    }
}

#[tokio::test]
async fn wrong_sand_legs_and_robots_are_refused_as_on_the_command_line() {
    let server = Server::start(1).await;
    let mut client = client(&server).await;
    let leg = |shape: &str| IntrudeRequest { shape: shape.into(), ..Default::default() };
    let sand = |medium: &str, law: &str| Some(Sand { medium: Some(medium.into()), law: Some(law.into()), file: None });
    refused(client.intrude(leg("Q")).await, &command_line(&["intrude", "--shape", "Q"]));
    refused(client.intrude(leg("xi=95")).await, &command_line(&["intrude", "--shape", "xi=95"]));
    let request = IntrudeRequest { chord: Some(-1.0), ..leg("L") };
    refused(client.intrude(request).await, &command_line(&["intrude", "--shape", "L", "--chord=-1"]));
    let request = IntrudeRequest { omega: Some(f64::NAN), ..leg("L") };
    refused(client.intrude(request).await, &command_line(&["intrude", "--shape", "L", "--omega", "NaN"]));
    let request = IntrudeRequest { sand: sand("moon", "li2013"), ..leg("L") };
    refused(client.intrude(request).await, &command_line(&["intrude", "--shape", "L", "--medium", "moon"]));
    let request = WalkRequest { sand: sand("poppy-loose", "newton"), ..walk(&[2.0]) };
    refused(client.walk(request).await, &command_line(&["walk", "--frequency", "2", "--law", "newton"]));
    refused(client.walk(walk(&[1.0, 21.0])).await, &command_line(&["walk", "--frequency", "21"]));
    let request = WalkRequest { slope_deg: 50.0, ..walk(&[2.0]) };
    refused(client.walk(request).await, &command_line(&["walk", "--frequency", "2", "--slope-deg", "50"]));
    let request = WalkRequest { engine: Some("warp".into()), ..walk(&[2.0]) };
    refused(client.walk(request).await, &command_line(&["walk", "--frequency", "2", "--engine", "warp"]));
    refused(client.walk(walk(&[])).await, "number of frequencies: 0 is outside [1, 4096]");
    let robot = |name: &str| Some(Robot { name: Some(name.into()), file: None });
    let request = WalkRequest { robot: robot("/etc/passwd.toml"), ..walk(&[2.0]) };
    refused(client.walk(request).await, "robot \"/etc/passwd.toml\" is unknown; known: xplorer, xplorer18");
    let both = Some(Sand { file: file("sand.toml", ""), ..sand("poppy-loose", "li2013").unwrap() });
    let request = WalkRequest { sand: both, ..walk(&[2.0]) };
    refused(client.walk(request).await, "sand: give either a sand file, or medium and law");
}

#[tokio::test]
async fn wrong_sweeps_are_refused_as_on_the_command_line() {
    let server = Server::start(1).await;
    let mut client = client(&server).await;
    let sweep = |vary: Vec<Variation>| SweepRequest { vary, ..Default::default() };
    let cli = |arguments: &[&str]| {
        let directory = tempfile::tempdir().unwrap();
        command_line(&[&["sweep", "--out", directory.path().to_str().unwrap()], arguments].concat())
    };
    refused(client.sweep(sweep(vec![vary("mood", &[1.0])])).await, &cli(&["--vary", "mood=1"]));
    refused(client.sweep(sweep(vec![vary("xi", &[0.0, 95.0])])).await, &cli(&["--vary", "xi=0,95"]));
    refused(client.sweep(sweep(vec![vary("width", &[0.01, -1.0])])).await, &cli(&["--vary", "width=0.01,-1"]));
    let names = Variation { parameter: "xi".into(), names: vec!["steep".into()], ..Default::default() };
    refused(client.sweep(sweep(vec![names])).await, &cli(&["--vary", "xi=steep"]));
    let search = SweepRequest { optimize: Some("speed".into()), ..sweep(vec![vary("xi", &[3.0])]) };
    refused(client.sweep(search).await, &cli(&["--vary", "xi=3", "--optimize", "speed"]));
    let search = SweepRequest { optimize: Some("joy".into()), ..sweep(vec![vary("xi", &[0.0, 3.0])]) };
    refused(client.sweep(search).await, &cli(&["--vary", "xi=0,3", "--optimize", "joy"]));
    let fixed = SweepRequest { set: vec![vary("kp", &[-1.0])], ..sweep(vec![vary("xi", &[3.0])]) };
    refused(client.sweep(fixed).await, &cli(&["--vary", "xi=3", "--set", "kp=-1"]));
    refused(client.sweep(sweep(vec![])).await, "number of parameters in vary: 0 is outside [1, 17]");
    let thousand: Vec<f64> = (0..1000).map(|i| 1.0 + 1e-3 * f64::from(i)).collect();
    let huge = sweep(vec![vary("frequency", &thousand), vary("width", &thousand)]);
    refused(client.sweep(huge).await, "number of walks: 1000000 is outside [1, 500000]");
}

/// The status that a diagnosis ends with.
async fn failed(client: &mut Client, request: DiagnoseRequest) -> Result<(), Status> {
    let mut stream = client.diagnose(request).await?.into_inner();
    while stream.message().await?.is_some() {}
    Ok(())
}

#[tokio::test]
async fn wrong_data_are_refused_as_on_the_command_line() {
    let server = Server::start(1).await;
    let mut client = client(&server).await;
    let directory = tempfile::tempdir().unwrap();
    let good = diagnose();
    let data = String::from_utf8(good.data.unwrap().content.to_vec()).unwrap();
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
        let request = DiagnoseRequest {
            data: file(d, data),
            experiment: file(e, experiment).map(diagnose_request::Experiment::File),
        };
        refused(failed(&mut client, request).await, &said);
    }
    refused(failed(&mut client, DiagnoseRequest::default()).await, "data: none given");
    let values = prost_types::Struct {
        fields: [
            ("kind".to_owned(), crate::harness::text("intrusion")),
            ("mood".to_owned(), crate::harness::text("x")),
        ]
        .into(),
    };
    let request = DiagnoseRequest {
        data: file("force.csv", &data),
        experiment: Some(diagnose_request::Experiment::Values(values)),
    };
    let status = failed(&mut client, request).await.unwrap_err();
    assert!(status.code() == Code::InvalidArgument && status.message().contains("mood"), "{status}");
    let large = DiagnoseRequest { data: file("force.csv", &"x".repeat(65 << 20)), experiment: None };
    assert_eq!(failed(&mut client, large).await.unwrap_err().code(), Code::ResourceExhausted);
}

/// A file of tests/data/trajectory.
fn walk_log(name: &str) -> Option<File> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/trajectory").join(name);
    Some(File { name: path.to_str().unwrap().into(), content: std::fs::read(path).unwrap().into() })
}

#[tokio::test]
async fn a_diagnosis_takes_tables_alone() {
    let server = Server::start(1).await;
    let mut client = client(&server).await;
    let experiment = walk_log("walk.toml").map(diagnose_request::Experiment::File);
    let request = DiagnoseRequest { data: walk_log("walk.csv"), experiment };
    // The log is taken: it has been read and is compared with the model. tests/trajectory_logs.rs checks the result of this log.
    let mut stream = client.diagnose(request.clone()).await.unwrap().into_inner();
    while first_progress(&mut stream).await.stage.contains("reading") {}
    drop(stream);
    for request in long::first(0, [request]) {
        let (_, last) = whole(client.diagnose(request).await.unwrap().into_inner()).await;
        let Some(diagnose_response::Event::Diagnosis(diagnosis)) = last.event else { panic!() };
        assert!(diagnosis.report_json.contains("\"named\"") && diagnosis.report_json.contains("inertial_drag"));
        assert!(diagnosis.sand_toml.contains("inertial_drag"));
    }
    let out = tempfile::tempdir().unwrap();
    for log in ["walk.mcap", "walk.parquet", "walk.csv"] {
        // The experiment file lists runs, as walk.csv does too.
        let mut wrong = walk_log("walk_mcap.toml").unwrap();
        let data = walk_log(log);
        let [d, e] = [&data.as_ref().unwrap().name, &wrong.name];
        let said = command_line(&["diagnose", d, "--experiment", e, "--out", out.path().join("x").to_str().unwrap()]);
        assert!(said.contains("sandgait.logs") == (log != "walk.csv"), "{said}");
        wrong.name = "experiment.toml".into();
        let request = DiagnoseRequest { data, experiment: Some(diagnose_request::Experiment::File(wrong)) };
        refused(failed(&mut client, request).await, &said);
    }
}

#[tokio::test]
async fn a_sweep_reports_progress_and_gives_one_row_a_design() {
    let server = Server::start(1).await;
    let mut client = client(&server).await;
    let legs = Variation { parameter: "leg".into(), names: vec!["L".into(), "C".into()], ..Default::default() };
    let frequencies: Vec<f64> = (0..60).map(|i| 1.0 + 0.05 * f64::from(i)).collect();
    let vary = vec![legs, vary("frequency", &frequencies)];
    let stream = client.sweep(SweepRequest { vary, ..Default::default() }).await.unwrap().into_inner();
    let (told, last) = whole(stream).await;
    let Some(table_response::Event::Table(table)) = last.event else { panic!() };
    assert!(told.len() > 3 && told.iter().all(|p| p.ahead == 0 && !p.stage.is_empty()), "{told:?}");
    assert!(told.is_sorted_by(|a, b| a.fraction <= b.fraction), "{told:?}");
    assert!(told.iter().all(|p| (0.0..=1.0).contains(&p.fraction)) && told.last().unwrap().fraction > 0.5);
    assert_eq!(column(&table, "leg").names.len(), 120);
    assert_eq!(numbers(&table, "frequency")[60..], frequencies);
    assert!(table.columns.iter().all(|c| c.names.len() == 120 || (c.numbers.len() == 8 * 120 && !c.unit.is_empty())));
    // The same bits as a walk of this design alone.
    let alone = walked(&mut client, WalkRequest { leg: Some("C".into()), ..walk(&[1.5]) }).await;
    assert_eq!(numbers(&table, "speed")[60 + 10], numbers(&alone, "speed")[0]);
}

#[tokio::test]
async fn a_search_reports_progress_and_gives_the_best_design() {
    let server = Server::start(1).await;
    let request =
        SweepRequest { vary: vec![vary("xi", &[0.0, 75.0])], optimize: Some("speed".into()), ..Default::default() };
    let (told, last) = whole(client(&server).await.sweep(request).await.unwrap().into_inner()).await;
    let Some(table_response::Event::Table(table)) = last.event else { panic!() };
    assert!(told.len() > 20 && told.is_sorted_by(|a, b| a.fraction <= b.fraction), "{told:?}");
    assert!((0.0..=75.0).contains(&numbers(&table, "xi")[0]) && numbers(&table, "speed")[0] > 0.1);
}

#[tokio::test]
async fn walks_of_both_engines_and_of_standing_robots() {
    let server = Server::start(1).await;
    let mut client = client(&server).await;
    let table = walked(&mut client, walk(&[2.0, 0.0, -1.0])).await;
    let speed = numbers(&table, "speed");
    assert!(speed[0] > 0.05 && speed[2] < 0.0, "{speed:?}");
    assert!(numbers(&table, "sink")[1].abs() < 1e-3 && numbers(&table, "cost_of_transport")[1].is_nan());
    let other = walked(&mut client, WalkRequest { engine: Some("rapier".into()), ..walk(&[2.0]) }).await;
    assert!((numbers(&other, "speed")[0] / speed[0] - 1.0).abs() < 0.03);
}

#[tokio::test]
async fn extrapolated_sand_comes_with_a_warning() {
    let server = Server::start(1).await;
    let sand = Some(Sand { medium: Some("mu=1.3,rho=1500".into()), ..Default::default() });
    let request = IntrudeRequest { shape: "L".into(), sand, ..Default::default() };
    let table = client(&server).await.intrude(request).await.unwrap().into_inner().table.unwrap();
    assert!(table.warnings[0].contains("extrapolated"), "{:?}", table.warnings);
}

/// A sweep of several minutes is cancelled; the walk that waits for its place is then answered soon.
#[tokio::test]
async fn a_cancelled_sweep_frees_its_place_and_the_cores() {
    let server = Server::start(1).await;
    let (mut first, mut second) = (client(&server).await, client(&server).await);
    let mut sweep = first.sweep(long_sweep()).await.unwrap().into_inner();
    assert_eq!(first_progress(&mut sweep).await.ahead, 0);
    let mut waiting = second.walk(walk(&[2.0])).await.unwrap().into_inner();
    let told = first_progress(&mut waiting).await;
    assert!(told.ahead == 1 && told.stage.contains("waiting"), "{told:?}");
    let more = tokio::time::timeout(Duration::from_millis(300), waiting.message()).await;
    assert!(more.is_err(), "the walk did not wait its turn");
    drop(sweep);
    let rest = tokio::time::timeout(Duration::from_secs(10), whole(waiting)).await.expect("the slot was not freed");
    assert!(matches!(rest.1.event, Some(table_response::Event::Table(_))));
}

/// A request that is cancelled while it waits leaves the queue, so the next one gets its place.
#[tokio::test]
async fn the_queue_is_limited_and_can_be_left() {
    let server = Server::start(1).await;
    let mut client = client(&server).await;
    let mut streams = Vec::new();
    for _ in 0..16 {
        streams.push(client.sweep(long_sweep()).await.unwrap().into_inner());
    }
    let status = client.walk(walk(&[2.0])).await.unwrap_err();
    assert_eq!(status.code(), Code::ResourceExhausted);
    assert!(status.message().contains("all 16 places"), "{status}");
    streams.clear();
    crate::harness::until(async || client.walk(walk(&[2.0])).await.is_ok()).await;
}

#[tokio::test]
async fn a_diagnosis_reports_progress_and_a_cancelled_one_frees_the_slot() {
    let server = Server::start(1).await;
    let mut client = client(&server).await;
    let start = Instant::now();
    let (told, last) = whole(client.diagnose(diagnose()).await.unwrap().into_inner()).await;
    let whole_time = start.elapsed();
    assert!(told.len() > 4 && told.is_sorted_by(|a, b| a.fraction <= b.fraction), "{told:?}");
    let Some(diagnose_response::Event::Diagnosis(diagnosis)) = last.event else { panic!() };
    assert!(diagnosis.report_json.contains("\"named\"") && diagnosis.report_json.contains("inertial_drag"));
    assert!(diagnosis.report_html.starts_with("<!doctype html>") && diagnosis.sand_toml.contains("inertial_drag"));
    let curves = diagnosis.curves.unwrap();
    let rows = column(&curves, "trial").names.len();
    for name in ["progress", "Fx", "Fx_plain", "Fz_extended", "Ty_sd"] {
        assert_eq!(numbers(&curves, name).len(), rows, "{name}");
    }
    let mut stream = client.diagnose(diagnose()).await.unwrap().into_inner();
    first_progress(&mut stream).await;
    drop(stream);
    let start = Instant::now();
    walked(&mut client, walk(&[5.0])).await;
    let wait = start.elapsed();
    assert!(wait < whole_time / 2, "the walk waited {wait:?}; a whole diagnosis takes {whole_time:?}");
}

#[tokio::test]
async fn a_server_that_stops_ends_its_studies() {
    let mut server = Server::start(1).await;
    let mut stream = client(&server).await.sweep(long_sweep()).await.unwrap().into_inner();
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
