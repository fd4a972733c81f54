//! Adds the errors of a real load cell to a force log: offsets of each trial, drift, and a finite resolution.

use super::normal;
use rand::SeedableRng;
use rand_xoshiro::Xoshiro256PlusPlus;

/// Adds to each channel of each trial an offset with the standard deviation `offset` [N] and a drift of the same size until the end of
/// the trial, and rounds to steps of 0.01 N. For the torque, all of these are multiplied by 0.05 m.
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
