//! Sand's forces on rigid bodies, for C: `sandgait.h` describes the functions. Every pointer comes from C, so every function
//! relies on what the header promises, and checks only whether a pointer is NULL.

use sandgait_base::error::{Error, Result};
use sandgait_bodies::{Bodies, BodyPart, GroundOptions, Motions, SandGround, Strided};
use sandgait_sand::SandDescription;
use std::cell::RefCell;
use std::ffi::{CStr, CString, c_char, c_int};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::{ptr, slice};

thread_local! {
    static ERROR: RefCell<CString> = RefCell::default();
}

/// `sandgait_shape` of the header.
#[repr(C)]
pub struct CShape {
    shape: *const c_char,
    body: usize,
    position: [f64; 3],
    quaternion: [f64; 4],
}

/// The value of `work`; on an error `failed`, with the text kept for [`sandgait_error`]. A panic, too, is an error:
/// beyond this function it would abort the program that called.
fn told<T>(work: impl FnOnce() -> Result<T>, failed: T) -> T {
    let defect = |_| Err(Error::Internal("the call failed inside sandgait".into()));
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(defect).unwrap_or_else(|e| {
        ERROR.with(|last| *last.borrow_mut() = CString::new(e.to_string().replace('\0', " ")).unwrap_or_default());
        failed
    })
}

/// # Safety
/// `text` is NULL, or a text that ends with a zero byte.
unsafe fn text<'a>(name: &str, text: *const c_char) -> Result<&'a str> {
    if text.is_null() {
        return Err(Error::invalid(name, "is NULL"));
    }
    // SAFETY: the caller promises it.
    unsafe { CStr::from_ptr(text) }.to_str().map_err(|_| Error::invalid(name, "is not UTF-8"))
}

/// # Safety
/// `array` is NULL, or has `count` numbers.
unsafe fn numbers<'a>(name: &str, array: *const f64, count: usize) -> Result<&'a [f64]> {
    match (count, array.is_null()) {
        (0, _) => Ok(&[]),
        (_, true) => Err(Error::invalid(name, "is NULL")),
        // SAFETY: the caller promises it.
        _ => Ok(unsafe { slice::from_raw_parts(array, count) }),
    }
}

fn made<T>(work: impl FnOnce() -> Result<T>) -> *mut T {
    told(|| work().map(|value| Box::into_raw(Box::new(value))), ptr::null_mut())
}

#[unsafe(no_mangle)]
pub extern "C" fn sandgait_error() -> *const c_char {
    ERROR.with(|last| last.borrow().as_ptr())
}

fn ground(description: impl FnOnce() -> Result<SandDescription>, height: f64, slope_deg: f64) -> *mut SandGround {
    made(|| SandGround::new(description()?, GroundOptions { height, slope_deg, ..Default::default() }))
}

/// # Safety
/// See the module.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sandgait_sand_named(
    medium: *const c_char,
    law: *const c_char,
    height: f64,
    slope_deg: f64,
) -> *mut SandGround {
    // SAFETY: see the module.
    let names = unsafe { text("medium", medium).and_then(|medium| Ok((medium, text("law", law)?))) };
    ground(|| names.and_then(|(medium, law)| SandDescription::named(medium, law)), height, slope_deg)
}

/// # Safety
/// See the module.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sandgait_sand_load(file: *const c_char, height: f64, slope_deg: f64) -> *mut SandGround {
    // SAFETY: see the module.
    let file = unsafe { text("file", file) };
    ground(|| file.and_then(|file| SandDescription::load(Path::new(file))), height, slope_deg)
}

/// # Safety
/// See the module.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sandgait_sand_free(sand: *mut SandGround) {
    if !sand.is_null() {
        // SAFETY: see the module.
        drop(unsafe { Box::from_raw(sand) });
    }
}

/// # Safety
/// See the module.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sandgait_bodies_new(shapes: *const CShape, count: usize, plate_size: f64) -> *mut Bodies {
    let all = || {
        if shapes.is_null() || count == 0 {
            return Err(Error::invalid("shapes", "there are none"));
        }
        // SAFETY: see the module.
        let shapes = unsafe { slice::from_raw_parts(shapes, count) };
        let bodies = shapes.iter().map(|s| s.body).max().unwrap_or(0).saturating_add(1);
        if bodies > count {
            return Err(Error::invalid("shapes", format!("body {} has a number above {}", bodies - 1, count - 1)));
        }
        let mut parts: Vec<(String, Vec<BodyPart>)> = (0..bodies).map(|k| (k.to_string(), Vec::new())).collect();
        for shape in shapes {
            // SAFETY: see the module.
            let part = BodyPart::named(unsafe { text("shape", shape.shape) }?)?;
            parts[shape.body].1.push(part.placed(shape.position, shape.quaternion)?);
        }
        Bodies::new(parts, (plate_size != 0.0).then_some(plate_size))
    };
    made(all)
}

/// # Safety
/// See the module.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sandgait_bodies_count(bodies: *const Bodies) -> usize {
    // SAFETY: see the module.
    unsafe { bodies.as_ref() }.map_or(0, Bodies::len)
}

/// # Safety
/// See the module.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sandgait_bodies_free(bodies: *mut Bodies) {
    if !bodies.is_null() {
        // SAFETY: see the module.
        drop(unsafe { Box::from_raw(bodies) });
    }
}

/// # Safety
/// See the module.
#[unsafe(no_mangle)]
#[allow(clippy::too_many_arguments)] // those of the header
pub unsafe extern "C" fn sandgait_wrench(
    sand: *const SandGround,
    bodies: *const Bodies,
    states: usize,
    position: *const f64,
    quaternion: *const f64,
    velocity: *const f64,
    angular_velocity: *const f64,
    wrench: *mut f64,
    drag: *mut f64,
    threads: usize,
) -> c_int {
    let work = || {
        // SAFETY: see the module.
        let (Some(sand), Some(bodies)) = (unsafe { sand.as_ref() }, unsafe { bodies.as_ref() }) else {
            return Err(Error::invalid("sand or bodies", "is NULL"));
        };
        let count = bodies.len();
        // No memory can hold larger arrays.
        if states > isize::MAX as usize / (36 * size_of::<f64>() * count.max(1)) {
            return Err(Error::invalid("states", format!("{states} are too many")));
        }
        let rows = |name: &str, array: *const f64, width: usize| -> Result<Strided<'_, f64>> {
            // SAFETY: see the module.
            let numbers = unsafe { numbers(name, array, states * count * width) }?;
            Ok(Strided { numbers, steps: [count * width, width] })
        };
        let motions = Motions {
            states,
            position: rows("position", position, 3)?,
            quaternion: rows("quaternion", quaternion, 4)?,
            velocity: rows("velocity", velocity, 3)?,
            angular_velocity: rows("angular_velocity", angular_velocity, 3)?,
            travel: None,
        };
        if states == 0 {
            return Ok(0);
        }
        if wrench.is_null() {
            return Err(Error::invalid("wrench", "is NULL"));
        }
        // SAFETY: see the module.
        let (out, drag) = unsafe {
            let out = slice::from_raw_parts_mut(wrench, 6 * states * count);
            (out, (!drag.is_null()).then(|| slice::from_raw_parts_mut(drag, 36 * states * count)))
        };
        bodies.wrench(sand, &motions, threads, out, drag)?;
        Ok(0)
    };
    told(work, -1)
}
