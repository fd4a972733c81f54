//! The sensors of a session: from exact values to the rows that policies get.

use super::extra::{self, Measure, MeasuredStep};
use super::memory::{SensorMemory, shift};
use super::random::stream;
use super::signal::{Senses, Signal, wrapped};
use super::{Hardware, HardwareFiles, Part, Sensor, Sensors, hardware};
use crate::error::{Error, Result};
use crate::feature::Features;
use crate::options::OptionValue;
use crate::sand::memory::Moved;
use crate::sim::hardware::HardwareDescription;
use crate::sim::{MemoryCount, Model, State};
use crate::spec::{Column, Spec};
use nalgebra::{Rotation3, Vector3};
use rand::Rng as _;
use rand_xoshiro::Xoshiro256PlusPlus;
use std::sync::Arc;

/// Sensors of the inertial measurement unit.
const IMU: [Sensor; 3] = [Sensor::Gravity, Sensor::Gyroscope, Sensor::Accelerometer];

/// How a session's observations follow from exact values.
pub struct SensorModel {
    sensors: Sensors,
    /// Columns of exact values: the task's columns, then the columns of added sensors.
    exact: Arc<[Column]>,
    added: Features<Measure>,
    senses: Senses,
    files: HardwareFiles,
    /// For each joint the indices of the signals of its position and its speed, if speeds are differences of positions.
    speeds: Vec<[usize; 2]>,
    /// Indices of the exact columns that a policy gets for each step.
    shown: Vec<usize>,
    /// The shown columns that no signal changes: the place in the policy's row, and the exact column.
    copied: Vec<(usize, usize)>,
    /// First column of each vector of the inertial measurement unit.
    imu: Vec<usize>,
    /// Number of rows that a policy gets at once; the next field is the number of sampled rows that are kept.
    history: usize,
    kept: usize,
    privileged: bool,
    period: f64,
}

/// The episode whose sensors are read.
pub struct SensorInput<'a> {
    pub model: &'a Model,
    pub footing: &'a [f64],
    /// The sand's force on each leg along the surface's normal [N]; empty: not known.
    pub normal_forces: &'a [f64],
    /// The sand that was moved; None without memory.
    pub sand: Option<&'a Moved>,
    /// State before and after the step; at the beginning of an episode both are its first state.
    pub states: [&'a State; 2],
    /// The episode's seed and number, and the step. The random numbers are a function of these three.
    pub at: [u64; 3],
    /// Duration of the step [s].
    pub period: f64,
}

/// The info row that gets exact values: either the values of its own step, or the values at the first observation of the next
/// episode, which begins in the same step.
pub enum Privileged<'a> {
    Present(&'a mut [f32]),
    Next(&'a mut [f32]),
}

impl SensorModel {
    /// The sensors of a session; None: all sensors are exact, and rows are as the task fills them. Changes `spec` to
    /// the session's columns.
    ///
    /// # Errors
    /// Names a sensor that the task does not observe and that cannot be added.
    pub fn new(options: &Hardware, files: &HardwareFiles, model: &Model, spec: &mut Spec) -> Result<Option<Self>> {
        let Hardware { sensors, history, privileged, .. } = options;
        let (sensors, files) = (sensors.0.clone(), files.clone());
        let values = files.values();
        let silent = !values.quantities.keys().any(|path| path.starts_with("sensors."));
        if sensors == Sensors::default() && silent && *history == 1 && !privileged {
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
        let period = 1.0 / spec.control_rate;
        let mut signals = signals(&exact, &sensors, &values, period);
        let speeds = if sensors.velocity_by_differences { speeds(&exact, &signals)? } else { Vec::new() };
        let left_out = |c: &Column| c.sensor.is_some_and(|(s, _)| sensors.without.iter().any(|w| w == s.name()));
        let shown: Vec<usize> = (0..exact.len()).filter(|i| !left_out(&exact[*i])).collect();
        if shown.is_empty() {
            return Err(Error::invalid("sensors.without", "it leaves nothing to observe"));
        }
        let copied = places(&shown, &mut signals);
        let delay = |s: &Signal| {
            exact[s.column]
                .sensor
                .map_or(0.0, |(sensor, _)| files.longest(sensor, sensors.of(sensor).unwrap_or_default()))
        };
        let longest = signals.iter().map(delay).fold(0.0, f64::max);
        // Kept: the newest row, the rows of the longest delay, and one more for finite differences.
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
            for prefix in ["privileged", "next privileged"] {
                let named = |c: &Column| Column { name: format!("{prefix} {}", c.name), ..c.clone() };
                spec.info.extend(exact.iter().map(named));
            }
        }
        let starts = |i: &usize| {
            let of_imu =
                |k: usize| matches!(exact.get(k), Some(Column { sensor: Some((s, _)), .. }) if IMU.contains(s));
            of_imu(*i) && (*i == 0 || exact[i - 1].sensor != exact[*i].sensor)
        };
        let imu = (0..exact.len()).filter(starts).collect();
        let senses = Senses { signals, turn: turn(&sensors, &values) };
        let privileged = *privileged;
        Ok(Some(Self {
            sensors,
            exact: exact.into(),
            added,
            senses,
            files,
            speeds,
            shown,
            copied,
            imu,
            history,
            kept,
            privileged,
            period,
        }))
    }

    /// May a column need the ground's force on each leg? Only columns of added sensors may.
    pub fn needs_normal_forces(&self) -> bool {
        !self.added.is_empty()
    }

    /// Shares the columns of `other` if they are the same.
    pub fn share_columns(&mut self, other: &Self) {
        if self.exact == other.exact {
            self.exact = other.exact.clone();
        }
    }

    /// Adds the memory of the session's sensors; that of an episode's is in [`Self::numbers`].
    pub fn count_memory(&self, count: &mut MemoryCount) {
        let signals = &self.senses.signals;
        let places = signals.iter().map(|signal| size_of_val(&signal.places[..])).sum::<usize>();
        let lists = size_of_val(&self.shown[..]) + size_of_val(&self.copied[..]) + size_of_val(&self.imu[..]);
        let added = Column::list_bytes(&self.exact[self.own()..]);
        count.add(size_of_val(&signals[..]) + places + lists + size_of_val(&self.speeds[..]) + added);
        count.add(self.files.memory_bytes());
        OptionValue::count_memory(&self.sensors, count);
        count.add_shared(&self.exact, Column::list_bytes);
    }

    /// Memory of what the sensors of one episode remember [bytes]; an episode may have drawn sensors of its own.
    pub fn episode_bytes(&self) -> usize {
        let drawn = if self.files.is_random() { size_of_val(&self.senses.signals[..]) } else { 0 };
        size_of::<f32>() * self.numbers() + drawn
    }

    /// Number of the task's own columns.
    fn own(&self) -> usize {
        self.exact.len() - self.added.len()
    }

    fn sizes(&self) -> [usize; 3] {
        [self.senses.signals.len(), self.kept * self.exact.len(), self.history * self.shown.len()]
    }

    /// Number of values that an episode's sensors remember.
    pub fn numbers(&self) -> usize {
        let [signals, sampled, seen] = self.sizes();
        3 * signals + sampled + seen
    }

    /// An episode's memory from a snapshot.
    pub fn resume(&self, numbers: &[f32], [seed, number]: [u64; 2]) -> Option<SensorMemory> {
        let memory = SensorMemory::from_numbers(numbers, self.sizes())?;
        Some(SensorMemory { senses: self.drawn(seed, number), ..memory })
    }

    /// The sensors that an episode draws; None: it uses the session's sensors.
    fn drawn(&self, seed: u64, number: u64) -> Option<Arc<Senses>> {
        self.files.is_random().then(|| {
            let values = self.files.of_episode(seed, number);
            let mut signals = signals(&self.exact, &self.sensors, &values, self.period);
            places(&self.shown, &mut signals);
            Arc::new(Senses { signals, turn: turn(&self.sensors, &values) })
        })
    }

    /// Fills an observation: the first one of an episode if the memory is empty, else the observation of the next step.
    /// `observe` fills a row of the task's own columns.
    pub fn sense(
        &self,
        memory: &mut SensorMemory,
        input: &SensorInput,
        observe: impl FnOnce(&mut [f32]),
        observation: &mut [f32],
        privileged: Privileged,
    ) {
        let width = self.exact.len();
        let begins = memory.sampled.is_empty();
        let [seed, number, step] = input.at;
        if begins {
            let [_, sampled, rows] = self.sizes();
            (memory.sampled, memory.seen) = (vec![0.0; sampled], vec![0.0; rows]);
            memory.senses = self.drawn(seed, number);
        }
        let drawn = memory.senses.clone();
        let senses = drawn.as_deref().unwrap_or(&self.senses);
        shift(&mut memory.sampled, width);
        let (row, before) = memory.sampled.split_at_mut(width);
        self.fill_exact(row, input, observe);
        self.copy_privileged(row, privileged);
        self.turn_imu(senses, row);
        let mut random = stream(seed, number, step);
        if begins {
            memory.past = senses.signals.iter().map(|s| s.begin(&mut random, row)).collect();
            self.speeds.iter().for_each(|[_, speed]| senses.signals[*speed].set(row, 0.0));
            let first = row.to_vec();
            before.chunks_exact_mut(width).for_each(|old| old.copy_from_slice(&first));
        } else {
            for (signal, past) in senses.signals.iter().zip(&mut memory.past) {
                signal.sample(&mut random, past, row);
            }
            for [position, speed] in &self.speeds {
                let position = &senses.signals[*position];
                let change = position.value(row) - position.value(before);
                let change = if position.cosine.is_some() { wrapped(change) } else { change };
                senses.signals[*speed].set(row, change / self.period);
            }
        }
        self.show(senses, memory, &mut random, begins);
        observation.copy_from_slice(&memory.seen);
    }

    /// Fills the same rows again, after a restore. The accelerometer's privileged value is then computed as if the
    /// robot's velocity did not change.
    pub fn repeat(
        &self,
        memory: &SensorMemory,
        input: &SensorInput,
        observe: impl FnOnce(&mut [f32]),
        observation: &mut [f32],
        info: &mut [f32],
    ) {
        observation.copy_from_slice(&memory.seen);
        if self.privileged {
            let mut row = vec![0.0; self.exact.len()];
            self.fill_exact(&mut row, input, observe);
            self.copy_privileged(&row, Privileged::Present(info));
        }
    }

    /// Copies privileged values to their place at the end of an info row, if the row has such a place.
    fn copy_privileged(&self, exact: &[f32], privileged: Privileged) {
        let (info, back) = match privileged {
            Privileged::Present(info) => (info, 2 * exact.len()),
            Privileged::Next(info) => (info, exact.len()),
        };
        if self.privileged && !info.is_empty() {
            let start = info.len() - back;
            info[start..][..exact.len()].copy_from_slice(exact);
        }
    }

    fn fill_exact(&self, row: &mut [f32], input: &SensorInput, observe: impl FnOnce(&mut [f32])) {
        let (own, others) = row.split_at_mut(self.own());
        observe(own);
        let step = MeasuredStep::new(input, self.sensors.imu_position);
        self.added.fill(others, |measure, i| measure(&step, i));
        clip(row, &self.exact);
    }

    /// Turns vectors into the frame of an inertial measurement unit that is not aligned with the base.
    fn turn_imu(&self, senses: &Senses, row: &mut [f32]) {
        let Some(turn) = &senses.turn else { return };
        for start in &self.imu {
            let vector = &mut row[*start..][..3];
            let turned = turn * Vector3::from_fn(|k, _| f64::from(vector[k]));
            vector.iter_mut().zip(turned.iter()).for_each(|(out, x)| *out = *x as f32);
        }
    }

    /// Adds the row that the policy gets now.
    fn show(&self, senses: &Senses, memory: &mut SensorMemory, random: &mut Xoshiro256PlusPlus, begins: bool) {
        let SensorMemory { sampled, seen, .. } = memory;
        // After the shift, the first row still has the values of the step before. A lost sample keeps them.
        let wide = self.shown.len();
        shift(seen, wide);
        let (row, others) = seen.split_at_mut(wide);
        self.copied.iter().for_each(|(place, column)| row[*place] = sampled[*column]);
        for signal in &senses.signals {
            if signal.dropout > 0.0 && random.random_bool(signal.dropout) && !begins {
                continue;
            }
            for (place, column) in &signal.places {
                let Column { low, high, .. } = &self.exact[*column];
                let value = signal.delayed(sampled, self.exact.len(), *column);
                row[*place] = value.clamp(*low as f32, *high as f32);
            }
        }
        if begins {
            others.chunks_exact_mut(wide).for_each(|old| old.copy_from_slice(row));
        }
    }
}

/// Rotation from the base's frame to the frame of the inertial measurement unit; None: the frames are equal.
fn turn(sensors: &Sensors, values: &HardwareDescription) -> Option<Rotation3<f64>> {
    let vector = hardware::imu_rotation(sensors, values);
    (vector != [0.0; 3]).then(|| Rotation3::from_scaled_axis(Vector3::from(vector)).inverse())
}

/// Gives each signal the places of its columns among the columns that are `shown`. Returns places and columns of all shown columns without a signal.
fn places(shown: &[usize], signals: &mut [Signal]) -> Vec<(usize, usize)> {
    let place = |column: usize| Some((shown.iter().position(|i| *i == column)?, column));
    signals.iter_mut().for_each(|signal| signal.places = signal.columns().filter_map(place).collect());
    let of_signal = |column: usize| signals.iter().any(|signal| signal.columns().any(|own| own == column));
    let others = shown.iter().copied().enumerate().filter(|(_, column)| !of_signal(*column));
    others.collect()
}

fn clip(row: &mut [f32], columns: &[Column]) {
    row.iter_mut().zip(columns).for_each(|(x, c)| *x = x.clamp(c.low as f32, c.high as f32));
}

/// One signal for each value of a sensor that has an entry, in the order of the columns.
fn signals(exact: &[Column], sensors: &Sensors, values: &HardwareDescription, period: f64) -> Vec<Signal> {
    let mut all: Vec<Signal> = Vec::new();
    for (i, column) in exact.iter().enumerate() {
        let Some((sensor, part)) = column.sensor else { continue };
        let differences =
            sensors.velocity_by_differences && matches!(sensor, Sensor::JointPosition | Sensor::JointVelocity);
        let known = differences || hardware::names(values, sensor);
        let Some(own) = sensors.of(sensor).or_else(|| known.then(Default::default)) else { continue };
        let imperfections = hardware::imperfections(own, sensor, values);
        match Signal::new(i, part, imperfections, period) {
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
