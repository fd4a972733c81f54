//! Adds samples at rest to a force log: real drives start from rest, stop, and go on.

use super::normal;
use rand::SeedableRng;
use rand_xoshiro::Xoshiro256PlusPlus;

/// How rests appear in the log.
#[derive(Clone, Copy, Debug)]
pub struct Rests {
    /// Samples at rest before, in the middle of, and after each trial.
    pub samples: [usize; 3],
    /// Noise of the velocities logged at rest, as a share of the trial's largest speed.
    pub noise: f64,
    /// Force at rest, as a share of the force just before.
    pub held: f64,
}

/// The same log with rests in every trial. Samples in motion are unchanged.
pub fn with_rests(log: &str, rests: Rests) -> String {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(77);
    let mut lines = log.lines();
    let header: Vec<&str> = lines.next().unwrap().split(',').collect();
    let place = |name: &str| header.iter().position(|h| *h == name).unwrap();
    let (trial, time) = (place("trial"), place("t"));
    let (speeds, loads) = (["omega", "vx", "vz"].map(place), ["Fx", "Fz", "Ty"].map(place));
    let rows: Vec<Vec<String>> = lines.map(|l| l.split(',').map(String::from).collect()).collect();
    let number = |row: &[String], k: usize| row[k].parse::<f64>().unwrap_or(0.0);
    let mut out = vec![header.join(",")];
    for rows in rows.chunk_by(|a, b| a[trial] == b[trial]) {
        let step = number(&rows[1], time) - number(&rows[0], time);
        let fastest = speeds.map(|k| rows.iter().map(|r| number(r, k).abs()).fold(0.0, f64::max));
        let mut shift = 0.0;
        let mut rest = |like: &[String], count: usize, shift: &mut f64, from: f64, out: &mut Vec<String>| {
            for i in 0..count {
                let mut row = like.to_vec();
                row[time] = format!("{:.9}", from + *shift + step * i as f64);
                for (k, fastest) in speeds.into_iter().zip(fastest) {
                    let noise = rests.noise * fastest * normal(&mut rng);
                    row[k] = if row[k].is_empty() { String::new() } else { format!("{noise:.9}") };
                }
                for k in loads {
                    row[k] = format!("{:.6e}", rests.held * number(like, k) + 0.01 * normal(&mut rng));
                }
                out.push(row.join(","));
            }
            *shift += step * count as f64;
        };
        for (i, row) in rows.iter().enumerate() {
            let at = number(row, time);
            match i {
                0 => rest(row, rests.samples[0], &mut shift, at, &mut out),
                i if i == rows.len() / 2 => rest(&rows[i - 1], rests.samples[1], &mut shift, at, &mut out),
                _ => (),
            }
            let mut moved = row.clone();
            moved[time] = format!("{:.9}", at + shift);
            out.push(moved.join(","));
        }
        let last = &rows[rows.len() - 1];
        rest(last, rests.samples[2], &mut shift, number(last, time) + step, &mut out);
    }
    out.join("\n")
}
