//! Logs as MCAP: two topics of ROS 2, joints and IMU, are merged into the rows of one table.
//!
//! Each message of the joints gives a row. The IMU's readings at its time are interpolated between two messages of the IMU.

use super::cdr::{self, Imu, JointState};
use super::keys::{Cut, Topics};
use super::packed::Packing;
use crate::error::{Error, Result};
use crate::table::Cells;
use mcap::records::op;
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use std::collections::HashMap;
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// Longest record that is read [bytes]: our choice. Messages of joints and IMU have a few hundred bytes, but a file may also hold
/// camera images.
const LONGEST: usize = 64 << 20;
/// Bytes read from the file at once.
const PIECE: usize = 1 << 20;
/// Largest number of values in a log: our choice, 160 MB, the same for every format.
const MOST_NUMBERS: usize = 20_000_000;
/// Largest number of a file's channels and schemas together: our choice; each is kept in memory.
const MOST_CHANNELS: usize = 10_000;
/// Longest time between two messages of the IMU over which its readings are interpolated [ns]: our choice, as for the joints.
const LONGEST_GAP: i64 = 50_000_000;

const JOINTS: &str = "sensor_msgs/msg/JointState";
const IMU: &str = "sensor_msgs/msg/Imu";

#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Joints,
    Imu,
}

/// The messages of a log, in the order of their times.
pub struct Bag {
    names: Vec<String>,
    /// Whether the messages have velocities, and efforts.
    lists: [bool; 2],
    joints: Vec<(i64, Vec<f64>)>,
    imu: Vec<Imu>,
    cuts: Vec<Cut>,
}

/// The state of reading a file.
struct Reading<'a> {
    topics: &'a Topics,
    /// Schemas of joints and of the IMU, by id; other schemas are ignored.
    schemas: HashMap<u16, Kind>,
    channels: HashMap<u16, Kind>,
    /// Name of the topic that is read, for joints and for the IMU.
    taken: [Option<String>; 2],
    numbers: usize,
    bag: Bag,
}

/// Reads the messages of joints and IMU from a file.
pub fn read(path: &Path, topics: &Topics, cuts: &[Cut]) -> Result<Bag> {
    let mut file = File::open(path).map_err(|e| Error::file(path, e))?;
    let bag = Bag { names: Vec::new(), lists: [false; 2], joints: Vec::new(), imu: Vec::new(), cuts: cuts.to_vec() };
    let (schemas, channels) = (HashMap::new(), HashMap::new());
    let mut reading = Reading { topics, schemas, channels, taken: [None, None], numbers: 0, bag };
    // The recorder of a robot that fell may not have written the file's end.
    let options = LinearReaderOptions::default()
        .with_skip_end_magic(true)
        .with_emit_chunks(true)
        .with_record_length_limit(LONGEST);
    let mut reader = LinearReader::new_with_options(options);
    while let Some(event) = reader.next_event() {
        match event.map_err(|e| Error::file(path, format!("MCAP: {e}")))? {
            LinearReadEvent::ReadRequest(need) => {
                let piece = reader.insert(need.clamp(1, PIECE));
                let count = file.read(piece).map_err(|e| Error::file(path, e))?;
                reader.notify_read(count);
            }
            LinearReadEvent::Record { opcode, data } => {
                reading.take(opcode, data).map_err(|reason| Error::file(path, reason))?;
            }
        }
    }
    reading.bag.finish(path, reading.taken)
}

type Told<T> = std::result::Result<T, String>;

/// The bytes of a record that are not read yet.
struct Fields<'a> {
    data: &'a [u8],
}

impl<'a> Fields<'a> {
    fn bytes<const N: usize>(&mut self) -> Told<[u8; N]> {
        let (bytes, rest) = self.data.split_first_chunk::<N>().ok_or("MCAP: a record is too short")?;
        self.data = rest;
        Ok(*bytes)
    }

    fn short(&mut self) -> Told<u16> {
        self.bytes().map(u16::from_le_bytes)
    }

    fn long(&mut self) -> Told<u64> {
        self.bytes().map(u64::from_le_bytes)
    }

    fn part(&mut self, length: u64) -> Told<&'a [u8]> {
        let length = usize::try_from(length).unwrap_or(usize::MAX);
        let (part, rest) = self.data.split_at_checked(length).ok_or("MCAP: a field is longer than its record")?;
        self.data = rest;
        Ok(part)
    }

    fn text(&mut self) -> Told<&'a str> {
        let length = u32::from_le_bytes(self.bytes()?);
        std::str::from_utf8(self.part(length.into())?).map_err(|_| "MCAP: a text is not UTF-8".into())
    }
}

impl Reading<'_> {
    /// Takes a record. A length inside it that is larger than the record is an error, so no length can make the program allocate more.
    fn take(&mut self, opcode: u8, data: &[u8]) -> Told<()> {
        let mut fields = Fields { data };
        match opcode {
            op::SCHEMA => {
                let (id, name) = (fields.short()?, fields.text()?);
                // ROS 1 writes the same types without "/msg".
                let is = |own: &str| name == own || name == own.replace("/msg/", "/");
                match [(JOINTS, Kind::Joints), (IMU, Kind::Imu)].into_iter().find(|k| is(k.0)) {
                    Some((_, kind)) => drop(self.schemas.insert(id, kind)),
                    None => drop(self.schemas.remove(&id)),
                }
            }
            op::CHANNEL => {
                let (id, schema) = (fields.short()?, fields.short()?);
                self.channel(id, schema, fields.text()?, fields.text()?)?;
            }
            op::MESSAGE => {
                let id = fields.short()?;
                fields.bytes::<4>()?; // sequence number
                let log_time =
                    i64::try_from(fields.long()?).map_err(|_| "MCAP: a message has a time after the year 2262")?;
                fields.bytes::<8>()?; // time of publishing
                self.message(id, log_time, fields.data)?;
            }
            op::CHUNK => self.chunk(fields)?,
            _ => {}
        }
        self.bounded()
    }

    /// Takes the records of a chunk, each an opcode, a length and its bytes.
    fn chunk(&mut self, mut fields: Fields) -> Told<()> {
        fields.bytes::<16>()?; // times of the chunk's first and last message
        let size = fields.long()?;
        let sum = u32::from_le_bytes(fields.bytes()?);
        let packing = match fields.text()? {
            "" => Packing::Plain,
            "lz4" => Packing::Lz4,
            "zstd" => Packing::Zstd,
            other => return Err(format!("MCAP: a chunk is compressed with {other:?}; use lz4, zstd or none")),
        };
        let length = fields.long()?;
        let unpacked = packing.unpack(fields.part(length)?, size).map_err(|e| format!("MCAP: a chunk: {e}"))?;
        // Zero means that the file has no checksum of this chunk.
        if sum != 0 && sum != crc32fast::hash(&unpacked) {
            return Err("MCAP: a chunk is damaged: its checksum does not match".into());
        }
        let mut records = Fields { data: &unpacked };
        while !records.data.is_empty() {
            let [opcode] = records.bytes()?;
            let length = records.long()?;
            let data = records.part(length)?;
            if opcode != op::CHUNK {
                self.take(opcode, data)?;
            }
        }
        Ok(())
    }

    fn channel(&mut self, id: u16, schema: u16, topic: &str, encoding: &str) -> Told<()> {
        let (kind, key, asked) = match self.schemas.get(&schema) {
            Some(Kind::Joints) => (Kind::Joints, "joints", &self.topics.joints),
            Some(Kind::Imu) => (Kind::Imu, "imu", &self.topics.imu),
            None => return Ok(()),
        };
        if asked.as_ref().is_some_and(|asked| asked != topic) {
            return Ok(());
        }
        if encoding != "cdr" {
            return Err(format!("topic {topic}: its messages are encoded as {encoding:?}; only cdr is read"));
        }
        let taken = &mut self.taken[kind as usize];
        if let Some(other) = taken.as_ref().filter(|other| *other != topic) {
            return Err(format!(
                "topics {other} and {topic} have the same type: name one of them as {key} under [topics]"
            ));
        }
        *taken = Some(topic.to_string());
        self.channels.insert(id, kind);
        Ok(())
    }

    fn message(&mut self, id: u16, log_time: i64, data: &[u8]) -> Told<()> {
        match self.channels.get(&id) {
            Some(Kind::Joints) => {
                let state = cdr::joint_state(data).map_err(|e| format!("a message of joints {e}"))?;
                self.joints(state, log_time)?;
            }
            Some(Kind::Imu) => {
                let imu = cdr::imu(data).map_err(|e| format!("a message of the IMU {e}"))?;
                let stamp = if imu.stamp == 0 { log_time } else { imu.stamp };
                self.bag.imu.push(Imu { stamp, ..imu });
                self.numbers += 11;
            }
            None => {}
        }
        Ok(())
    }

    fn bounded(&self) -> Told<()> {
        if self.numbers > MOST_NUMBERS {
            return Err(format!("the log has more than {MOST_NUMBERS} numbers: keep only every n-th message"));
        }
        match self.schemas.len() + self.channels.len() > MOST_CHANNELS {
            true => Err(format!("more than {MOST_CHANNELS} channels and schemas")),
            false => Ok(()),
        }
    }

    fn joints(&mut self, state: JointState, log_time: i64) -> Told<()> {
        let bag = &mut self.bag;
        if bag.names.is_empty() {
            bag.names.clone_from(&state.names);
            bag.lists = [&state.velocity, &state.effort].map(|list| !list.is_empty());
        }
        let mut row = Vec::with_capacity(3 * bag.names.len());
        for name in &bag.names {
            let place = state.names.iter().position(|n| n == name);
            let place = place.ok_or_else(|| format!("a message of joints lacks {name:?}, which the first one has"))?;
            let lists = [(true, &state.position), (bag.lists[0], &state.velocity), (bag.lists[1], &state.effort)];
            for (_, list) in lists.into_iter().filter(|l| l.0) {
                let value = list.get(place).ok_or_else(|| format!("a message of joints has no value for {name:?}"))?;
                row.push(*value);
            }
        }
        self.numbers += row.len() + 1;
        bag.joints.push((if state.stamp == 0 { log_time } else { state.stamp }, row));
        Ok(())
    }
}

impl Bag {
    fn finish(mut self, path: &Path, taken: [Option<String>; 2]) -> Result<Self> {
        let what =
            [(self.joints.is_empty(), &taken[0], "joints", JOINTS), (self.imu.is_empty(), &taken[1], "imu", IMU)];
        if let Some((_, topic, key, kind)) = what.into_iter().find(|w| w.0) {
            let reason = match topic {
                Some(topic) => format!("topic {topic} has no messages"),
                None => format!("no topic of {kind}, or none with the name that [topics] {key} gives"),
            };
            return Err(Error::file(path, reason));
        }
        self.imu.sort_by_key(|i| i.stamp);
        self.joints.sort_by_key(|j| j.0);
        Ok(self)
    }

    /// Names of the columns.
    pub fn header(&self) -> Vec<String> {
        let fixed = ["run", "condition", "leg", "slope_deg", "stride_frequency", "t"];
        let kinds = [(true, "q"), (self.lists[0], "qd"), (self.lists[1], "tau")];
        let of =
            |name: &String| kinds.iter().filter(|k| k.0).map(move |k| format!("{}:{name}", k.1)).collect::<Vec<_>>();
        let mut all: Vec<String> = fixed.map(String::from).into();
        all.extend(self.names.iter().flat_map(of));
        all.extend(["gyro_x", "gyro_y", "gyro_z", "acc_x", "acc_y", "acc_z"].map(String::from));
        if self.attitude() {
            all.extend(["quat_w", "quat_x", "quat_y", "quat_z"].map(String::from));
        }
        all
    }

    fn attitude(&self) -> bool {
        self.imu.iter().all(|i| i.attitude.is_some())
    }

    /// Gives one row at each call. Rows without readings of the IMU are left out, and rows outside of the experiment's runs, if it
    /// lists runs.
    pub fn rows(&self) -> impl FnMut(&mut Cells) -> Result<bool> + '_ {
        let start = self.joints.first().map_or(0, |j| j.0);
        let whole = [Cut::default()];
        let attitude = self.attitude();
        let mut next = 0;
        move |cells| {
            while let Some((stamp, joints)) = self.joints.get(next) {
                next += 1;
                // Divided, not multiplied by 1e-9, so that 20 ms give the number that "0.02" gives.
                let t = stamp.saturating_sub(start) as f64 / 1e9;
                let cuts = if self.cuts.is_empty() { &whole[..] } else { &self.cuts };
                let cut = cuts.iter().find(|c| c.holds(t));
                let (Some(cut), Some(imu)) = (cut, self.imu_at(*stamp)) else { continue };
                let optional = |value: Option<f64>| value.map(|v| v.to_string()).unwrap_or_default();
                cells.push_field(cut.name.as_deref().unwrap_or("1"));
                cells.push_field(cut.condition.as_deref().unwrap_or_default());
                cells.push_field(cut.leg.as_deref().unwrap_or_default());
                cells.push_field(&optional(cut.slope_deg));
                cells.push_field(&optional(cut.stride_frequency));
                let quat = imu.attitude.filter(|_| attitude);
                let numbers = std::iter::once(&t).chain(joints).chain(&imu.gyro).chain(&imu.acc);
                numbers.chain(quat.iter().flatten()).for_each(|n| cells.push_field(&n.to_string()));
                return Ok(true);
            }
            Ok(false)
        }
    }

    /// The IMU's readings at a time, interpolated; none in a gap.
    fn imu_at(&self, t: i64) -> Option<Imu> {
        let right = self.imu.partition_point(|i| i.stamp < t);
        let after = self.imu.get(right)?;
        let before = if after.stamp == t { after } else { self.imu.get(right.checked_sub(1)?)? };
        let apart = after.stamp.saturating_sub(before.stamp);
        if apart > LONGEST_GAP {
            return None;
        }
        let share = if apart > 0 { (t - before.stamp) as f64 / apart as f64 } else { 0.0 };
        let mix = |a: f64, b: f64| a + share * (b - a);
        let attitude = before.attitude.zip(after.attitude).map(|(a, b)| {
            // The two signs of a quaternion are the same attitude.
            let sign = if (0..4).map(|k| a[k] * b[k]).sum::<f64>() < 0.0 { -1.0 } else { 1.0 };
            let mixed: [f64; 4] = std::array::from_fn(|k| mix(a[k], sign * b[k]));
            let norm = mixed.iter().map(|m| m * m).sum::<f64>().sqrt();
            // An invalid quaternion stays invalid, so that the check of the rows refuses it.
            if norm > 0.5 { mixed.map(|m| m / norm * a.iter().map(|v| v * v).sum::<f64>().sqrt()) } else { mixed }
        });
        let three = |of: fn(&Imu) -> [f64; 3]| std::array::from_fn(|k| mix(of(before)[k], of(after)[k]));
        Some(Imu { stamp: t, attitude, gyro: three(|i| i.gyro), acc: three(|i| i.acc) })
    }
}
