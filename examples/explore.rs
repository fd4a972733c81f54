use sandgait::diagnose::{experiment::Experiment, fit::*, force_log, forward::*, noise::*, whiten::Whitener, lack_of_fit, parallel};
use sandgait::sand::mechanism::*;
use std::{path::Path, time::Instant};
fn main() {
    let args: Vec<String> = std::env::args().collect();
    let e = Experiment::load(Path::new(&args[2])).unwrap();
    let t0 = Instant::now();
    let log = force_log::read(Path::new(&args[1]), &e).unwrap();
    let model = ForceLogModel::new(&log, &e).unwrap();
    let obs = &log.observations;
    println!("read {:?}", t0.elapsed());
    let t0 = Instant::now();
    let m0 = model.predict(&Mechanisms::default(), &e.medium.coefficients);
    println!("predict {:?}", t0.elapsed());
    let mag = magnitudes(obs);
    let t0 = Instant::now();
    let noise = Noise::estimate(obs, &m0, &mag, None);
    println!("noise {:?} {:?}", t0.elapsed(), noise);
    let t0 = Instant::now();
    Noise::estimate(obs, &m0, &mag, Some(&noise));
    println!("again {:?}", t0.elapsed());
    let w = Whitener::new(obs, &noise, &mag, &m0);
    let s = Study { observations: obs, model: &model, whitener: &w, coefficient_sd: e.coefficient_sd };
    let base = s.recalibrated();
    println!("plain {:.1} recal {:.1} N {} lof {:.3} {:.3}", s.plain().objective, base.objective, obs.values.len(), lack_of_fit::statistic(obs, &s.plain().white), lack_of_fit::statistic(obs, &base.white));
    let t0 = Instant::now();
    let ids: Vec<usize> = model.testable().iter().filter(|t| t.1.is_none()).map(|t| t.0).collect();
    let fits = parallel::map(&ids, |&i| s.fit(&[i], &[CATALOG[i].typical * 0.5]));
    println!("singles {:?}", t0.elapsed());
    let mut order: Vec<_> = fits.iter().collect();
    order.sort_by(|a, b| a.objective.total_cmp(&b.objective));
    for f in order.iter().take(19) {
        let sd = f.covariance()[(0, 0)].sqrt();
        println!("{:14} {:10.5} ± {:.5}  dchi2 {:8.1} lof {:.3}", CATALOG[f.ids[0]].id, f.values()[0], sd, base.objective - f.objective, lack_of_fit::statistic(obs, &f.white));
    }

    if let Some(which) = args.get(3) {
        let id = Mechanisms::index(which).unwrap();
        let f = fits.iter().find(|f| f.ids[0] == id).unwrap();
        let pairs = parallel::map(&ids, |&i| s.fit(&[id, i], &[f.values()[0], CATALOG[i].typical * 0.2]));
        for (i, p) in ids.iter().zip(&pairs) {
            if *i != id { println!("   + {:14} {:9.4} {:9.4} dchi2 {:.1} lof {:.3}", CATALOG[*i].id, p.values()[0], p.values()[1], f.objective - p.objective, lack_of_fit::statistic(obs, &p.white)); }
        }
        println!("dev {:?}", f.deviations.map(|d| (d * 100.0).round() / 100.0));
        for (u, unit) in obs.units.iter().enumerate() {
            if u % 3 != 0 { continue; }
            let mut line = format!("{:4} {:6} ", unit.condition, model.group(u));
            for c in 0..obs.channels.len() {
                let mut q = vec![0.0; unit.samples];
                for k in 0..3 { for (a, b) in q.iter_mut().zip(&f.white[obs.units[u + k].block(c)]) { *a += b / 3f64.sqrt(); } }
                let n = q.len();
                let chi: Vec<String> = q.chunks(n / 6).map(|p| format!("{:5.1}", p.iter().sum::<f64>() / (p.len() as f64).sqrt())).collect();
                line += &format!(" | {}", chi.join(" "));
            }
            println!("{line}");
        }
    }
}
