//! The sensors of a session: from exact values to the rows that policies get.

use super::extra::{self, Measure, Moment};
use super::memory::{SensorMemory, shift};
use super::signal::{Signal, wrapped};
use super::{Hardware, Part, Sensor, Sensors};
use crate::error::{Error, Result};
use crate::feature::Features;
use crate::sim::{Model, State};
use crate::spec::{Column, Spec};
use rand::{Rng as _, SeedableRng as _};
use rand_xoshiro::Xoshiro256PlusPlus;

/// Separates the sensors' random numbers from those of the episode: an arbitrary number.
const STREAM: u64 = 0x5e15_0125;

/// How a session's observations follow from exact values.
pub struct Plan {
    sensors: Sensors,
    /// Columns of exact values: the task's, then those of added sensors.
    exact: Vec<Column>,
    added: Features<Measure>,
    signals: Vec<Signal>,
    /// Signals of joint positions and speeds, joint by joint, if speeds are differences of positions.
    speeds: Vec<[usize; 2]>,
    /// Exact columns that the policy gets.
    shown: Vec<usize>,
    /// Number of rows that policies get at once, and of sampled rows that are kept.
    history: usize,
    kept: usize,
    privileged: bool,
    period: f64,
}

/// The episode whose sensors are read.
pub struct Seen<'a> {
    pub model: &'a Model,
    pub footing: &'a [f64],
    /// State before and after the step; at the beginning of an episode both are its first state.
    pub states: [&'a State; 2],
    /// Seed, number and step of the episode: the random numbers are a function of them.
    pub at: [u64; 3],
    /// Duration of the step [s].
    pub period: f64,
}

impl Plan {
    /// None: the sensors are exact, and rows are as the task fills them. `spec` becomes that of the session.
    ///
    /// # Errors
    /// Names a sensor that the task does not observe and that cannot be added.
    pub fn new(options: &Hardware, model: &Model, spec: &mut Spec) -> Result<Option<Self>> {
        let Hardware { sensors, history, privileged, .. } = options;
        let sensors = sensors.0.clone();
        if sensors == Sensors::default() && *history == 1 && !privileged {
            return Ok(None);
        }
        let own: Vec<Sensor> = spec.observation.iter().filter_map(|c| c.sensor.map(|(sensor, _)| sensor)).collect();
        let added = extra::added(&sensors, &own, model);
        let exact = [spec.observation.clone(), added.columns()].concat();
        let measured = |sensor: Sensor| exact.iter().any(|c| c.sensor.is_some_and(|(s, _)| s == sensor));
        if let Some(sensor) = Sensor::ALL.into_iter().find(|s| sensors.of(*s).is_some() && !measured(*s)) {
            return Err(Error::invalid(
                format!("sensors.{}", sensor.name()),
                format!("{} does not observe it", spec.id),
            ));
        }
        let signals = signals(&exact, &sensors);
        let speeds = if sensors.velocity_by_differences { speeds(&exact, &signals)? } else { Vec::new() };
        let left_out = |c: &Column| c.sensor.is_some_and(|(s, _)| sensors.without.iter().any(|w| w == s.name()));
        let shown: Vec<usize> = (0..exact.len()).filter(|i| !left_out(&exact[*i])).collect();
        let period = 1.0 / spec.control_rate;
        let longest = signals.iter().map(|s| s.imperfections.delay).fold(0.0, f64::max);
        // The newest row, those back to the longest delay, and one to interpolate or to take differences from.
        let kept = (longest / period).ceil() as usize + 2;
        let history = *history as usize;
        let of_step = |back: usize| {
            let named = move |c: &Column| match back {
                0 => c.clone(),
                _ => Column { name: format!("{} ({back} steps before)", c.name), ..c.clone() },
            };
            shown.iter().map(|i| named(&exact[*i])).collect::<Vec<_>>()
        };
        spec.observation = (0..history).flat_map(of_step).collect();
        if *privileged {
            let named = |c: &Column| Column { name: format!("privileged {}", c.name), ..c.clone() };
            spec.info.extend(exact.iter().map(named));
        }
        Ok(Some(Self { sensors, exact, added, signals, speeds, shown, history, kept, privileged: *privileged, period }))
    }

    /// Number of the task's own columns.
    fn own(&self) -> usize {
        self.exact.len() - self.added.len()
    }

    fn sizes(&self) -> [usize; 3] {
        [self.signals.len(), self.kept * self.exact.len(), self.history * self.shown.len()]
    }

    /// Numbers that an episode's sensors remember.
    pub fn numbers(&self) -> usize {
        let [signals, sampled, seen] = self.sizes();
        2 * signals + sampled + seen
    }

    /// An episode's memory from a snapshot.
    pub fn resume(&self, numbers: &[f32]) -> Option<SensorMemory> {
        SensorMemory::from_numbers(numbers, self.sizes())
    }

    /// Fills the first observation of an episode, if its memory is empty; else that of the next step. `observe` fills a row
    /// of the task's own columns.
    pub fn sense(
        &self,
        memory: &mut SensorMemory,
        seen: &Seen,
        observe: impl FnOnce(&mut [f32]),
        out: [&mut [f32]; 2],
    ) {
        let width = self.exact.len();
        let begins = memory.past.is_empty() && memory.sampled.is_empty();
        if begins {
            let [_, sampled, rows] = self.sizes();
            (memory.sampled, memory.seen) = (vec![0.0; sampled], vec![0.0; rows]);
        }
        shift(&mut memory.sampled, width);
        let (row, before) = memory.sampled.split_at_mut(width);
        self.fill_exact(row, seen, observe);
        let [observation, info] = out;
        self.tell(row, info);
        let [seed, number, step] = seen.at;
        let mut random = stream(seed, number, step);
        if begins {
            memory.past = self.signals.iter().map(|s| s.begin(&mut random, self.period, row)).collect();
            self.speeds.iter().for_each(|[_, speed]| self.signals[*speed].set(row, 0.0));
            let first = row.to_vec();
            before.chunks_exact_mut(width).for_each(|old| old.copy_from_slice(&first));
        } else {
            for (signal, past) in self.signals.iter().zip(&mut memory.past) {
                signal.sample(&mut random, self.period, past, row);
            }
            for [position, speed] in &self.speeds {
                let position = &self.signals[*position];
                let change = position.value(row) - position.value(before);
                let change = if position.cosine.is_some() { wrapped(change) } else { change };
                self.signals[*speed].set(row, change / self.period);
            }
        }
        self.show(memory, &mut random, begins);
        observation.copy_from_slice(&memory.seen);
    }

    /// Fills the same rows again, after a restore. The accelerometer's privileged value is then that of a robot whose
    /// velocity does not change.
    pub fn repeat(&self, memory: &SensorMemory, seen: &Seen, observe: impl FnOnce(&mut [f32]), out: [&mut [f32]; 2]) {
        let [observation, info] = out;
        observation.copy_from_slice(&memory.seen);
        if self.privileged {
            let mut row = vec![0.0; self.exact.len()];
            self.fill_exact(&mut row, seen, observe);
            self.tell(&row, info);
        }
    }

    /// Copies privileged values to the end of an info row, if there is one.
    fn tell(&self, exact: &[f32], info: &mut [f32]) {
        if self.privileged && !info.is_empty() {
            let start = info.len() - exact.len();
            info[start..].copy_from_slice(exact);
        }
    }

    fn fill_exact(&self, row: &mut [f32], seen: &Seen, observe: impl FnOnce(&mut [f32])) {
        let (own, others) = row.split_at_mut(self.own());
        observe(own);
        let moment = Moment::new(seen.model, seen.footing, seen.states, seen.period, self.sensors.imu_position);
        self.added.fill(others, |measure, i| measure(&moment, i));
        clip(row, &self.exact);
    }

    /// Adds the row that the policy gets now.
    fn show(&self, memory: &mut SensorMemory, random: &mut Xoshiro256PlusPlus, begins: bool) {
        let width = self.exact.len();
        let mut row = memory.sampled[..width].to_vec();
        for signal in &self.signals {
            let delay = signal.imperfections.delay / self.period;
            let (whole, part) = ((delay + 1e-9).floor() as usize, (delay - (delay + 1e-9).floor()).max(0.0) as f32);
            let lost = signal.imperfections.dropout > 0.0 && random.random_bool(signal.imperfections.dropout);
            for column in signal.columns() {
                let sampled = |back: usize| memory.sampled[back * width + column];
                row[column] = match self.shown.iter().position(|i| *i == column) {
                    Some(place) if lost && !begins => memory.seen[place],
                    // A delay of whole steps copies bits.
                    _ if part < 1e-6 => sampled(whole),
                    _ => sampled(whole) + (sampled(whole + 1) - sampled(whole)) * part,
                };
            }
        }
        clip(&mut row, &self.exact);
        let wide = self.shown.len();
        shift(&mut memory.seen, wide);
        let places = if begins { self.history } else { 1 };
        for out in memory.seen.chunks_exact_mut(wide).take(places) {
            out.iter_mut().zip(&self.shown).for_each(|(out, i)| *out = row[*i]);
        }
    }
}

fn clip(row: &mut [f32], columns: &[Column]) {
    row.iter_mut().zip(columns).for_each(|(x, c)| *x = x.clamp(c.low as f32, c.high as f32));
}

/// One signal for each value of a sensor that has an entry, in the order of the columns.
fn signals(exact: &[Column], sensors: &Sensors) -> Vec<Signal> {
    let mut all: Vec<Signal> = Vec::new();
    for (i, column) in exact.iter().enumerate() {
        let Some((sensor, part)) = column.sensor else { continue };
        let differences =
            sensors.velocity_by_differences && matches!(sensor, Sensor::JointPosition | Sensor::JointVelocity);
        let Some(imperfections) = sensors.of(sensor).or_else(|| differences.then(Default::default)) else { continue };
        match Signal::new(i, part, imperfections) {
            Some(signal) => all.push(signal),
            // The columns of cosines come after those of sines, in the same order.
            None => {
                let sine = |s: &&mut Signal| s.cosine.is_none() && exact[s.column].sensor == Some((sensor, Part::Sine));
                if let Some(angle) = all.iter_mut().find(sine) {
                    angle.cosine = Some(i);
                }
            }
        }
    }
    all
}

/// Pairs of signals: position and speed of each joint.
fn speeds(exact: &[Column], signals: &[Signal]) -> Result<Vec<[usize; 2]>> {
    let of = |sensor: Sensor| {
        let is = move |k: &usize| exact[signals[*k].column].sensor.is_some_and(|(s, _)| s == sensor);
        (0..signals.len()).filter(is).collect::<Vec<_>>()
    };
    let (positions, rates) = (of(Sensor::JointPosition), of(Sensor::JointVelocity));
    if rates.is_empty() || positions.len() != rates.len() {
        return Err(Error::invalid(
            "sensors.velocity_by_differences",
            "the task does not observe position and speed of each joint",
        ));
    }
    Ok(positions.into_iter().zip(rates).map(|(position, rate)| [position, rate]).collect())
}

/// The random numbers of one step of an episode. The numbers are mixed by the finalizer of splitmix64 (Steele, Lea & Flood,
/// OOPSLA 2014), so neighbouring ones give unrelated streams.
pub(super) fn stream(seed: u64, number: u64, step: u64) -> Xoshiro256PlusPlus {
    let mixed = [seed, number, step].into_iter().fold(STREAM, |sum, x| {
        let mut z = (sum ^ x).wrapping_add(0x9e37_79b9_7f4a_7c15);
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    });
    Xoshiro256PlusPlus::seed_from_u64(mixed)
}
