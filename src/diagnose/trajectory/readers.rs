//! Tests of the readers: the same log as CSV, MCAP and Parquet is the same log; broken files end in one line.

use super::generate::{Truth, csv, experiment, file};
use super::log::Log;
use super::read;
use crate::error::Result;
use crate::experiment::Experiment;
use crate::sand::mechanism::Mechanisms;
use parquet::basic::{Compression, ZstdLevel};
use parquet::data_type::{ByteArray, ByteArrayType, DoubleType};
use parquet::file::properties::WriterProperties;
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::parser::parse_message_type;
use rand::{Rng, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use std::collections::BTreeMap;
use std::io::Cursor;
use std::sync::Arc;

/// A log's header and cells.
fn table(text: &str) -> (Vec<&str>, Vec<Vec<&str>>) {
    let mut lines = text.lines().map(|line| line.split(',').collect::<Vec<_>>());
    (lines.next().unwrap(), lines.collect())
}

const TEXTS: [&str; 3] = ["run", "condition", "leg"];

fn parquet_of(text: &str, compression: Compression) -> Vec<u8> {
    let (header, rows) = table(text);
    let field = |name: &&str| match TEXTS.contains(name) {
        true => format!("optional binary {name} (UTF8);"),
        false => format!("required double {name};"),
    };
    // The parser of schemas knows no colons: they are put in behind it.
    let fields: String = header.iter().map(field).collect::<String>().replace(':', "__");
    let schema = Arc::new(parse_message_type(&format!("message log {{ {fields} }}")).unwrap());
    let properties = Arc::new(WriterProperties::builder().set_compression(compression).build());
    let mut writer = SerializedFileWriter::new(Vec::new(), schema, properties).unwrap();
    for rows in rows.chunks(rows.len().div_ceil(2)) {
        let mut group = writer.next_row_group().unwrap();
        for (k, name) in header.iter().enumerate() {
            let mut column = group.next_column().unwrap().unwrap();
            if TEXTS.contains(name) {
                let values: Vec<ByteArray> = rows.iter().map(|r| r[k].into()).collect();
                column.typed::<ByteArrayType>().write_batch(&values, Some(&vec![1; rows.len()]), None).unwrap();
            } else {
                let values: Vec<f64> = rows.iter().map(|r| r[k].parse().unwrap()).collect();
                column.typed::<DoubleType>().write_batch(&values, None, None).unwrap();
            }
            column.close().unwrap();
        }
        group.close().unwrap();
    }
    writer.into_inner().unwrap()
}

/// CDR, little endian.
#[derive(Default)]
struct Cdr(Vec<u8>);

impl Cdr {
    fn put<const N: usize>(&mut self, bytes: [u8; N]) {
        self.0.resize(self.0.len().next_multiple_of(N), 0);
        self.0.extend(bytes);
    }

    fn text(&mut self, text: &str) {
        self.put((text.len() as u32 + 1).to_le_bytes());
        self.0.extend(text.bytes().chain([0]));
    }

    fn numbers(&mut self, numbers: &[f64]) {
        numbers.iter().for_each(|n| self.put(n.to_le_bytes()));
    }

    fn list(&mut self, numbers: &[f64]) {
        self.put((numbers.len() as u32).to_le_bytes());
        self.numbers(numbers);
    }

    fn header(t: f64) -> Self {
        let mut cdr = Self::default();
        let nanoseconds = (1e9 * t).round() as u64;
        cdr.put(((nanoseconds / 1_000_000_000) as u32).to_le_bytes());
        cdr.put(((nanoseconds % 1_000_000_000) as u32).to_le_bytes());
        cdr.text("base");
        cdr
    }

    fn message(self) -> Vec<u8> {
        [0, 1, 0, 0].into_iter().chain(self.0).collect()
    }
}

/// The runs one after the other, each 10 s behind the one before.
fn mcap_of(text: &str, compression: Option<mcap::Compression>) -> Vec<u8> {
    let (header, rows) = table(text);
    let place = |name: &str| header.iter().position(|h| *h == name).unwrap();
    let joints: Vec<&str> = header.iter().filter_map(|h| h.strip_prefix("q:")).collect();
    let options = mcap::WriteOptions::new().compression(compression);
    let mut writer = options.create(Cursor::new(Vec::new())).unwrap();
    let mut channel = |schema: &str, topic: &str| {
        let id = writer.add_schema(schema, "ros2msg", b"").unwrap();
        writer.add_channel(id, topic, "cdr", &BTreeMap::new()).unwrap()
    };
    let channels = [channel("sensor_msgs/msg/JointState", "/joint_states"), channel("sensor_msgs/msg/Imu", "/imu")];
    for row in rows {
        let number = |name: &str| row[place(name)].parse::<f64>().unwrap();
        let t = 1000.0 + 10.0 * number("run") + number("t");
        let mut state = Cdr::header(t);
        state.put((joints.len() as u32).to_le_bytes());
        joints.iter().for_each(|j| state.text(j));
        for kind in ["q", "qd", "tau"] {
            state.list(&joints.iter().map(|j| number(&format!("{kind}:{j}"))).collect::<Vec<_>>());
        }
        let mut imu = Cdr::header(t);
        imu.numbers(&[0.0; 4]);
        imu.numbers(&[0.0; 9]);
        imu.numbers(&["gyro_x", "gyro_y", "gyro_z"].map(number));
        imu.numbers(&[0.0; 9]);
        imu.numbers(&["acc_x", "acc_y", "acc_z"].map(number));
        for (channel_id, cdr) in channels.into_iter().zip([state, imu]) {
            let time = (1e9 * t) as u64;
            let message = mcap::records::MessageHeader { channel_id, sequence: 0, log_time: time, publish_time: time };
            writer.write_to_known_channel(&message, &cdr.message()).unwrap();
        }
    }
    writer.finish().unwrap();
    writer.into_inner().into_inner()
}

/// The experiment that cuts such a file into runs.
fn cuts(text: &str) -> Experiment {
    let (header, rows) = table(text);
    let place = |name: &str| header.iter().position(|h| *h == name).unwrap();
    let mut toml = super::generate::EXPERIMENT.to_string();
    let mut last = "";
    for row in rows {
        let cell = |name: &str| row[place(name)];
        if cell("run") == last {
            continue;
        }
        last = cell("run");
        let from = 10.0 * last.parse::<f64>().unwrap();
        let [condition, leg, slope, frequency] = ["condition", "leg", "slope_deg", "stride_frequency"].map(cell);
        toml += &format!(
            "[[run]]\nname = \"{last}\"\nfrom = {from:.1}\nto = {:.1}\ncondition = \"{condition}\"\nleg = \"{leg}\"\n\
             slope_deg = {slope}.0\nstride_frequency = {frequency:?}\n",
            from + 9.0,
            frequency = frequency.parse::<f64>().unwrap(),
        );
    }
    Experiment::from_toml(&toml).unwrap()
}

fn read_bytes(bytes: &[u8], experiment: &Experiment) -> Result<Log> {
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), bytes).unwrap();
    read(file.path(), experiment)
}

/// In columns of Parquet names have two underscores for a colon here.
fn renamed() -> Experiment {
    let joints = super::generate::body().joint_names();
    let kinds = ["q", "qd", "tau"];
    let line = |k: &&str, j: &String| format!("\"{k}:{j}\" = \"{k}__{j}\"\n");
    let lines: String = kinds.iter().flat_map(|k| joints.iter().map(move |j| line(k, j))).collect();
    Experiment::from_toml(&format!("{}[columns]\n{lines}", super::generate::EXPERIMENT)).unwrap()
}

#[test]
fn one_log_in_three_formats() {
    let text = csv(&Truth::new(Mechanisms::PLAIN, 9));
    let want = read(file(&text).path(), &experiment()).unwrap();
    let alike = |got: &Log, close: f64| {
        assert_eq!(got.runs.len(), want.runs.len());
        for (a, b) in got.runs.iter().zip(&want.runs) {
            assert_eq!((&a.name, &a.condition, &a.leg), (&b.name, &b.condition, &b.leg));
            assert_eq!((a.slope_deg, a.frequency, a.t.len()), (b.slope_deg, b.frequency, b.t.len()));
            let all =
                |r: &super::log::Run| [r.q.concat(), r.qd.concat(), r.tau.concat(), r.gyro.concat(), r.acc.concat()];
            for (a, b) in all(a).concat().iter().zip(all(b).concat()) {
                assert!((a - b).abs() <= close, "{a} {b}");
            }
        }
    };
    for compression in [Compression::UNCOMPRESSED, Compression::SNAPPY, Compression::ZSTD(ZstdLevel::default())] {
        alike(&read_bytes(&parquet_of(&text, compression), &renamed()).unwrap(), 0.0);
    }
    for compression in [None, Some(mcap::Compression::Zstd), Some(mcap::Compression::Lz4)] {
        alike(&read_bytes(&mcap_of(&text, compression), &cuts(&text)).unwrap(), 1e-9);
    }
}

#[test]
fn what_is_wrong_with_a_file_is_one_line() {
    let text = csv(&Truth::new(Mechanisms::PLAIN, 9));
    let told = |bytes: &[u8], experiment: &Experiment, words: &str| {
        let error = read_bytes(bytes, experiment).err().map(|e| e.to_string()).unwrap_or_default();
        assert!(error.contains(words) && !error.contains('\n'), "{error:?} lacks {words:?}");
    };
    let with = |more: &str| Experiment::from_toml(&format!("{}{more}", super::generate::EXPERIMENT)).unwrap();
    let mcap = mcap_of(&text, None);
    told(&mcap, &with("[topics]\nimu = \"/other\"\n"), "no topic of sensor_msgs/msg/Imu");
    told(&mcap, &experiment(), "split it into two runs");
    told(text.as_bytes(), &with("[topics]\nimu = \"/imu\"\n"), "only MCAP files");
    told(&mcap[..mcap.len() / 2], &cuts(&text), "MCAP:");
    let parquet = parquet_of(&text, Compression::SNAPPY);
    told(&parquet, &experiment(), "missing; the header has");
    told(&parquet[..parquet.len() / 2], &renamed(), "Parquet:");
    told(&parquet_of(&text, Compression::SNAPPY)[..9], &renamed(), "Parquet:");
}

/// Mutated files, as many of each kind as `SANDGAIT_MUTATED_LOGS` says, give a log or one line.
#[test]
fn mutated_files_do_not_panic() {
    let whole = csv(&Truth::new(Mechanisms::PLAIN, 8));
    let small: String = whole.lines().take(60).flat_map(|l| [l, "\n"]).collect();
    let kinds: [(Vec<u8>, Experiment); 6] = [
        (small.clone().into_bytes(), experiment()),
        (parquet_of(&small, Compression::UNCOMPRESSED), renamed()),
        (parquet_of(&small, Compression::SNAPPY), renamed()),
        (parquet_of(&small, Compression::ZSTD(ZstdLevel::default())), renamed()),
        (mcap_of(&small, None), cuts(&small)),
        (mcap_of(&small, Some(mcap::Compression::Zstd)), cuts(&small)),
    ];
    let count = std::env::var("SANDGAIT_MUTATED_LOGS").map_or(100, |n| n.parse().unwrap());
    for (kind, (bytes, experiment)) in kinds.iter().enumerate() {
        assert!(read_bytes(bytes, experiment).is_ok(), "{kind}: {:?}", read_bytes(bytes, experiment).err());
        for seed in 0..count {
            let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
            let bytes = mutated(bytes, &mut rng);
            if let Err(error) = read_bytes(&bytes, experiment) {
                assert!(!error.to_string().contains('\n'), "{error}");
            }
        }
    }
}

fn mutated(bytes: &[u8], rng: &mut impl Rng) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    for _ in 0..rng.random_range(1..8) {
        // Often near the end, where Parquet says what is where.
        let reach = if rng.random_bool(0.5) { bytes.len() } else { bytes.len().min(4096) };
        let at = bytes.len() - 1 - rng.random_range(0..reach);
        match rng.random_range(0..6) {
            0 => bytes[at] = rng.random(),
            1 => bytes[at] ^= 1 << rng.random_range(0..8),
            2 => bytes[at] = [0, 0x7f, 0x80, 0xff, b',', b'\n', b'-', b'"'][rng.random_range(0..8)],
            3 => drop(bytes.remove(at)),
            4 => bytes.insert(at, rng.random()),
            _ if rng.random_bool(0.2) => bytes.truncate(at.max(1)),
            _ => bytes[at..].iter_mut().take(8).for_each(|b| *b = 0xff),
        }
        if bytes.len() < 2 {
            break;
        }
    }
    bytes
}
