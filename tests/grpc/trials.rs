//! Trials of bodies in sand over gRPC.

use super::*;

fn doubles(values: &[f64]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}

/// A wheel that rolls at 1 cm/s under 20 N in each row.
fn rolling(rows: usize) -> TrialsRequest {
    TrialsRequest {
        body: Some(trials_request::Body::Shape("cylinder:radius=0.0625,width=0.06".into())),
        velocity: doubles(&[0.01, 0.0, 0.0]).repeat(rows).into(),
        spin: Some(doubles(&[0.0, 0.16, 0.0]).repeat(rows).into()),
        load: Some(doubles(&[20.0]).repeat(rows).into()),
        ..Default::default()
    }
}

#[tokio::test]
async fn trials_give_one_row_a_motion() {
    let server = Server::start(1).await;
    let mut client = client(&server).await;
    let (told, last) = whole(client.trials(rolling(4_000)).await.unwrap().into_inner()).await;
    assert!(told.iter().all(|p| p.stage == "trials") && told.is_sorted_by(|a, b| a.fraction <= b.fraction), "{told:?}");
    let Some(table_response::Event::Table(table)) = last.event else { panic!() };
    let [fz, depth, lost] = ["Fz", "depth", "no_equilibrium"].map(|name| numbers(&table, name));
    assert_eq!(fz.len(), 4_000);
    assert!(fz.iter().all(|f| (f - 20.0).abs() < 1e-3) && depth.iter().all(|d| *d == depth[0] && *d > 1e-3));
    assert!(lost.iter().all(|l| *l == 0.0));
    // The first client has left, so the next study begins before the first would have ended.
    let mut long = client.trials(rolling(900_000)).await.unwrap().into_inner();
    first_progress(&mut long).await;
    drop(long);
    let next = tokio::time::timeout(Duration::from_secs(20), walked(&mut client, walk(&[2.0]))).await;
    assert!(next.is_ok(), "the slot was not freed");
}

#[tokio::test]
async fn impossible_trials_are_refused() {
    let server = Server::start(1).await;
    let mut client = client(&server).await;
    let one = || rolling(1);
    let mesh = |name: &str, content: Vec<u8>| TrialsRequest {
        body: Some(trials_request::Body::Mesh(File { name: name.into(), content: content.into() })),
        ..one()
    };
    let cases = [
        (TrialsRequest { body: None, ..one() }, "body: none given"),
        (
            TrialsRequest { body: Some(trials_request::Body::Shape("/etc/passwd.stl".into())), ..one() },
            "send the content of the mesh",
        ),
        (TrialsRequest { velocity: vec![0; 23].into(), ..one() }, "velocity: 23 bytes"),
        (TrialsRequest { velocity: vec![0; 32].into(), ..one() }, "not a multiple of three"),
        (TrialsRequest { velocity: vec![].into(), ..one() }, "number of rows: 0"),
        (TrialsRequest { spin: Some(vec![0; 8].into()), ..one() }, "spin: 1 numbers; 1 rows have 3"),
        (TrialsRequest { depth: Some(doubles(&[0.01]).into()), ..one() }, "trial 1: both depth and load"),
        (TrialsRequest { load: None, ..one() }, "trial 1: neither depth nor load"),
        (TrialsRequest { load: Some(doubles(&[f64::INFINITY]).into()), ..one() }, "trial 1: load"),
        (TrialsRequest { friction: Some(f64::NAN), ..one() }, "mu-s"),
        (TrialsRequest { plate_size: Some(1e-6), ..one() }, "plate-size"),
        (mesh("scan.stl", vec![255; 200]), "scan.stl: "),
        (mesh("scan.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n".to_vec()), "scan.obj: the surface is not closed"),
        (mesh("scan.obj", vec![b' '; (4 << 20) + 1]), "mesh: 4194305 bytes are more than"),
    ];
    for (request, says) in cases {
        let status = client.trials(request).await.err().unwrap_or_else(|| panic!("not refused: {says}"));
        assert!(status.code() == Code::InvalidArgument && status.message().contains(says), "{says}: {status}");
    }
    let large = TrialsRequest { velocity: vec![0; 70 << 20].into(), ..one() };
    assert_eq!(client.trials(large).await.unwrap_err().code(), Code::ResourceExhausted);
}
