//! The full study of the diagnosis on data of our own test-bed: writes a table for docs/diagnosis_study.md.
//!
//! Usage: diagnosis_study SEEDS NULLS SETS [CAUSES [FIRST]], with defaults in parentheses. SEEDS is the number of logs
//! for each mechanism (3), NULLS the number of logs without a hidden cause (40), SETS the number of sets of walking
//! runs for each cause (1). CAUSES selects the hidden causes by their ids, with commas between (also `nothing`,
//! `outside`, `forms` and `pairs`). FIRST is the number of the first seed (0). With CAUSES and FIRST a long study can
//! be made in parts, whose tables can be joined.

#[path = "../tests/testbed/walking.rs"]
mod hall;
#[path = "../tests/testbed/mod.rs"]
mod testbed;
#[path = "../tests/testbed/truth.rs"]
mod truth;

use rand::{Rng, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;
use sandgait::diagnose::diagnose;
use sandgait::diagnose::experiment::Experiment;
use sandgait::diagnose::force_log;
use sandgait::diagnose::force_model::ForceLogModel;
use sandgait::diagnose::forward::ForwardModel;
use sandgait::diagnose::noise::{ChannelNoise, Noise, NoiseClock, NoiseData, sizes};
use sandgait::diagnose::report::{Cause, Report, Tried};
use sandgait::diagnose::shared::{SharedNoise, Uncertainty};
use sandgait::diagnose::study::FitInputs;
use sandgait::diagnose::verdict::Verdict;
use sandgait::diagnose::whiten::Whitener;
use sandgait::parallel;
use sandgait::progress::Silent;
use sandgait::sand::mechanism::{CATALOG, Mechanisms};
use std::error::Error;
use std::ops::Range;
use std::path::Path;
use std::time::Instant;
use testbed::{Design, Hidden, Log};

type Outcome<T> = Result<T, Box<dyn Error>>;

fn experiment() -> Outcome<Experiment> {
    Ok(Experiment::from_toml(testbed::EXPERIMENT)?)
}

fn report(log: &Log, name: &str) -> Outcome<Report> {
    let path = std::env::temp_dir().join(format!("sandgait-study-{}-{name}.csv", std::process::id()));
    std::fs::write(&path, &log.noisy)?;
    let diagnosis = diagnose(&path, &experiment()?, &Silent);
    std::fs::remove_file(&path)?;
    let diagnosis = diagnosis?;
    let violated = truth::contradictions(&serde_json::from_str(&diagnosis.json()?)?);
    let report = diagnosis.report;
    if violated.is_empty() { Ok(report) } else { Err(violated.join("; ").into()) }
}

/// Distance [σ] from the log without noise to the nearest model without `cause`. Every other single cause is fitted to
/// this log; the distance is the root of the least whitened sum of squares.
fn separation(log: &Log, cause: &str, name: &str) -> Outcome<f64> {
    let path = std::env::temp_dir().join(format!("sandgait-clean-{}-{name}.csv", std::process::id()));
    std::fs::write(&path, &log.clean)?;
    let read = read_and_remove(&path);
    let (read, experiment) = (read?, experiment()?);
    let model = ForceLogModel::new(&read, &experiment)?;
    let channel =
        |arm: f64| ChannelNoise { grain: arm * testbed::GRAIN, sensor: arm * testbed::SENSOR, phi: testbed::PHI };
    let channels = vec![channel(1.0), channel(1.0), channel(testbed::ARM)];
    let noise = Noise { clock: NoiseClock::Sample, channels, shared: vec![testbed::GAIN] };
    let o = &read.observations;
    let strength = SharedNoise {
        name: "bed_strength",
        unit: "1",
        guess: testbed::GAIN,
        optional: false,
        stacks: vec![o.values.clone()],
    };
    let uncertainty = Uncertainty { shared: vec![strength], common: Vec::new(), own: Vec::new() };
    let source = NoiseData {
        observations: o,
        prediction: &o.values,
        sizes: &sizes(o),
        uncertainty: &uncertainty,
        left_out: &[],
    };
    let whitener = Whitener::new(&source, &noise);
    // Sensor mechanisms are rivals here, so nuisances are left out.
    let study = FitInputs::new(o, &model, &whitener).under(&whitener, Vec::new());
    let truth = CATALOG.iter().position(|m| m.id == cause).map(|id| study.fit(&[id], &[CATALOG[id].typical]).objective);
    let rivals: Vec<usize> = model.testable().into_iter().map(|t| t.0).filter(|&id| CATALOG[id].id != cause).collect();
    let fits = parallel::map(&rivals, |&id| study.fit(&[id], &[0.3 * CATALOG[id].typical]).objective);
    let nearest = fits.into_iter().fold(f64::MAX, f64::min);
    Ok((nearest - truth.unwrap_or(0.0)).max(0.0).sqrt())
}

fn read_and_remove(path: &Path) -> Outcome<force_log::ForceLog> {
    let read = force_log::read(path, &experiment()?, &Silent);
    std::fs::remove_file(path)?;
    Ok(read?)
}

fn strength(id: &str, rng: &mut Xoshiro256PlusPlus) -> f64 {
    let Some(entry) = CATALOG.iter().find(|m| m.id == id) else {
        return 1.0;
    };
    // A typical strength is visible in a log. Drawn strengths are 0.1 to 2 times the typical one.
    let size = entry.typical * 0.1 * 20f64.powf(rng.random_range(0.0..1.0));
    if entry.bounds[0] < 0.0 && rng.random_range(0..2) == 0 { -size } else { size }
}

/// A strength of one to six times the mechanism's typical one, with a random sign and at most four fifths of its bound.
/// For the torque limit: from a value that the motors seldom reach to one at which they stall.
fn walking_strength(id: usize, rng: &mut Xoshiro256PlusPlus) -> f64 {
    let entry = &CATALOG[id];
    if entry.ceiling {
        return rng.random_range(0.011..0.02);
    }
    let size = entry.typical * 6f64.powf(rng.random_range(0.0..1.0));
    let negative = entry.bounds[0] < 0.0 && rng.random_range(0..2) == 0;
    if negative { (-size).max(0.8 * entry.bounds[0]) } else { size.min(0.8 * entry.bounds[1]) }
}

#[derive(Default)]
struct Tally {
    exact: usize,
    in_set: usize,
    wrong: usize,
    missed: usize,
    none: usize,
    total: usize,
}

impl Tally {
    fn row(&self, name: &str) -> String {
        let Tally { exact, in_set, wrong, missed, none, total } = self;
        format!("| {name} | {total} | {exact} | {in_set} | {wrong} | {missed} | {none} |")
    }
}

fn main() -> Outcome<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let number = |k: usize, default: usize| arguments.get(k).map_or(Ok(default), |a| a.parse());
    let (seeds, nulls, sets, first) = (number(0, 3)?, number(1, 40)?, number(2, 1)?, number(4, 0)?);
    let asked = |cause: &str| arguments.get(3).is_none_or(|all| all.split(',').any(|c| c == cause));
    let start = Instant::now();
    singles(first..first + seeds, Design::Crossed, &asked)?;
    singles(first.div_ceil(3)..(first + seeds).div_ceil(3), Design::Covarying, &asked)?;
    if asked("outside") {
        outside(first..first + seeds)?;
    }
    if asked("forms") {
        forms(first..first + seeds)?;
    }
    if asked("pairs") {
        pairs(8 * first..8 * (first + seeds))?;
    }
    false_alarms(first..first + nulls)?;
    println!("force logs took {:.0} s", start.elapsed().as_secs_f64());
    walking(first..first + sets, &asked)?;
    println!("all took {:.0} s", start.elapsed().as_secs_f64());
    Ok(())
}

/// Diagnoses sets of walking runs from engine rapier. Each set has one hidden cause of random strength and sign, or no
/// cause. Prints one line for each set.
fn walking(sets: Range<usize>, asked: &dyn Fn(&str) -> bool) -> Outcome<()> {
    let experiment = Experiment::from_toml(hall::EXPERIMENT)?;
    println!(
        "\n| hidden in walking runs | seed | value | σ from plain | verdict | found | nearest rivals | lack of fit, limit | time |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    let causes = CATALOG.iter().enumerate().filter(|(_, m)| m.walking).map(|(id, _)| Some(id));
    let (mut tally, mut took) = (Tally::default(), 0.0f64);
    for (place, id) in causes.chain([None; 4]).enumerate() {
        let name = id.map_or("nothing", |id| CATALOG[id].id);
        for set in sets.clone().filter(|_| asked(name)).map(|s| s as u64) {
            let seed = 30 + 100 * place as u64 + set;
            let value = id.map_or(0.0, |id| walking_strength(id, &mut Xoshiro256PlusPlus::seed_from_u64(seed)));
            let hidden = id.map_or(Mechanisms::PLAIN, |id| Mechanisms::PLAIN.with(id, value));
            let path = std::env::temp_dir().join(format!("sandgait-walks-{}.csv", std::process::id()));
            let conditions = if id.is_some() { hall::drawn(seed) } else { hall::orderly() };
            std::fs::write(&path, hall::runs(seed, &conditions, hidden, 0.05))?;
            let start = Instant::now();
            let diagnosis = diagnose(&path, &experiment, &Silent);
            let seconds = start.elapsed().as_secs_f64();
            took = took.max(seconds);
            std::fs::remove_file(&path)?;
            let r = diagnosis?.report;
            let contains = r.ambiguity_set.iter().any(|s| s.len() == 1 && s[0] == name);
            tally.total += 1;
            tally.exact += usize::from(r.verdict == Verdict::Named && contains);
            tally.in_set += usize::from(contains);
            tally.wrong += usize::from(r.verdict == Verdict::Named && !contains);
            tally.missed += usize::from(r.verdict == Verdict::NoiseFloor && id.is_some());
            tally.none += usize::from(r.verdict == Verdict::NoneOfThese);
            let interval = |c: &Cause| format!("{} {:.4} ({:.4} to {:.4})", c.id, c.value, c.ci95[0], c.ci95[1]);
            let found: Vec<_> = r.causes.iter().map(interval).collect();
            let truth = r.candidates.iter().find(|t| t.ids == [name]);
            let away = truth.map_or(0.0, |t| t.delta_chi2.max(0.0).sqrt());
            let rivals = r.candidates.iter().skip(1).take(3);
            let rival = |t: &Tried| format!("{} {:.1} σ", t.ids.join(" + "), t.distance_to_best.unwrap_or(f64::NAN));
            let rivals: Vec<_> = rivals.map(rival).collect();
            let fit = [r.lack_of_fit.plain, r.lack_of_fit.extended, r.lack_of_fit.limit];
            let fit: Vec<_> = fit.iter().map(|f| f.map_or("–".into(), |f| format!("{f:.2}"))).collect();
            println!(
                "| {name} | {seed} | {value:.4} | {:.1} | {:?} | {} | {} | {} | {seconds:.0} s |",
                away,
                r.verdict,
                found.join(", "),
                rivals.join(", "),
                fit.join(", ")
            );
        }
    }
    println!("\n{}\nslowest diagnosis {took:.0} s", tally.row("walking sets"));
    Ok(())
}

fn normal(rng: &mut Xoshiro256PlusPlus) -> f64 {
    StandardNormal.sample(rng)
}

fn singles(seeds: Range<usize>, design: Design, asked: &dyn Fn(&str) -> bool) -> Outcome<()> {
    println!("\n{design:?}");
    let mut bands = [(); 4].map(|()| Tally::default());
    let (mut errors, mut covered, mut named, mut achieved) = (Vec::new(), 0, 0, Vec::new());
    for entry in CATALOG.iter().filter(|m| m.intrusion && asked(m.id)) {
        for seed in seeds.clone() {
            let seed = 1000 + seed as u64 * 97 + entry.id.len() as u64 * 7919 + u64::from(entry.id.as_bytes()[0]);
            let value = strength(entry.id, &mut Xoshiro256PlusPlus::seed_from_u64(seed));
            let log = testbed::log_of(design, seed, &Hidden { causes: vec![(entry.id, value)] }, 0.05);
            let far = separation(&log, entry.id, entry.id)?;
            let r = report(&log, entry.id)?;
            let tally = &mut bands[if far < 3.0 {
                0
            } else if far < 5.0 {
                1
            } else if far < 8.0 {
                2
            } else {
                3
            }];
            tally.total += 1;
            let contains = r.ambiguity_set.iter().any(|s| s.len() == 1 && s[0] == entry.id);
            let found = r.verdict == Verdict::Named && contains;
            tally.exact += usize::from(found);
            tally.in_set += usize::from(contains);
            tally.wrong += usize::from(r.verdict == Verdict::Named && !contains);
            tally.missed += usize::from(r.verdict == Verdict::NoiseFloor);
            tally.none += usize::from(r.verdict == Verdict::NoneOfThese);
            println!(
                "{:14} {seed} {value:9.5} sep {far:6.1} eff {:5.2} {:?} {:?} {:?} lof {:?} achieved {:?}",
                entry.id,
                log.effect,
                r.verdict,
                r.ambiguity_set,
                r.causes.first().map(|c| (c.value, c.ci95)),
                r.lack_of_fit,
                r.gain.achievable_fraction
            );
            if let (true, Some(c)) = (found, r.causes.first()) {
                named += 1;
                covered += usize::from((c.ci95[0]..=c.ci95[1]).contains(&value));
                if far >= 12.0 {
                    errors.push((c.value / value - 1.0).abs());
                }
                if far >= 8.0 {
                    achieved.extend(r.gain.achievable_fraction);
                }
            }
        }
    }
    println!(
        "\n| separation | logs | exact | truth in the set | confidently wrong | called noise | none of these |\n|---|---|---|---|---|---|---|"
    );
    for (name, tally) in ["< 3 σ", "3–5 σ", "5–8 σ", "≥ 8 σ"].iter().zip(&bands) {
        println!("{}", tally.row(name));
    }
    errors.sort_by(f64::total_cmp);
    achieved.sort_by(f64::total_cmp);
    let at = |v: &[f64], share: f64| v.get((v.len() as f64 * share) as usize).copied().unwrap_or(f64::NAN);
    println!(
        "coverage {covered}/{named}; value error at ≥ 12 σ median {:.3} p90 {:.3}; achievable fraction median {:.3}",
        at(&errors, 0.5),
        at(&errors, 0.9),
        at(&achieved, 0.5)
    );
    Ok(())
}

fn outside(seeds: Range<usize>) -> Outcome<()> {
    let mut tally = Tally::default();
    for id in ["wall", "crust", "stick_slip", "buried_stone", "drag_1.5"] {
        for seed in seeds.clone().map(|s| s as u64) {
            let mut rng = Xoshiro256PlusPlus::seed_from_u64(77 + seed);
            let value = rng.random_range(0.4..1.5);
            let log = testbed::log(5000 + seed * 31 + id.len() as u64, &Hidden { causes: vec![(id, value)] }, 0.05);
            let r = report(&log, id)?;
            println!(
                "{id:14} {value:.2} eff {:.2} {:?} {:?} {:?}",
                log.effect, r.verdict, r.ambiguity_set, r.lack_of_fit
            );
            if id != "drag_1.5" && log.effect >= 0.5 {
                tally.total += 1;
                tally.none += usize::from(r.verdict == Verdict::NoneOfThese);
                tally.wrong += usize::from(r.verdict == Verdict::Named);
                tally.missed += usize::from(r.verdict == Verdict::NoiseFloor);
            }
        }
    }
    println!("{}", tally.row("outside the catalogue, effect/noise ≥ 0.5"));
    Ok(())
}

/// Drag with the law's exponent of the speed and with another, over wide and narrow ranges of speed and with less
/// and more noise.
fn forms(seeds: Range<usize>) -> Outcome<()> {
    println!(
        "\n| power | speeds | noise | logs | inertial_drag named | excluded | told apart | interval holds | in the set |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    for (id, power) in [("inertial_drag", 2.0), ("drag_1.5", 1.5)] {
        for (design, loud) in [0.5, 1.0, 2.0].iter().flat_map(|l| [Design::Crossed, Design::Narrow].map(|d| (d, *l))) {
            let (mut named, mut excluded, mut apart, mut holds, mut asked, mut set) = (0, 0, 0, 0, 0, 0);
            for seed in seeds.clone().map(|s| s as u64) {
                let share: f64 = Xoshiro256PlusPlus::seed_from_u64(700 + seed).random_range(0.0..1.0);
                let value = 0.1 * 15f64.powf(share);
                let hidden = Hidden { causes: vec![(id, value)] };
                let r = report(&testbed::noisy_log(design, loud, 7000 + seed * 31, &hidden, 0.05), "form")?;
                let drag = r.ambiguity_set.iter().any(|s| s == &["inertial_drag"]);
                set += usize::from(drag);
                named += usize::from(drag && r.verdict == Verdict::Named);
                println!("{id} {value:.2} {design:?} ×{loud}: {:?} {:?} {:?}", r.verdict, r.ambiguity_set, r.form);
                if let Some(form) = &r.form {
                    asked += 1;
                    excluded += usize::from(form.excluded);
                    apart += usize::from(form.told_apart);
                    holds += usize::from((form.ci95[0]..=form.ci95[1]).contains(&power));
                }
            }
            println!(
                "| {power} | {design:?} | {loud} | {} | {named} | {excluded} | {apart} | {holds} of {asked} | {set} |",
                seeds.len()
            );
        }
    }
    Ok(())
}

fn pairs(seeds: Range<usize>) -> Outcome<()> {
    let ids: Vec<&'static str> = CATALOG.iter().filter(|m| m.intrusion).map(|m| m.id).collect();
    let (mut both, mut set, mut total) = (0, 0, 0);
    for seed in seeds.map(|s| s as u64) {
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(9000 + seed);
        let a = ids[rng.random_range(0..ids.len())];
        let b = ids[rng.random_range(0..ids.len())];
        if a == b {
            continue;
        }
        let values = [a, b].map(|id| strength(id, &mut rng) * 1.5);
        let apart: Outcome<Vec<f64>> = [(a, values[0]), (b, values[1])]
            .iter()
            .map(|&c| separation(&testbed::log(9000 + seed, &Hidden { causes: vec![c] }, 0.05), c.0, "pair"))
            .collect();
        if apart?.iter().any(|s| *s < 8.0) {
            continue;
        }
        let log = testbed::log(9000 + seed, &Hidden { causes: vec![(a, values[0]), (b, values[1])] }, 0.05);
        let r = report(&log, "pair")?;
        let holds = |s: &Vec<String>| s.len() == 2 && s.iter().any(|i| i == a) && s.iter().any(|i| i == b);
        total += 1;
        both += usize::from(r.verdict == Verdict::Named && holds(&r.ambiguity_set[0]));
        set += usize::from(r.ambiguity_set.iter().any(holds));
        println!("pair {a}+{b} {:?} {:?}", r.verdict, r.ambiguity_set);
    }
    println!("pairs, members ≥ 8 σ: {both} exact, {set} in the set, of {total}");
    Ok(())
}

fn false_alarms(seeds: Range<usize>) -> Outcome<()> {
    let (mut alarms, count) = (0, seeds.len());
    for seed in seeds.map(|s| s as u64) {
        let r = report(&testbed::log(20_000 + seed, &Hidden::default(), 0.05), "null")?;
        if r.verdict != Verdict::NoiseFloor {
            alarms += 1;
            println!(
                "false alarm: seed {seed} {:?} {:?} {:?} {:?}",
                r.verdict,
                r.ambiguity_set,
                r.lack_of_fit,
                r.candidates.first().map(|c| c.delta_chi2)
            );
        }
    }
    println!("false alarms {alarms} of {count}");
    Ok(())
}
