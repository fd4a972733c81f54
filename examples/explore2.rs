use sandgait::diagnose::{experiment::Experiment, fit::*, force_log, forward::*, noise::*, select::*, whiten::Whitener};
use sandgait::sand::mechanism::*;
use std::{path::Path, time::Instant};
fn main() {
    let args: Vec<String> = std::env::args().collect();
    let e = Experiment::load(Path::new(&args[1])).unwrap();
    for file in &args[2..] {
        let t0 = Instant::now();
        let log = force_log::read(Path::new(file), &e).unwrap();
        let model = ForceLogModel::new(&log, &e).unwrap();
        let obs = &log.observations;
        let m0 = model.predict(&Mechanisms::default(), &e.medium.coefficients);
        let mag = magnitudes(obs);
        let noise = Noise::estimate(obs, &m0, &mag, None);
        let w = Whitener::new(obs, &noise, &mag, &m0);
        let s = Study { observations: obs, model: &model, whitener: &w, coefficient_sd: e.coefficient_sd };
        let ids: Vec<usize> = model.testable().iter().filter(|t| t.1.is_none()).map(|t| t.0).collect();
        let r = select(&s, &noise, &ids);
        println!("== {file} {:?}  {:?} gate {:.1} lof {:.3} limit {:.3} infl {:.2} rmse plain {:.4} recal {:.4} floor {:.4}", t0.elapsed(), r.verdict, r.gates.single, r.base_lack_of_fit, r.gates.lack_of_fit, r.gates.inflation, r.plain_held_out.rmse(), r.base_held_out.rmse(), noise_floor(obs, &m0, &mag));
        for c in r.candidates.iter().take(5) {
            let names: Vec<_> = c.fit.ids.iter().map(|&i| CATALOG[i].id).collect();
            println!("   {names:?} {:?} d {:.1} lof {:.3} rmse {:.4}", c.fit.values(), c.delta_chi2, c.lack_of_fit, c.held_out.rmse());
        }
        println!("   set {:?}", r.set.iter().map(|&k| r.candidates[k].fit.ids.iter().map(|&i| CATALOG[i].id).collect::<Vec<_>>()).collect::<Vec<_>>());
    }
}
