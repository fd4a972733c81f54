//! Bodies cut into the plates that sand pushes on.

use super::ground::SandGround;
use super::part::{BodyPart, BodyPlate};
use crate::error::{Error, Result, check_range};
use crate::sand::intruder::IntruderPlate;
use crate::sand::{Law, Regularization};
use crate::sim::tree::eights::{EightPatches, eights};
use crate::sim::tree::patches::{Ball, BodyPatches};
use crate::sim::tree::{PLATE_SIZES, of_body, of_shapes};
use std::collections::{HashSet, VecDeque};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

/// Largest number of plates of all bodies: our choice, fifty shapes with as many plates as one may have. They take some
/// 200 MB.
const MOST_TOGETHER: usize = 1_000_000;

/// Rigid bodies with their names, in the order of the caller.
#[derive(Debug)]
pub struct Bodies {
    names: Vec<String>,
    bodies: Vec<Arc<CutBody>>,
}

/// A body's plates. Without a plate size the law is evaluated once for each patch of plates, by the code of engine
/// `tree`. With a plate size, and for a body with a thin plate or a face, the law is evaluated once for each plate, as
/// in `sandgait intrude`.
#[derive(Debug)]
pub(crate) struct CutBody {
    pub pieces: Vec<BodyPlate>,
    /// Is the law evaluated for each plate?
    pub exact: bool,
    /// A ball that contains the plates.
    pub ball: Ball,
    /// For each law the patches, once singly and once as groups of eight in lanes.
    patches: [OnceLock<(BodyPatches, Vec<EightPatches>)>; 3],
}

impl Bodies {
    /// Each body's name and parts. `plate_size` [m]: size of the plates; the law is then evaluated for each plate.
    /// None: the plates are finer than those of robots in engine `tree`, so that forces are accurate in every single
    /// pose.
    pub fn new(bodies: Vec<(String, Vec<BodyPart>)>, plate_size: Option<f64>) -> Result<Self> {
        if bodies.is_empty() {
            return Err(Error::invalid("bodies", "there are none"));
        }
        if let Some(size) = plate_size {
            check_range("plate_size", size, PLATE_SIZES)?;
        }
        let (mut names, mut cut, mut plates) = (Vec::with_capacity(bodies.len()), Vec::new(), 0);
        let mut before = HashSet::new();
        for (name, parts) in bodies {
            if !before.insert(name.clone()) {
                return Err(Error::invalid("bodies", format!("{name:?} is given twice")));
            }
            let body = CutBody::equal_or_new(&name, parts, plate_size)?;
            plates += body.pieces.len();
            if plates > MOST_TOGETHER {
                let reason = format!("the bodies have more than {MOST_TOGETHER} plates: take a larger plate_size");
                return Err(Error::invalid("bodies", reason));
            }
            cut.push(body);
            names.push(name);
        }
        Ok(Self { names, bodies: cut })
    }

    pub fn names(&self) -> &[String] {
        &self.names
    }

    pub fn len(&self) -> usize {
        self.bodies.len()
    }

    pub fn is_empty(&self) -> bool {
        self.bodies.is_empty()
    }

    /// The plates of body `index`.
    pub fn plates(&self, index: usize) -> &[BodyPlate] {
        &self.bodies[index].pieces
    }

    pub(crate) fn cut(&self) -> &[Arc<CutBody>] {
        &self.bodies
    }

    /// Refuses a leading-edge gate that patches of plates do not have.
    pub(crate) fn check_gate(&self, sand: &SandGround) -> Result<()> {
        let size = Regularization::SOLID.leading_edge_gate;
        if sand.surface.leading_edge_gate == size || self.bodies.iter().all(|b| b.exact) {
            return Ok(());
        }
        Err(Error::invalid("leading_edge_gate", format!("other than {size} needs bodies with a plate_size")))
    }
}

/// Bodies that were cut before, the last one at the end. Users make thousands of equal ones, and to cut one takes a fifth of a
/// second.
static RECENT: Mutex<VecDeque<(Vec<BodyPart>, Arc<CutBody>)>> = Mutex::new(VecDeque::new());
/// Largest number of bodies that are kept, and of plates of each: our choice; together they take some MB.
const KEPT: usize = 16;
const KEPT_PLATES: usize = 2048;

impl CutBody {
    /// A body of these parts, which is that of an equal body before if there was one.
    fn equal_or_new(name: &str, parts: Vec<BodyPart>, size: Option<f64>) -> Result<Arc<Self>> {
        if size.is_some() {
            return Ok(Arc::new(Self::of(name, &parts, size)?));
        }
        // A thread that panicked has left whole entries.
        let lock = || RECENT.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, body)) = lock().iter().rev().find(|(other, _)| *other == parts) {
            return Ok(body.clone());
        }
        let body = Arc::new(Self::of(name, &parts, size)?);
        if body.pieces.len() <= KEPT_PLATES {
            let mut recent = lock();
            recent.push_back((parts, body.clone()));
            if recent.len() > KEPT {
                recent.pop_front();
            }
        }
        Ok(body)
    }

    fn of(name: &str, parts: &[BodyPart], size: Option<f64>) -> Result<Self> {
        let solids: Vec<_> = parts.iter().filter_map(|p| p.solid(name)).collect();
        let thin: Vec<_> = parts.iter().map(|p| p.sheet(size)).collect::<Result<_>>()?;
        let thin = thin.concat();
        let exact = size.is_some() || !thin.is_empty();
        let solids: Vec<_> = solids.iter().collect();
        let plates = if size.is_some() { of_shapes(&solids, size) } else { of_body(&solids) };
        let plates = plates.map_err(|e| Error::invalid(format!("body {name:?}"), e.to_string()))?;
        let mut pieces: Vec<BodyPlate> = plates.into_iter().map(|plate| BodyPlate { plate, thin: false }).collect();
        pieces.extend(thin);
        if pieces.is_empty() {
            return Err(Error::invalid("bodies", format!("{name:?} has no shapes")));
        }
        let plates: Vec<IntruderPlate> = pieces.iter().map(|p| p.plate).collect();
        Ok(Self { ball: Ball::around(&plates), pieces, exact, patches: Default::default() })
    }

    /// The patches for `law`, which are made when they are needed for the first time.
    pub fn patches(&self, law: Law) -> (&BodyPatches, &[EightPatches]) {
        let (patches, in_lanes) = self.patches[law as usize].get_or_init(|| {
            let plates: Vec<IntruderPlate> = self.pieces.iter().map(|p| p.plate).collect();
            let patches = BodyPatches::fine(0, &plates, law);
            let in_lanes = eights(&patches.patches);
            (patches, in_lanes)
        });
        (patches, in_lanes)
    }
}
