//! Tests of the readers on files that other programs wrote (tests/data/trajectory). The same log is read from each format and
//! compression, and a broken file gives an error of one line.

use super::log::{Log, Run};
use super::read;
use crate::error::Result;
use crate::experiment::Experiment;
use rand::{Rng, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use std::path::Path;

const PARQUET: [&str; 5] =
    ["first_none.parquet", "first_snappy.parquet", "first_gzip.parquet", "first_lz4.parquet", "first_zstd.parquet"];
const MCAP: [&str; 3] = ["first_none.mcap", "first_lz4.mcap", "first_zstd.mcap"];

fn bytes(name: &str) -> Vec<u8> {
    std::fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/trajectory").join(name)).unwrap()
}

fn text(name: &str) -> String {
    String::from_utf8(bytes(name)).unwrap()
}

/// The experiment with additional keys and tables.
fn with(keys: &str, tables: &str) -> Experiment {
    Experiment::from_toml(&format!("{keys}{}{tables}", text("walk.toml"))).unwrap()
}

fn read_bytes(bytes: &[u8], experiment: &Experiment) -> Result<Log> {
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), bytes).unwrap();
    read(file.path(), experiment)
}

/// The first rows of the log as CSV.
fn rows(count: usize) -> Vec<u8> {
    text("walk.csv").lines().take(1 + count).flat_map(|line| [line, "\n"]).collect::<String>().into_bytes()
}

fn numbers(run: &Run) -> Vec<f64> {
    let since = run.t.iter().map(|t| t - run.t[0]).collect();
    [since, run.q.concat(), run.qd.concat(), run.tau.concat(), run.gyro.concat(), run.acc.concat()]
        .into_iter()
        .chain(run.attitude.clone())
        .flatten()
        .collect()
}

fn alike(got: &Log, want: &Log, close: f64) {
    assert_eq!(got.runs.len(), want.runs.len());
    for (a, b) in got.runs.iter().zip(&want.runs) {
        let (a, b) = (numbers(a), numbers(b));
        assert_eq!(a.len(), b.len());
        let apart = a.iter().zip(&b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(apart <= close, "{apart}");
    }
}

#[test]
fn three_formats_give_the_same_log() {
    let want = read_bytes(&bytes("walk.csv"), &with("", "")).unwrap();
    alike(&read_bytes(&bytes("walk.parquet"), &with("", "")).unwrap(), &want, 0.0);
    let mcap = Experiment::from_toml(&text("walk_mcap.toml")).unwrap();
    let got = read_bytes(&bytes("walk.mcap"), &mcap).unwrap();
    // In the MCAP file, the runs begin at 0, 10 and 20 s.
    alike(&got, &want, 1e-14);
    for (a, b) in got.runs.iter().zip(&want.runs) {
        assert_eq!((&a.name, &a.condition, &a.leg), (&b.name, &b.condition, &b.leg));
        assert_eq!((a.slope_deg, a.frequency), (b.slope_deg, b.frequency));
    }
}

#[test]
fn each_compression_gives_the_same_log() {
    let want = read_bytes(&rows(60), &with("", "")).unwrap();
    for name in PARQUET {
        alike(&read_bytes(&bytes(name), &with("", "")).unwrap(), &want, 0.0);
    }
    let keys = "leg = \"L\"\nslope_deg = 5.0\nstride_frequency = 3.0\n";
    for name in MCAP {
        alike(&read_bytes(&bytes(name), &with(keys, "")).unwrap(), &want, 1e-14);
    }
}

#[test]
fn errors_of_files_are_one_line() {
    let told = |bytes: &[u8], experiment: &Experiment, words: &str| {
        let error = read_bytes(bytes, experiment).err().map(|e| e.to_string()).unwrap_or_default();
        assert!(error.contains(words) && !error.contains('\n'), "{error:?} lacks {words:?}");
    };
    let mcap = bytes("walk.mcap");
    told(&mcap, &with("", "[topics]\nimu = \"/other\"\n"), "no topic of sensor_msgs/msg/Imu");
    told(&mcap, &with("", ""), "split it into two runs");
    told(&mcap, &with("", "[[run]]\nfrom = 100.0\n"), "no rows");
    told(&mcap[..mcap.len() / 2], &with("", ""), "MCAP:");
    let mut damaged = bytes("first_none.mcap");
    let middle = damaged.len() / 2;
    damaged[middle] ^= 1;
    told(&damaged, &with("", ""), "its checksum does not match");
    told(&rows(60), &with("", "[topics]\nimu = \"/imu\"\n"), "only MCAP files");
    told(&rows(60), &with("", "[[run]]\nfrom = 1.0\n"), "only MCAP files");
    for name in PARQUET {
        let parquet = bytes(name);
        told(&parquet, &with("", "[columns]\nt = \"time\"\n"), "time: missing; the header has run, condition");
        told(&parquet, &with("", "[topics]\nimu = \"/imu\"\n"), "only MCAP files");
        told(&parquet[..parquet.len() / 2], &with("", ""), "Parquet:");
        told(&parquet[..9], &with("", ""), "Parquet:");
    }
}

/// Randomly changed files give a log or an error of one line. `SANDGAIT_MUTATED_LOGS` sets the number for each original.
#[test]
fn mutated_files_do_not_panic() {
    let count = std::env::var("SANDGAIT_MUTATED_LOGS").map_or(40, |n| n.parse().unwrap());
    let keys = "leg = \"L\"\nslope_deg = 5.0\nstride_frequency = 3.0\n";
    let named = PARQUET.iter().chain(&MCAP).map(|name| (*name, bytes(name)));
    let (mut read, mut refused) = (0, 0);
    for (name, whole) in named.chain([("walk.csv", rows(60))]) {
        let experiment = with(keys, "");
        assert!(read_bytes(&whole, &experiment).is_ok(), "{name}");
        for seed in 0..count {
            let bytes = mutated(&whole, &mut Xoshiro256PlusPlus::seed_from_u64(seed));
            match read_bytes(&bytes, &experiment) {
                Ok(_) => read += 1,
                Err(error) => {
                    assert!(!error.to_string().contains('\n'), "{name}, {seed}: {error}");
                    refused += 1;
                }
            }
        }
    }
    println!("{read} files were read, {refused} refused");
    assert!(read > 0 && refused > read / 2, "{read} read, {refused} refused");
}

fn mutated(bytes: &[u8], rng: &mut impl Rng) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    for _ in 0..rng.random_range(1..8) {
        // Half of the changes are near the end, where Parquet has its footer.
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
