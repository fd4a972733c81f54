//! Dirt of a load cell put into a force log: zeros that differ from trial to trial, drift, steps.

use super::normal;
use rand::SeedableRng;
use rand_xoshiro::Xoshiro256PlusPlus;

/// The same log with an offset of `offset` [N] (standard deviation) in each channel of each trial, a drift of as much until its end,
/// and readings in steps of 0.01 N; the torque 0.05 m times as much of all.
pub fn dirty(log: &str, offset: f64) -> String {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(78);
    let mut lines = log.lines();
    let header = lines.next().unwrap();
    let columns: Vec<&str> = header.split(',').collect();
    let loads = ["Fx", "Fz", "Ty"].map(|name| columns.iter().position(|h| *h == name).unwrap());
    let rows: Vec<Vec<String>> = lines.map(|l| l.split(',').map(String::from).collect()).collect();
    let mut out = vec![header.to_string()];
    for rows in rows.chunk_by(|a, b| a[0] == b[0]) {
        let own: Vec<[f64; 2]> = loads.iter().map(|_| [(); 2].map(|()| offset * normal(&mut rng))).collect();
        for (i, row) in rows.iter().enumerate() {
            let mut row = row.clone();
            for ((&k, [zero, drift]), arm) in loads.iter().zip(&own).zip([1.0, 1.0, 0.05]) {
                let read = row[k].parse::<f64>().unwrap() + arm * (zero + drift * i as f64 / rows.len() as f64);
                row[k] = format!("{:.6}", (read / (0.01 * arm)).round() * 0.01 * arm);
            }
            out.push(row.join(","));
        }
    }
    out.join("\n")
}
