//! The format of recordings.

use flate2::Compression;
use flate2::write::GzEncoder;
use sandgait::sand::Medium;
use sandgait::sim::Robot;
use sandgait::sim::model::Scene;
use sandgait::sim::{Model, State};
use sandgait::view::recording::{head_block, rows_block};
use sandgait::view::{About, header};
use sandgait::view::{RecordedState, RecordingWriter, Section, read, row};
use std::io::Write as _;

fn model() -> Model {
    let scene = Scene::flat(Medium::named("poppy-loose").unwrap());
    Model::new(&Robot::load("xplorer").unwrap(), &scene).unwrap()
}

fn head() -> String {
    let about = About { task: "test", rate: 50.0, info: vec![("speed", "m/s")], actions: 2, ..Default::default() };
    header(&model(), &about)
}

fn file() -> Vec<u8> {
    let (model, head) = (model(), head());
    let mut writer = RecordingWriter::new(Vec::new(), &head).unwrap();
    for k in 0..3 {
        let mut state = State::at_rest(0.03 - 0.001 * f64::from(k), &model.tripod_angles());
        state.velocity[2] = -0.05;
        let moment = RecordedState {
            time: 0.02 * f64::from(k),
            state: &state,
            footing: &[],
            action: &[0.5, -0.5],
            reward: 1.5,
            info: &[0.25],
        };
        writer.row(&row(&model, &moment)).unwrap();
    }
    writer.section(&head).unwrap();
    writer.finish().unwrap()
}

#[test]
fn what_was_written_is_read() {
    let sections = read(&file()).unwrap();
    assert_eq!(sections.iter().map(Section::len).collect::<Vec<_>>(), [3, 0]);
    let first = &sections[0];
    assert_eq!(first.at("time", 2).unwrap(), [0.04]);
    assert_eq!(first.at("position", 1).unwrap(), [0.0, 0.0, 0.029]);
    assert_eq!(first.at("action", 0).unwrap(), [0.5, -0.5]);
    assert_eq!((first.at("reward", 0).unwrap(), first.at("speed", 0).unwrap()), (&[1.5][..], &[0.25][..]));
    let segments = serde_json::from_str::<serde_json::Value>(&head()).unwrap()["segments"].as_array().unwrap().len();
    assert_eq!(first.at("forces", 2).unwrap().len(), 3 * segments);
    assert!(first.at("forces", 2).unwrap().iter().any(|f| *f != 0.0), "legs are pressed into the sand");
    assert!(first.at("forces", 3).is_none() && first.at("nothing", 0).is_none() && sections[1].is_empty());
}

fn packed(stream: &[u8]) -> Vec<u8> {
    let mut out = GzEncoder::new(Vec::new(), Compression::fast());
    out.write_all(stream).unwrap();
    out.finish().unwrap()
}

/// Small files that would take gigabytes. The message names the bound.
#[test]
fn headers_and_sections_are_bounded() {
    let about = r#""format":"sandgait recording","version":1,"columns":[{"name":"t","shape":[]}]"#;
    let plain = head_block(&format!("{{{about}}}"));
    let long = head_block(&format!("{{{about},\"x\":\"{}\"}}", "x".repeat(129 << 20)));
    let nested = head_block(&format!("{{{about},\"x\":[{}0]}}", "[],".repeat(4_000_001)));
    let wide = head_block(&format!("{{{}}}", about.replace("[]}", "[4096, 4096]}")));
    let rows = [plain.clone(), b"ROWS\xfc\xff\xff\xff".to_vec()].concat();
    for (what, stream, said) in [
        ("sections", plain.repeat(100_001), "more than 100000 sections"),
        ("a long header", long, "more than 134217728 bytes"),
        ("many values", nested, "8000000 values"),
        ("many numbers in a row", wide, "not 1 to 1048576 numbers"),
        ("many rows", rows, "more than 1073741824 bytes"),
    ] {
        let file = packed(&stream);
        assert!(file.len() < 1 << 20, "{what}: {}", file.len());
        let error = read(&file).unwrap_err().to_string();
        assert!(error.contains(said), "{what}: {error}");
    }
}

#[test]
fn what_is_no_recording_is_refused() {
    let whole = file();
    let message = |bytes: &[u8]| read(bytes).unwrap_err().to_string();
    assert!(message(b"").contains("cut off"), "{}", message(b""));
    assert!(message(b"no gzip at all").contains("not one of sandgait's"));
    for length in [whole.len() / 3, whole.len() / 2, whole.len() - 1] {
        assert!(message(&whole[..length]).contains("cut off"));
    }
    assert!(message(&packed(b"")).contains("empty"));
    assert!(message(&packed(b"ROWS\0\0\0\0")).contains("not one of sandgait's"));
    assert!(message(&packed(b"HEAD\x02\0\0\0{}")).contains("not \"sandgait recording\" 1"));
    assert!(message(&packed(b"HEAD\xff\xff\xff\xff{}")).contains("cut off"));
    let odd = [head_block(&header(&model(), &About::default())), rows_block(&[1.0; 5])].concat();
    assert!(message(&packed(&odd)).contains("no rows"));
}
