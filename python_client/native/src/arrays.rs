//! numpy's arrays: actions are read in place, rows are written once, into arrays that own their memory.

use crate::errors::raise;
use numpy::{Element, PyArrayDyn, PyArrayMethods as _, PyUntypedArrayMethods as _};
use pyo3::buffer::{self, PyBuffer};
use pyo3::prelude::*;
use pyo3::types::{PyString, PyTuple};
use sandgait::env::shard::Rows;
use sandgait::pool::{Batch, Gather};
use sandgait::service::proto;
use sandgait::session::roll::Rolled;
use std::slice::from_raw_parts_mut;
use std::sync::Arc;

/// Arrays larger than this [bytes] are filled without Python's lock: our choice, some 20 µs of copying.
const LARGE: usize = 256 << 10;

/// A new array, which nobody shares until Python gets it. Its numbers are not set yet.
fn new<'py, T: Element>(py: Python<'py>, shape: &[usize]) -> Bound<'py, PyArrayDyn<T>> {
    // SAFETY: all callers write every number before Python reads one.
    unsafe { PyArrayDyn::new(py, shape, false) }
}

/// Writes `pieces` into a new array, one after the other.
///
/// # Panics
/// The pieces are longer than the array.
fn fill<'a, T: Element + Copy + 'a>(array: &Bound<'_, PyArrayDyn<T>>, pieces: impl Iterator<Item = &'a [T]>) {
    // SAFETY: the array is new, contiguous, and not shared; it is written and not read.
    put_all(unsafe { from_raw_parts_mut(array.data(), array.len()) }, pieces);
}

/// Writes `pieces` into `free`, one after the other.
///
/// # Panics
/// The pieces are longer than `free`.
fn put_all<'a, T: Copy + 'a>(mut free: &mut [T], pieces: impl Iterator<Item = &'a [T]>) {
    for piece in pieces {
        let (now, later) = free.split_at_mut(piece.len());
        now.copy_from_slice(piece);
        free = later;
    }
}

/// Rows of the last reset, step or restore: observations, rewards, terminated, truncated, infos [info, envs],
/// indices of the environments whose episode ended, their last observations.
pub fn batch<'py>(py: Python<'py>, batch: &mut Batch) -> PyResult<Bound<'py, PyTuple>> {
    let rows = RowArrays::new(py, batch);
    let places = rows.places();
    let large = 4 * rows.observations.len() > LARGE;
    let all = &mut *batch;
    let put = move || {
        let mut start = 0;
        for shard in all.shards() {
            // SAFETY: `rows` lives until this function ends, and no other thread writes into its arrays.
            unsafe { places.put(start, &shard.rows) };
            start += shard.envs();
        }
    };
    if large {
        py.detach(put)
    } else {
        put()
    }
    rows.answer(py, batch)
}

/// New arrays for the rows of all environments.
pub struct RowArrays<'py> {
    observations: Bound<'py, PyArrayDyn<f32>>,
    rewards: Bound<'py, PyArrayDyn<f32>>,
    terminated: Bound<'py, PyArrayDyn<bool>>,
    truncated: Bound<'py, PyArrayDyn<bool>>,
    infos: Bound<'py, PyArrayDyn<f32>>,
}

impl<'py> RowArrays<'py> {
    pub fn new(py: Python<'py>, batch: &Batch) -> Self {
        let (envs, wide, info) = (batch.envs(), batch.spec().observation.len(), batch.spec().info.len());
        Self {
            observations: new(py, &[envs, wide]),
            rewards: new(py, &[envs]),
            terminated: new(py, &[envs]),
            truncated: new(py, &[envs]),
            infos: new(py, &[info, envs]),
        }
    }

    fn places(&self) -> Places {
        Places {
            envs: self.rewards.len(),
            observations: self.observations.data(),
            rewards: self.rewards.data(),
            terminated: self.terminated.data().cast(),
            truncated: self.truncated.data().cast(),
            infos: self.infos.data(),
        }
    }

    /// Writes each shard's rows into these arrays.
    ///
    /// # Safety
    /// The arrays outlive the last call, and get the rows of each environment from one thread.
    pub unsafe fn gather(&self) -> Gather {
        let places = self.places();
        // SAFETY: as this function demands.
        Arc::new(move |start, rows| unsafe { places.put(start, rows) })
    }

    /// The answer, after every shard's rows were written.
    pub fn answer(self, py: Python<'py>, batch: &Batch) -> PyResult<Bound<'py, PyTuple>> {
        let rows = || batch.shards().iter().map(|shard| &shard.rows);
        // Indices in shards start at the shard's first environment, those in batches at the batch's.
        let starts = batch.shards().iter().scan(0, |next, shard| Some(std::mem::replace(next, *next + shard.envs())));
        let ended = rows().zip(starts).flat_map(|(rows, start)| rows.ended.iter().map(move |i| start + *i as usize));
        let ended: Vec<isize> = ended.map(|i| i as isize).collect();
        let last = new::<f32>(py, &[ended.len(), batch.spec().observation.len()]);
        fill(&last, rows().map(|rows| &rows.final_observations[..]));
        let Self { observations, rewards, terminated, truncated, infos } = self;
        let ended = array(py, &[ended.len()], &ended);
        (observations, rewards, terminated, truncated, infos, ended, last).into_pyobject(py)
    }
}

/// The memory of [`RowArrays`], for threads without Python's lock.
struct Places {
    envs: usize,
    observations: *mut f32,
    rewards: *mut f32,
    terminated: *mut u8,
    truncated: *mut u8,
    infos: *mut f32,
}

// SAFETY: whoever calls `put` answers for the memory.
unsafe impl Send for Places {}
// SAFETY: the same.
unsafe impl Sync for Places {}

impl Places {
    /// Writes the rows of the shard whose first environment is number `start`.
    ///
    /// # Safety
    /// The arrays live, and no other thread reads or writes the rows of these environments.
    unsafe fn put(&self, start: usize, rows: &Rows) {
        let count = rows.rewards.len();
        assert!(start + count <= self.envs);
        let wide = rows.observations.len() / count;
        // SAFETY: each array has a row for each environment, by the assertion above also for these; the caller answers for
        // the rest. Flags are 0 or 1, as bytes and as numpy's bool.
        unsafe {
            from_raw_parts_mut(self.observations.add(start * wide), count * wide).copy_from_slice(&rows.observations);
            from_raw_parts_mut(self.rewards.add(start), count).copy_from_slice(&rows.rewards);
            from_raw_parts_mut(self.terminated.add(start), count).copy_from_slice(&rows.terminated);
            from_raw_parts_mut(self.truncated.add(start), count).copy_from_slice(&rows.truncated);
        }
        let width = rows.infos.len() / count;
        for k in 0..width {
            // SAFETY: the same; infos have a row of all environments for each column.
            let column = unsafe { from_raw_parts_mut(self.infos.add(k * self.envs + start), count) };
            column.iter_mut().zip(rows.infos[k..].iter().step_by(width)).for_each(|(out, value)| *out = *value);
        }
    }
}

/// An array with these numbers.
pub fn array<'py, T: Element + Copy>(py: Python<'py>, shape: &[usize], numbers: &[T]) -> Bound<'py, PyArrayDyn<T>> {
    let array = new(py, shape);
    fill(&array, std::iter::once(numbers));
    array
}

/// Flags that are 0 or 1.
fn truths<'py>(py: Python<'py>, flags: &[u8]) -> Bound<'py, PyArrayDyn<bool>> {
    let flags: Vec<bool> = flags.iter().map(|flag| *flag != 0).collect();
    array(py, &[flags.len()], &flags)
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
    let mut columns = vec![0.0; info * envs];
    for (i, row) in rows.chunks_exact(info.max(1)).enumerate() {
        row.iter().enumerate().for_each(|(k, value)| columns[k * envs + i] = f32::from_le_bytes(*value));
    }
    if [&batch.terminated, &batch.truncated].iter().any(|flags| flags.len() != envs) {
        return Err(wrong_size());
    }
    let all = (
        packed::<f32>(py, &[envs, wide], &[&batch.observations])?,
        packed::<f32>(py, &[envs], &[&batch.rewards])?,
        truths(py, &batch.terminated),
        truths(py, &batch.truncated),
        array(py, &[info, envs], &columns),
        array(py, &[indices.len()], &indices),
        packed::<f32>(py, &[indices.len(), wide], &[&batch.final_observations])?,
    );
    all.into_pyobject(py)
}

/// A server of another make, or a defect of ours.
fn wrong_size() -> PyErr {
    raise(&sandgait::Error::Internal("the server's answer has columns of different lengths".into()))
}

/// An array whose numbers are these little-endian bytes, one piece after the other.
fn packed<'py, T: LittleEndian>(
    py: Python<'py>,
    shape: &[usize],
    pieces: &[&[u8]],
) -> PyResult<Bound<'py, PyArrayDyn<T>>> {
    let array = new::<T>(py, shape);
    if size_of::<T>() * array.len() != pieces.iter().map(|piece| piece.len()).sum::<usize>() {
        return Err(wrong_size());
    }
    // SAFETY: the array is new, contiguous, not shared, and of this many bytes; any bytes are numbers.
    let free = unsafe { from_raw_parts_mut(array.data().cast::<u8>(), size_of::<T>() * array.len()) };
    put_all(free, pieces.iter().copied());
    Ok(array)
}

/// Number types of messages. This machine is little-endian, too.
trait LittleEndian: Element {}

impl LittleEndian for f32 {}
impl LittleEndian for f64 {}

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
        packed::<f32>(py, &[&[steps], row].concat(), &pieces)
    };
    if [&last.terminated, &last.truncated].iter().any(|flags| flags.len() != envs) {
        return Err(wrong_size());
    }
    let all = (
        packed::<f64>(py, &[envs], &[&last.returns])?,
        array(py, &[lengths.len()], &lengths),
        truths(py, &last.terminated),
        truths(py, &last.truncated),
        rows(|p| &p.observations, &[envs, wide])?,
        rows(|p| &p.rewards, &[envs])?,
        rows(|p| &p.actions, &[envs, width])?,
    );
    all.into_pyobject(py)
}

/// f64 in one dimension.
pub fn doubles<'py>(py: Python<'py>, numbers: &[f64]) -> Bound<'py, PyAny> {
    array(py, &[numbers.len()], numbers).into_any()
}

/// Returns, lengths, terminated, truncated, observations, rewards and actions of a rollout.
pub fn rolled<'py>(py: Python<'py>, batch: &Batch, rolled: &Rolled) -> PyResult<Bound<'py, PyTuple>> {
    let (envs, wide, width) = (batch.envs(), batch.spec().observation.len(), batch.spec().action.len());
    let lengths: Vec<isize> = rolled.lengths.iter().map(|n| *n as isize).collect();
    let steps = |numbers: usize, row: usize| numbers / (envs * row);
    let (observations, rewards, actions) = (&rolled.observations, &rolled.rewards, &rolled.actions);
    let all = (
        array(py, &[envs], &rolled.returns),
        array(py, &[envs], &lengths),
        truths(py, &rolled.terminated),
        truths(py, &rolled.truncated),
        array(py, &[steps(observations.len(), wide), envs, wide], observations),
        array(py, &[steps(rewards.len(), 1), envs], rewards),
        array(py, &[steps(actions.len(), width), envs, width], actions),
    );
    all.into_pyobject(py)
}

/// The numbers of an array of float32, copied once.
pub fn floats(array: &Bound<'_, PyAny>) -> PyResult<Vec<f32>> {
    numbers(array)
}

/// The numbers of an array of their type, copied once.
pub fn numbers<T: buffer::Element>(array: &Bound<'_, PyAny>) -> PyResult<Vec<T>> {
    PyBuffer::<T>::get(array)?.to_vec(array.py())
}

/// Names as a list of text.
pub fn names<'py>(py: Python<'py>, names: &[String]) -> PyResult<Bound<'py, PyAny>> {
    let all = names.iter().map(|name| PyString::new(py, name));
    Ok(pyo3::types::PyList::new(py, all)?.into_any())
}
