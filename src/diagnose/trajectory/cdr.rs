//! Decodes messages of ROS 2 from their binary form, CDR (OMG, DDS-XTypes 1.3, 7.4). Two types are decoded: JointState and Imu.

/// Largest number of names in one message: our choice, ten times the joints of a robot that can be replayed.
const MOST_NAMES: usize = 256;

/// sensor_msgs/msg/JointState.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct JointState {
    /// [ns]
    pub stamp: i64,
    pub names: Vec<String>,
    /// Empty where the message has none.
    pub position: Vec<f64>,
    pub velocity: Vec<f64>,
    pub effort: Vec<f64>,
}

/// sensor_msgs/msg/Imu.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Imu {
    /// [ns]
    pub stamp: i64,
    /// w, x, y, z; none if the sensor has no attitude.
    pub attitude: Option<[f64; 4]>,
    pub gyro: [f64; 3],
    pub acc: [f64; 3],
}

/// Reads a message from its first byte to its last.
struct Cdr<'a> {
    /// The message without its first four bytes, which state the encoding.
    bytes: &'a [u8],
    at: usize,
    big: bool,
}

type Read<T> = Result<T, String>;

impl<'a> Cdr<'a> {
    fn new(message: &'a [u8]) -> Read<Self> {
        match message {
            [0, kind @ (0 | 1), _, _, bytes @ ..] => Ok(Self { bytes, at: 0, big: *kind == 0 }),
            [a, b, _, _, ..] => Err(format!("has the encapsulation {a:#04x}{b:02x}, which is not plain CDR")),
            _ => Err("is shorter than the header of CDR".into()),
        }
    }

    fn take<const N: usize>(&mut self) -> Read<[u8; N]> {
        let from = self.at.next_multiple_of(N);
        let bytes = self.bytes.get(from..from + N).and_then(|b| b.try_into().ok());
        self.at = from + N;
        bytes.ok_or_else(|| "is too short".into())
    }

    fn whole(&mut self) -> Read<u32> {
        let bytes = self.take::<4>()?;
        Ok(if self.big { u32::from_be_bytes(bytes) } else { u32::from_le_bytes(bytes) })
    }

    fn number(&mut self) -> Read<f64> {
        let bytes = self.take::<8>()?;
        Ok(if self.big { f64::from_be_bytes(bytes) } else { f64::from_le_bytes(bytes) })
    }

    fn numbers<const N: usize>(&mut self) -> Read<[f64; N]> {
        let mut all = [0.0; N];
        for number in &mut all {
            *number = self.number()?;
        }
        Ok(all)
    }

    fn text(&mut self) -> Read<&'a str> {
        let length = self.whole()? as usize;
        let bytes = self.bytes.get(self.at..self.at.saturating_add(length)).ok_or("ends within a text")?;
        self.at += length;
        let text = bytes.strip_suffix(&[0]).unwrap_or(bytes);
        std::str::from_utf8(text).map_err(|_| "has a text that is not UTF-8".into())
    }

    fn count(&mut self) -> Read<usize> {
        match self.whole()? as usize {
            count if count > MOST_NAMES => Err(format!("lists {count} values; at most {MOST_NAMES} are read")),
            count => Ok(count),
        }
    }

    fn list(&mut self) -> Read<Vec<f64>> {
        let count = self.count()?;
        (0..count).map(|_| self.number()).collect()
    }

    /// Reads a std_msgs/msg/Header and returns its time [ns].
    fn header(&mut self) -> Read<i64> {
        let seconds = self.whole()?.cast_signed();
        let stamp = 1_000_000_000 * i64::from(seconds) + i64::from(self.whole()?);
        self.text()?;
        Ok(stamp)
    }
}

pub fn joint_state(message: &[u8]) -> Read<JointState> {
    let mut cdr = Cdr::new(message)?;
    let stamp = cdr.header()?;
    let count = cdr.count()?;
    let names = (0..count).map(|_| cdr.text().map(str::to_string)).collect::<Read<Vec<_>>>()?;
    let state = JointState { stamp, names, position: cdr.list()?, velocity: cdr.list()?, effort: cdr.list()? };
    let lists = [("position", &state.position), ("velocity", &state.velocity), ("effort", &state.effort)];
    match lists.iter().find(|(_, list)| !list.is_empty() && list.len() != count) {
        Some((what, list)) => Err(format!("has {count} names and {} values of {what}", list.len())),
        None => Ok(state),
    }
}

pub fn imu(message: &[u8]) -> Read<Imu> {
    let mut cdr = Cdr::new(message)?;
    let stamp = cdr.header()?;
    let [x, y, z, w] = cdr.numbers::<4>()?;
    // sensor_msgs/Imu: a first covariance of −1 means that the sensor has no attitude. Some drivers write four zeros instead.
    let covariance = cdr.numbers::<9>()?;
    let attitude = (covariance[0] != -1.0 && [x, y, z, w] != [0.0; 4]).then_some([w, x, y, z]);
    let gyro = cdr.numbers::<3>()?;
    cdr.numbers::<9>()?;
    Ok(Imu { stamp, attitude, gyro, acc: cdr.numbers::<3>()? })
}
