//! numpy's arrays: actions are read in place, rows are written once, into arrays that own their memory.

use crate::errors::raise;
use pyo3::buffer::{Element, PyBuffer, PyUntypedBuffer};
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::{PyString, PyTuple};
use sandgait::env::shard::Rows;
use sandgait::pool::Batch;
use sandgait::service::proto;
use sandgait::session::roll::Rolled;

/// Arrays larger than this [bytes] are filled without Python's lock: our choice, some 20 µs of copying.
const LARGE: usize = 256 << 10;

/// A number type of arrays.
#[derive(Clone, Copy)]
pub enum Kind {
    F32,
    F64,
    Bool,
    Intp,
}

/// Python objects of numpy that are needed often.
struct Numpy {
    empty: Py<PyAny>,
    kinds: [Py<PyAny>; 4],
}

static NUMPY: PyOnceLock<Numpy> = PyOnceLock::new();

fn numpy(py: Python<'_>) -> PyResult<&Numpy> {
    NUMPY.get_or_try_init(py, || {
        let numpy = py.import("numpy")?;
        let kind = |name| -> PyResult<Py<PyAny>> { Ok(numpy.getattr("dtype")?.call1((name,))?.unbind()) };
        let kinds = [kind("float32")?, kind("float64")?, kind("bool")?, kind("intp")?];
        Ok(Numpy { empty: numpy.getattr("empty")?.unbind(), kinds })
    })
}

/// A new array and the address of its numbers: contiguous, and not shared until Python gets the array.
struct New<'py> {
    array: Bound<'py, PyAny>,
    address: usize,
    bytes: usize,
}

impl<'py> New<'py> {
    fn of(py: Python<'py>, kind: Kind, shape: &[usize]) -> PyResult<Self> {
        let numpy = numpy(py)?;
        let array = numpy.empty.bind(py).call1((PyTuple::new(py, shape)?, &numpy.kinds[kind as usize]))?;
        if shape.contains(&0) {
            return Ok(Self { array, address: 0, bytes: 0 });
        }
        let buffer = PyUntypedBuffer::get(&array)?;
        let (address, bytes) = (buffer.buf_ptr() as usize, buffer.len_bytes());
        Ok(Self { array, address, bytes })
    }

    /// Its numbers.
    ///
    /// # Safety
    /// `T` is of the array's kind (flags are u8), and no other slice of it lives.
    unsafe fn numbers<T>(&self) -> &'py mut [T] {
        match self.bytes {
            0 => &mut [],
            // SAFETY: numpy has allocated this many bytes, which the array owns and this struct keeps alive; all
            // bit patterns are valid numbers.
            bytes => unsafe { std::slice::from_raw_parts_mut(self.address as *mut T, bytes / size_of::<T>()) },
        }
    }
}

/// A column of the shards' rows, one after the other.
fn fill<T: Copy>(into: &mut [T], parts: impl Iterator<Item = impl AsRef<[T]>>) {
    let mut free = into;
    for part in parts {
        let part = part.as_ref();
        let (now, later) = free.split_at_mut(part.len());
        now.copy_from_slice(part);
        free = later;
    }
}

/// Rows of the last reset, step or restore: observations, rewards, terminated, truncated, infos [info, envs],
/// indices of the environments whose episode ended, their last observations.
pub fn batch<'py>(py: Python<'py>, batch: &mut Batch) -> PyResult<Bound<'py, PyTuple>> {
    let (envs, wide, info) = (batch.envs(), batch.spec().observation.len(), batch.spec().info.len());
    let ended: usize = batch.shards().iter().map(|s| s.rows.ended.len()).sum();
    let observations = New::of(py, Kind::F32, &[envs, wide])?;
    let rewards = New::of(py, Kind::F32, &[envs])?;
    let [terminated, truncated] = [New::of(py, Kind::Bool, &[envs])?, New::of(py, Kind::Bool, &[envs])?];
    let infos = New::of(py, Kind::F32, &[info, envs])?;
    let indices = New::of(py, Kind::Intp, &[ended])?;
    let last = New::of(py, Kind::F32, &[ended, wide])?;
    let large = observations.bytes > LARGE;
    // SAFETY: each array is new, of this kind, and sliced once.
    let mut out = unsafe {
        Out {
            floats: [observations.numbers(), rewards.numbers(), last.numbers()],
            flags: [terminated.numbers(), truncated.numbers()],
            infos: infos.numbers(),
            indices: indices.numbers(),
        }
    };
    if large {
        py.detach(move || out.fill(batch))
    } else {
        out.fill(batch)
    }
    let all = [observations, rewards, terminated, truncated, infos, indices, last];
    PyTuple::new(py, all.map(|new| new.array))
}

/// Destinations of a batch's columns.
struct Out<'a> {
    floats: [&'a mut [f32]; 3],
    flags: [&'a mut [u8]; 2],
    infos: &'a mut [f32],
    indices: &'a mut [isize],
}

impl Out<'_> {
    fn fill(&mut self, batch: &Batch) {
        let rows = || batch.shards().iter().map(|s| &s.rows);
        let [observations, rewards, last] = &mut self.floats;
        fill(observations, rows().map(|r: &Rows| &r.observations));
        fill(rewards, rows().map(|r| &r.rewards));
        fill(last, rows().map(|r| &r.final_observations));
        let [terminated, truncated] = &mut self.flags;
        fill(terminated, rows().map(|r| &r.terminated));
        fill(truncated, rows().map(|r| &r.truncated));
        let (envs, width) = (batch.envs(), batch.spec().info.len());
        // Shard by shard, because a shard's rows stay in the processor's own cache while their columns are gathered.
        let mut first = 0;
        for part in rows() {
            let count = part.rewards.len();
            for k in 0..width {
                let column = &mut self.infos[k * envs + first..][..count];
                let values = part.infos[k..].iter().step_by(width);
                column.iter_mut().zip(values).for_each(|(out, value)| *out = *value);
            }
            first += count;
        }
        // Indices in shards start at the shard's first environment, those in batches at the batch's.
        let starts = batch.shards().iter().scan(0, |next, shard| Some(std::mem::replace(next, *next + shard.envs())));
        let ended = rows().zip(starts).flat_map(|(r, start)| r.ended.iter().map(move |i| start + *i as usize));
        self.indices.iter_mut().zip(ended).for_each(|(out, i)| *out = i as isize);
    }
}

/// An array with these numbers.
pub fn array<'py, T: Copy>(py: Python<'py>, kind: Kind, shape: &[usize], numbers: &[T]) -> PyResult<Bound<'py, PyAny>> {
    let new = New::of(py, kind, shape)?;
    // SAFETY: every caller passes numbers of the kind that it names; the array is new and sliced once.
    unsafe { new.numbers() }.copy_from_slice(numbers);
    Ok(new.array)
}

/// The same of a message, whose columns are little-endian bytes: copied once.
pub fn message<'py>(py: Python<'py>, batch: &proto::Batch) -> PyResult<Bound<'py, PyTuple>> {
    let envs = batch.rewards.len() / 4;
    let [wide, info] = [&batch.observations, &batch.infos].map(|rows| rows.len() / 4 / envs.max(1));
    let indices: Vec<isize> =
        batch.final_indices.as_chunks().0.iter().map(|b| u32::from_le_bytes(*b) as isize).collect();
    let (rows, rest) = batch.infos.as_chunks::<4>();
    if !rest.is_empty() || rows.len() != info * envs {
        return Err(wrong_size());
    }
    let infos = New::of(py, Kind::F32, &[info, envs])?;
    // SAFETY: the array is new, of this kind, and sliced once.
    let columns = unsafe { infos.numbers::<f32>() };
    for (i, row) in rows.chunks_exact(info.max(1)).enumerate() {
        row.iter().enumerate().for_each(|(k, value)| columns[k * envs + i] = f32::from_le_bytes(*value));
    }
    let all = [
        packed(py, Kind::F32, &[envs, wide], &[&batch.observations])?,
        packed(py, Kind::F32, &[envs], &[&batch.rewards])?,
        packed(py, Kind::Bool, &[envs], &[&batch.terminated])?,
        packed(py, Kind::Bool, &[envs], &[&batch.truncated])?,
        infos.array,
        array(py, Kind::Intp, &[indices.len()], &indices)?,
        packed(py, Kind::F32, &[indices.len(), wide], &[&batch.final_observations])?,
    ];
    PyTuple::new(py, all)
}

/// A server of another make, or a defect of ours.
fn wrong_size() -> PyErr {
    raise(&sandgait::Error::Internal("the server's answer has columns of different lengths".into()))
}

/// An array whose numbers are these little-endian bytes, one piece after the other.
fn packed<'py>(py: Python<'py>, kind: Kind, shape: &[usize], pieces: &[&[u8]]) -> PyResult<Bound<'py, PyAny>> {
    let new = New::of(py, kind, shape)?;
    // SAFETY: the array is new and sliced once; any bytes are numbers.
    let bytes = unsafe { new.numbers::<u8>() };
    if bytes.len() != pieces.iter().map(|piece| piece.len()).sum::<usize>() {
        return Err(wrong_size());
    }
    fill(bytes, pieces.iter());
    Ok(new.array)
}

/// [`rolled`] of the parts of a rollout over the network.
pub fn parts<'py>(
    py: Python<'py>,
    parts: &[&proto::RolloutPart],
    envs: usize,
    [wide, width]: [usize; 2],
) -> PyResult<Bound<'py, PyTuple>> {
    let last = parts.last().copied().cloned().unwrap_or_default();
    let lengths: Vec<isize> = last.lengths.as_chunks().0.iter().map(|b| u32::from_le_bytes(*b) as isize).collect();
    let rows = |of: fn(&proto::RolloutPart) -> &[u8], row: &[usize]| {
        let pieces: Vec<&[u8]> = parts.iter().map(|part| of(part)).collect();
        let bytes: usize = pieces.iter().map(|piece| piece.len()).sum();
        let steps = bytes / (4 * row.iter().product::<usize>()).max(1);
        packed(py, Kind::F32, &[&[steps], row].concat(), &pieces)
    };
    let all = [
        packed(py, Kind::F64, &[envs], &[&last.returns])?,
        array(py, Kind::Intp, &[lengths.len()], &lengths)?,
        packed(py, Kind::Bool, &[envs], &[&last.terminated])?,
        packed(py, Kind::Bool, &[envs], &[&last.truncated])?,
        rows(|p| &p.observations, &[envs, wide])?,
        rows(|p| &p.rewards, &[envs])?,
        rows(|p| &p.actions, &[envs, width])?,
    ];
    PyTuple::new(py, all)
}

/// f64 in one dimension.
pub fn doubles<'py>(py: Python<'py>, numbers: &[f64]) -> PyResult<Bound<'py, PyAny>> {
    array(py, Kind::F64, &[numbers.len()], numbers)
}

/// Returns, lengths, terminated, truncated, observations, rewards and actions of a rollout.
pub fn rolled<'py>(py: Python<'py>, batch: &Batch, rolled: &Rolled) -> PyResult<Bound<'py, PyTuple>> {
    let (envs, wide, width) = (batch.envs(), batch.spec().observation.len(), batch.spec().action.len());
    let lengths: Vec<isize> = rolled.lengths.iter().map(|n| *n as isize).collect();
    let steps = |numbers: usize, row: usize| numbers / (envs * row);
    let (observations, rewards, actions) = (&rolled.observations, &rolled.rewards, &rolled.actions);
    PyTuple::new(
        py,
        [
            array(py, Kind::F64, &[envs], &rolled.returns)?,
            array(py, Kind::Intp, &[envs], &lengths)?,
            array(py, Kind::Bool, &[envs], &rolled.terminated)?,
            array(py, Kind::Bool, &[envs], &rolled.truncated)?,
            array(py, Kind::F32, &[steps(observations.len(), wide), envs, wide], observations)?,
            array(py, Kind::F32, &[steps(rewards.len(), 1), envs], rewards)?,
            array(py, Kind::F32, &[steps(actions.len(), width), envs, width], actions)?,
        ],
    )
}

/// The numbers of an array of float32, copied once.
pub fn floats(array: &Bound<'_, PyAny>) -> PyResult<Vec<f32>> {
    numbers(array)
}

/// The numbers of an array of their type, copied once.
pub fn numbers<T: Element>(array: &Bound<'_, PyAny>) -> PyResult<Vec<T>> {
    PyBuffer::<T>::get(array)?.to_vec(array.py())
}

/// Names as a list of text.
pub fn names<'py>(py: Python<'py>, names: &[String]) -> PyResult<Bound<'py, PyAny>> {
    let all = names.iter().map(|name| PyString::new(py, name));
    Ok(pyo3::types::PyList::new(py, all)?.into_any())
}
