//! Trials of bodies in sand over gRPC.

use super::*;
use sandgait::service::proto::{StudyInput, study_input};

const WHEEL: &str = "--body=cylinder:radius=0.0625,width=0.06";

fn series(name: &str, values: &[f64], rows: usize) -> Series {
    let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
    Series { name: name.into(), numbers: bytes.repeat(rows).into(), ..Default::default() }
}

/// Trials with these columns in memory.
fn trials(words: &[&str], columns: Vec<Series>) -> StudyRequest {
    let table = Table { columns, ..Default::default() };
    let rows = StudyInput { name: "rows".into(), form: Some(study_input::Form::Table(table)) };
    StudyRequest { files: vec![rows], ..request("intrude", &[words, &["--trials=rows"]].concat()) }
}

/// A wheel that rolls at 1 cm/s under 20 N in each row.
fn rolling(rows: usize) -> StudyRequest {
    let columns = [("vx", 0.01), ("wy", 0.16), ("load", 20.0)];
    trials(&[WHEEL], columns.map(|(name, value)| series(name, &[value], rows)).to_vec())
}

#[tokio::test]
async fn trials_give_one_row_a_motion() {
    let server = Server::start(1).await;
    let mut client = client(&server).await;
    let (told, result) = whole(client.study(rolling(4_000)).await.unwrap().into_inner()).await;
    assert!(told.iter().all(|p| p.stage == "trials") && told.is_sorted_by(|a, b| a.fraction <= b.fraction), "{told:?}");
    let table = &result.tables[0];
    let [fz, depth] = ["Fz", "depth"].map(|name| numbers(table, name));
    assert_eq!(fz.len(), 4_000);
    assert!(fz.iter().all(|f| (f - 20.0).abs() < 1e-3) && depth.iter().all(|d| *d == depth[0] && *d > 1e-3));
    assert!(column(table, "status").names.iter().all(|status| status == "ok"));
    // The first client has left, so the next study begins before the first would have ended.
    let mut long = client.study(rolling(900_000)).await.unwrap().into_inner();
    first_progress(&mut long).await;
    drop(long);
    let next = tokio::time::timeout(Duration::from_secs(20), walked(&mut client, walk("2"))).await;
    assert!(next.is_ok(), "the slot was not freed");
}

#[tokio::test]
async fn impossible_trials_are_refused() {
    let server = Server::start(1).await;
    let mut client = client(&server).await;
    let load = |value: f64| vec![series("vx", &[0.01], 1), series("load", &[value], 1)];
    let mesh =
        |name: &str, content: Vec<u8>| with_file(trials(&[&format!("--body={name}")], load(20.0)), name, content);
    let cut = |bytes: usize| Series { name: "vx".into(), numbers: vec![0; bytes].into(), ..Default::default() };
    let cases = [
        (request("intrude", &["--trials=rows"]), "body: missing"),
        (trials(&["--body=/etc/passwd.stl"], load(20.0)), "send the content"),
        (trials(&[WHEEL], vec![cut(23)]), "23 bytes are no whole numbers"),
        (trials(&[WHEEL], vec![]), "number of rows: 0"),
        (
            trials(&[WHEEL], vec![series("vx", &[0.0], 2), series("load", &[1.0], 1)]),
            "load: 1 rows where 2 are expected",
        ),
        (trials(&[WHEEL], [load(20.0), vec![series("depth", &[0.01], 1)]].concat()), "trial 1: both depth and load"),
        (trials(&[WHEEL], vec![series("vx", &[0.01], 1)]), "trial 1: neither depth nor load"),
        (trials(&[WHEEL], load(f64::INFINITY)), "trial 1: load"),
        (trials(&[WHEEL], vec![series("deep", &[0.01], 1)]), "column \"deep\" is unknown; did you mean \"depth\"?"),
        (trials(&[WHEEL, "--mu-s=NaN"], load(20.0)), "mu-s"),
        (trials(&[WHEEL, "--plate-size=1e-6"], load(20.0)), "plate-size"),
        (mesh("scan.stl", vec![255; 200]), "scan.stl: "),
        (mesh("scan.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n".to_vec()), "scan.obj: the surface is not closed"),
        (mesh("scan.obj", vec![b' '; (4 << 20) + 1]), "scan.obj: 4194305 bytes are more than the 4194304"),
        // 94,000 plates, which the command takes.
        (
            trials(&["--body=box:length=0.1,width=0.1,height=0.1", "--plate-size=8e-4"], load(20.0)),
            "plate-size: 0.0008 is outside [0.0011",
        ),
    ];
    for (request, says) in cases {
        let status = client.study(request).await.err().unwrap_or_else(|| panic!("not refused: {says}"));
        assert!(status.code() == Code::InvalidArgument && status.message().contains(says), "{says}: {status}");
    }
    let large = trials(&[WHEEL], vec![cut(70 << 20)]);
    assert_eq!(client.study(large).await.unwrap_err().code(), Code::ResourceExhausted);
}

/// A server reserves the memory of what will be made of rows before it reads them: a cell of one letter takes some 80 bytes.
#[tokio::test]
async fn rows_are_paid_for_before_they_are_read() {
    let server = Server::with_limits(1, Limits { memory: 64 << 20, ..Limits::default() }).await;
    let mut client = client(&server).await;
    let words = [WHEEL, "--trials=rows.csv"];
    let rows = |count: usize| format!("note,depth\n{}", "a,0.01\n".repeat(count));
    let small = with_file(request("intrude", &words), "rows.csv", rows(100));
    assert_eq!(column(&done(&mut client, small).await.tables[0], "note").names.len(), 100);
    let large = with_file(request("intrude", &words), "rows.csv", rows(100_000));
    let status = client.study(large).await.unwrap_err();
    assert_eq!(status.code(), Code::ResourceExhausted);
    assert!(status.message().contains("requests may take 8 MiB"), "{status}");
}
