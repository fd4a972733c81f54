//! Sand's forces on bodies that another simulator moves: numpy's arrays are read and written in place.

use crate::errors::{invalid, raise};
use parking_lot::Mutex;
use pyo3::buffer::{Element, PyBuffer};
use pyo3::prelude::*;
use sandgait::bodies::joints::{TreeIndex, TreeMotion};
use sandgait::bodies::{self, BodyPart, GroundOptions, Motions, Precision, SandGround, Strided};
use sandgait::parallel::processors;
use sandgait::sand::SandDescription;
use sandgait::sim::tree::relief::Relief;
use std::path::PathBuf;

/// Sand below a surface, see `sandgait.Sand`.
#[pyclass(frozen)]
pub struct Sand(SandGround);

/// Bodies cut into plates, see `sandgait.Bodies`.
#[pyclass(frozen)]
pub struct Bodies(bodies::Bodies);

/// Sand in the joint space of a MuJoCo model.
#[pyclass(frozen)]
pub struct JointSand {
    sand: bodies::JointSand,
    /// M before and after the last call.
    last: Mutex<[Vec<f64>; 2]>,
}

/// Center, normal, area and whether it is thin, of a plate.
type PlateRow = ([f64; 3], [f64; 3], f64, bool);
/// A shape: its name, or the triangles of a mesh; position; quaternion.
type Shape = (ShapeSource, [f64; 3], [f64; 4]);

#[derive(FromPyObject)]
pub enum ShapeSource {
    Name(String),
    Triangles(Vec<[[f64; 3]; 3]>),
}

/// Spacing and rows of heights, or seed, wavelength and slope of dunes.
#[derive(FromPyObject)]
pub enum Heights {
    Rows(f64, Vec<Vec<f64>>),
    Dunes(u64, f64, f64),
}

#[pymethods]
impl Sand {
    #[new]
    #[pyo3(signature = (medium, law, file, height, slope_deg, relief, rest_speed, leading_edge_gate))]
    #[allow(clippy::too_many_arguments)]
    fn new(
        medium: &str,
        law: &str,
        file: Option<PathBuf>,
        height: f64,
        slope_deg: f64,
        relief: Option<Heights>,
        rest_speed: Option<f64>,
        leading_edge_gate: Option<f64>,
    ) -> PyResult<Self> {
        let made = || {
            let description = match file {
                Some(path) => SandDescription::load(&path)?,
                None => SandDescription::named(medium, law)?,
            };
            let relief = match relief {
                Some(Heights::Rows(spacing, rows)) => Some(Relief::new(spacing, &rows)?),
                Some(Heights::Dunes(seed, wavelength, slope)) => Some(Relief::dunes(seed, wavelength, slope)?),
                None => None,
            };
            let usual = GroundOptions::default();
            let options = GroundOptions {
                height,
                slope_deg,
                relief,
                rest_speed: rest_speed.unwrap_or(usual.rest_speed),
                leading_edge_gate: leading_edge_gate.unwrap_or(usual.leading_edge_gate),
            };
            SandGround::new(description, options)
        };
        made().map(Self).map_err(|e| raise(&e))
    }

    /// Name of the medium, law, and mechanisms without effect.
    fn about(&self) -> (String, &'static str, Vec<&'static str>) {
        let description = self.0.description();
        (description.name.clone(), description.law.name(), self.0.without_effect())
    }

    /// Height of the surface [m] and its upward normal.
    fn at(&self, x: f64, y: f64) -> (f64, [f64; 3]) {
        self.0.at(x, y)
    }
}

#[pymethods]
impl Bodies {
    #[new]
    fn new(py: Python<'_>, all: Vec<(String, Vec<Shape>)>, plate_size: Option<f64>) -> PyResult<Self> {
        let part = |name: &str, (solid, position, quaternion): Shape| {
            let part = match solid {
                ShapeSource::Name(text) => BodyPart::named(&text),
                ShapeSource::Triangles(triangles) => BodyPart::triangles(&format!("mesh of body {name:?}"), &triangles),
            };
            part?.placed(position, quaternion)
        };
        let made = || {
            let cut = all.into_iter().map(|(name, shapes)| {
                let parts = shapes.into_iter().map(|s| part(&name, s)).collect::<sandgait::Result<_>>()?;
                Ok((name, parts))
            });
            bodies::Bodies::new(cut.collect::<sandgait::Result<_>>()?, plate_size)
        };
        py.detach(made).map(Self).map_err(|e| raise(&e))
    }

    fn plates(&self, index: usize) -> Vec<PlateRow> {
        let all = self.0.plates(index).iter();
        all.map(|p| (p.plate.center.lane(0), p.plate.normal.lane(0), p.plate.area, p.thin)).collect()
    }

    /// Arrays are [states, bodies, 3 or 4]; `travel` is [states, 1, 3]. `out` and `drag` are contiguous.
    #[pyo3(signature = (sand, motion, travel, out, drag, double, threads))]
    #[allow(clippy::too_many_arguments)]
    fn wrench(
        &self,
        py: Python<'_>,
        sand: &Sand,
        motion: [Bound<'_, PyAny>; 4],
        travel: Option<Bound<'_, PyAny>>,
        out: &Bound<'_, PyAny>,
        drag: Option<Bound<'_, PyAny>>,
        double: bool,
        threads: usize,
    ) -> PyResult<()> {
        let threads = if threads == 0 { processors() } else { threads };
        if double {
            self.typed::<f64>(py, sand, motion, travel, out, drag, threads)
        } else {
            self.typed::<f32>(py, sand, motion, travel, out, drag, threads)
        }
    }
}

impl Bodies {
    #[allow(clippy::too_many_arguments)]
    fn typed<T: Element + Precision>(
        &self,
        py: Python<'_>,
        sand: &Sand,
        motion: [Bound<'_, PyAny>; 4],
        travel: Option<Bound<'_, PyAny>>,
        out: &Bound<'_, PyAny>,
        drag: Option<Bound<'_, PyAny>>,
        threads: usize,
    ) -> PyResult<()> {
        let mut buffers = Vec::with_capacity(4);
        for array in &motion {
            buffers.push(PyBuffer::<T>::get(array)?);
        }
        let travel = travel.map(|t| PyBuffer::<T>::get(&t)).transpose()?;
        let (out, drag) = (PyBuffer::<T>::get(out)?, drag.map(|d| PyBuffer::<T>::get(&d)).transpose()?);
        let motions = Motions {
            states: buffers[0].shape().first().copied().unwrap_or(0),
            position: rows(&buffers[0])?,
            quaternion: rows(&buffers[1])?,
            velocity: rows(&buffers[2])?,
            angular_velocity: rows(&buffers[3])?,
            travel: travel.as_ref().map(rows).transpose()?,
        };
        let (out, drag) = (writable(&out)?, drag.as_ref().map(writable).transpose()?);
        // A few bodies take less time than giving up Python's lock.
        let work = || self.0.wrench(&sand.0, &motions, threads, out, drag);
        py.detach(work).map_err(|e| raise(&e))
    }
}

/// The numbers of a three-dimensional array whose last dimension is contiguous.
fn rows<T: Element>(buffer: &PyBuffer<T>) -> PyResult<Strided<'_, T>> {
    let size = size_of::<T>() as isize;
    let (&[states, bodies, width], &[first, second, last]) = (buffer.shape(), buffer.strides()) else {
        return Err(invalid("array", "has not three dimensions"));
    };
    let bad = |step: isize| step < 0 || step % size != 0;
    if bad(first) || bad(second) || (last != size && width > 1) {
        return Err(invalid("array", "its rows are not contiguous"));
    }
    let steps = [(first / size) as usize, (second / size) as usize];
    if states * bodies * width == 0 {
        return Ok(Strided { numbers: &[], steps });
    }
    let length = (states - 1) * steps[0] + (bodies - 1) * steps[1] + width;
    // SAFETY: the buffer keeps the array alive, and its shape and strides reach exactly this many numbers from its
    // start. As everywhere in numpy, another thread that writes into the array meanwhile gets what it deserves.
    let numbers = unsafe { std::slice::from_raw_parts(buffer.buf_ptr() as *const T, length) };
    Ok(Strided { numbers, steps })
}

/// The numbers of a contiguous array.
fn numbers<T: Element>(buffer: &PyBuffer<T>) -> PyResult<&[T]> {
    if !buffer.is_c_contiguous() {
        return Err(invalid("array", "is not contiguous"));
    }
    match buffer.item_count() {
        0 => Ok(&[]),
        // SAFETY: the buffer keeps the array, which has this many contiguous numbers, alive.
        count => Ok(unsafe { std::slice::from_raw_parts(buffer.buf_ptr() as *const T, count) }),
    }
}

/// The same, to be written.
#[allow(clippy::mut_from_ref)] // the array belongs to Python
fn writable<T: Element>(buffer: &PyBuffer<T>) -> PyResult<&mut [T]> {
    if buffer.readonly() || !buffer.is_c_contiguous() {
        return Err(invalid("out", "is not a contiguous array that may be written"));
    }
    match buffer.item_count() {
        0 => Ok(&mut []),
        // SAFETY: as above; callers pass each array once, and Python's side makes or checks that they do not overlap.
        count => Ok(unsafe { std::slice::from_raw_parts_mut(buffer.buf_ptr() as *mut T, count) }),
    }
}

#[pymethods]
impl JointSand {
    /// `bodies`: shapes of each body. `tree`: body, root and last degree of freedom of each; `matrix`: parent of each
    /// degree of freedom, starts, counts and columns of the rows of M.
    #[new]
    fn new(
        py: Python<'_>,
        sand: &Sand,
        bodies: Vec<(String, Vec<Shape>)>,
        plate_size: Option<f64>,
        tree: [Vec<usize>; 3],
        matrix: [Vec<i32>; 4],
    ) -> PyResult<Self> {
        let cut = Bodies::new(py, bodies, plate_size)?;
        let ([body, root, last_dof], [dof_parent, row_start, row_count, column]) = (tree, matrix);
        let tree = TreeIndex { body, root, last_dof, dof_parent, row_start, row_count, column };
        let sand = bodies::JointSand::new(sand.0.clone(), cut.0, tree).map_err(|e| raise(&e))?;
        Ok(Self { sand, last: Mutex::default() })
    }

    /// `motion`: xpos, xmat, cvel, subtree_com, cdof. Adds the sand's force to `force` and its drag to `inertia`. If
    /// `inertia` still has the drag of the call before, that is taken out first.
    fn add(
        &self,
        motion: [Bound<'_, PyAny>; 5],
        dt: f64,
        force: &Bound<'_, PyAny>,
        inertia: &Bound<'_, PyAny>,
    ) -> PyResult<bool> {
        let buffers = doubles(&motion)?;
        let (force, inertia) = (PyBuffer::<f64>::get(force)?, PyBuffer::<f64>::get(inertia)?);
        let inertia = writable(&inertia)?;
        let mut last = self.last.lock();
        if last[1] == *inertia {
            inertia.copy_from_slice(&last[0]);
        }
        last[0].clear();
        last[0].extend_from_slice(inertia);
        let wet = self.sand.add(&tree_motion(&buffers)?, dt, writable(&force)?, inertia).map_err(|e| raise(&e))?;
        last[1].clear();
        last[1].extend_from_slice(inertia);
        Ok(wet)
    }

    /// Torque and force on each body at the end of a step with the accelerations `qacc`, into `out`.
    fn wrenches(
        &self,
        motion: [Bound<'_, PyAny>; 5],
        dt: f64,
        qacc: &Bound<'_, PyAny>,
        out: &Bound<'_, PyAny>,
    ) -> PyResult<()> {
        let buffers = doubles(&motion)?;
        let (qacc, out) = (PyBuffer::<f64>::get(qacc)?, PyBuffer::<f64>::get(out)?);
        let (qacc, out) = (numbers(&qacc)?, writable(&out)?);
        self.sand.wrenches(&tree_motion(&buffers)?, dt, qacc, out).map_err(|e| raise(&e))
    }
}

fn doubles(arrays: &[Bound<'_, PyAny>; 5]) -> PyResult<Vec<PyBuffer<f64>>> {
    arrays.iter().map(PyBuffer::get).collect()
}

fn tree_motion(buffers: &[PyBuffer<f64>]) -> PyResult<TreeMotion<'_>> {
    Ok(TreeMotion {
        position: numbers(&buffers[0])?,
        rotation: numbers(&buffers[1])?,
        velocity: numbers(&buffers[2])?,
        center: numbers(&buffers[3])?,
        axis: numbers(&buffers[4])?,
    })
}

/// The surface that sand pushes on: the mesh itself if it is closed, otherwise its convex hull; and whether it is the
/// hull. None: the mesh is flat.
#[pyfunction]
pub fn closed_surface(triangles: Vec<[[f64; 3]; 3]>) -> Option<(Vec<[[f64; 3]; 3]>, bool)> {
    bodies::part::closed_surface(triangles)
}
