//! Sand in the joint space of a tree of bodies, in the form of MuJoCo's arrays.
//!
//! The force on a body at the end of a step is f − C (v⁺ − v) with its drag C. With v⁺ − v = J q̈ dt this is the
//! generalized force Jᵀf − dt JᵀCJ q̈, so M q̈ = τ + Jᵀf − dt JᵀCJ q̈ becomes (M + dt JᵀCJ) q̈ = τ + Jᵀf. The term dt
//! JᵀCJ is added to the inertia only. So it resists changes of velocity, but has no weight and causes no
//! velocity-product forces. JᵀCJ couples only joints on the same path from a body to the root. So JᵀCJ has an entry
//! only where M has an entry, and a simulator can factorise the sum with its own sparse factorisation.

use super::body::Bodies;
use super::force::{BodyForce, EightGround, LaneGround};
use super::ground::SandGround;
use super::wrench::matrix;
use crate::error::{Error, Result};
use crate::number::{Eight, EightWork, Mat3, Vec3, flushed};
use crate::sim::blocks::LinkFrame;
use crate::sim::spatial::Twist;

/// The tree, as MuJoCo's model has it.
#[derive(Clone, Debug, Default)]
pub struct TreeIndex {
    /// The simulator's number of each body that touches sand, and of the root of its tree.
    pub body: Vec<usize>,
    pub root: Vec<usize>,
    /// The last degree of freedom that moves each of these bodies.
    pub last_dof: Vec<usize>,
    /// For each degree of freedom the next one on the way to the root; negative: there is none.
    pub dof_parent: Vec<i32>,
    /// The lower triangle of M by rows: first entry, number of entries, and their columns.
    pub row_start: Vec<i32>,
    pub row_count: Vec<i32>,
    pub column: Vec<i32>,
}

/// Positions and motion of all bodies of the simulator.
pub struct TreeMotion<'a> {
    /// [bodies, 3], and rotations by rows [bodies, 9].
    pub position: &'a [f64],
    pub rotation: &'a [f64],
    /// Angular and linear velocity of each body [bodies, 6], the linear part at its tree's centre of mass.
    pub velocity: &'a [f64],
    /// Centre of mass of the subtree of each body [bodies, 3]; only the roots' entries are used.
    pub center: &'a [f64],
    /// For each degree of freedom at unit rate, the velocity of the body that it moves, in the form of `velocity`
    /// [dofs, 6].
    pub axis: &'a [f64],
}

/// Bodies of a tree on sand.
pub struct JointSand {
    bodies: Bodies,
    sand: SandGround,
    tree: TreeIndex,
    /// Degrees of freedom that move each body, the last one first.
    chains: Vec<Vec<usize>>,
}

/// A spatial vector, angular part first: a wrench, a row of the drag matrix C, or the product of C and an axis.
type Spatial = [f64; 6];

impl JointSand {
    pub fn new(sand: SandGround, bodies: Bodies, tree: TreeIndex) -> Result<Self> {
        bodies.check_gate(&sand)?;
        let wrong = |what: &str| Err(Error::invalid("tree", format!("{what} does not fit the others")));
        let (dofs, count) = (tree.dof_parent.len(), bodies.len());
        if [tree.body.len(), tree.root.len(), tree.last_dof.len()] != [count; 3] {
            return wrong("the number of bodies");
        }
        if [tree.row_start.len(), tree.row_count.len()] != [dofs; 2] || tree.last_dof.iter().any(|d| *d >= dofs) {
            return wrong("the number of degrees of freedom");
        }
        if tree.dof_parent.iter().enumerate().any(|(dof, parent)| *parent >= dof as i32) {
            return wrong("the order of degrees of freedom");
        }
        let entries =
            tree.row_start.iter().zip(&tree.row_count).map(|(start, count)| i64::from(*start) + i64::from(*count));
        if tree.row_start.iter().chain(&tree.row_count).any(|x| *x < 0)
            || entries.max().is_some_and(|end| end > tree.column.len() as i64)
        {
            return wrong("the matrix");
        }
        let chain = |last: &usize| {
            let before = |dof: &usize| usize::try_from(tree.dof_parent[*dof]).ok();
            std::iter::successors(Some(*last), before).collect()
        };
        let chains = tree.last_dof.iter().map(chain).collect();
        Ok(Self { bodies, sand, chains, tree })
    }

    pub fn sand(&self) -> &SandGround {
        &self.sand
    }

    pub fn bodies(&self) -> &Bodies {
        &self.bodies
    }

    /// Number of entries of the lower triangle, and of degrees of freedom.
    pub fn sizes(&self) -> [usize; 2] {
        [self.tree.column.len(), self.tree.dof_parent.len()]
    }

    /// Adds Jᵀf to the generalized `force` [dofs], and dt JᵀCJ to the lower triangle `inertia`. Returns whether any body
    /// is in the sand.
    pub fn add(&self, motion: &TreeMotion<'_>, dt: f64, force: &mut [f64], inertia: &mut [f64]) -> Result<bool> {
        if force.len() < self.tree.dof_parent.len() || inertia.len() < self.tree.column.len() {
            return Err(Error::invalid("data", "an array is shorter than the model's"));
        }
        let mut wet = false;
        self.each(motion, |k, wrench, drag| {
            wet = true;
            self.add_body(k, motion.axis, &wrench, &drag, dt, force, inertia);
        })?;
        Ok(wet)
    }

    /// The sand's wrench on each body at the end of a step with the accelerations q̈ [dofs], f − dt C J q̈, as
    /// [bodies, 6]: torque [N·m] about the tree's centre of mass, and force [N].
    pub fn wrenches(&self, motion: &TreeMotion<'_>, dt: f64, acceleration: &[f64], out: &mut [f64]) -> Result<()> {
        if acceleration.len() < self.tree.dof_parent.len() || out.len() != 6 * self.bodies.len() {
            return Err(Error::invalid("data", "an array is shorter than the model's"));
        }
        out.fill(0.0);
        self.each(motion, |k, wrench, drag| {
            let mut change = [0.0; 6];
            for dof in &self.chains[k] {
                let axis = &motion.axis[6 * dof..6 * dof + 6];
                change.iter_mut().zip(axis).for_each(|(c, a)| *c += a * acceleration[*dof] * dt);
            }
            for (i, row) in drag.iter().enumerate() {
                out[6 * k + i] = wrench[i] - row.iter().zip(&change).map(|(d, c)| d * c).sum::<f64>();
            }
        })
    }

    /// Calls `with` for each body in the sand: its index, its wrench (torque, force) and its drag.
    fn each(&self, motion: &TreeMotion<'_>, with: impl FnMut(usize, Spatial, [Spatial; 6])) -> Result<()> {
        let (dofs, most) = (self.tree.dof_parent.len(), self.tree.body.iter().chain(&self.tree.root).max());
        let bodies = most.map_or(0, |most| most + 1);
        if motion.position.len() < 3 * bodies
            || motion.rotation.len() < 9 * bodies
            || motion.velocity.len() < 6 * bodies
            || motion.center.len() < 3 * bodies
            || motion.axis.len() < 6 * dofs
        {
            return Err(Error::invalid("data", "an array is shorter than the model's"));
        }
        flushed(|| self.sand.isa.eights(EachBody { all: self, motion, with }));
        Ok(())
    }

    /// Returns the frame of body `k`, relative to the tree's centre of mass; this centre; and the horizontal velocity of the tree's root.
    fn frame(&self, motion: &TreeMotion<'_>, k: usize) -> (LinkFrame<f64>, Vec3<f64>, [f64; 2]) {
        let (body, root) = (self.tree.body[k], self.tree.root[k]);
        let vector = |all: &[f64], i: usize| Vec3::new(all[3 * i], all[3 * i + 1], all[3 * i + 2]);
        let place = vector(motion.center, root);
        let rows = [3 * body, 3 * body + 1, 3 * body + 2].map(|row| vector(motion.rotation, row));
        let twist =
            |i: usize| Twist { angular: vector(motion.velocity, 2 * i), linear: vector(motion.velocity, 2 * i + 1) };
        let frame = LinkFrame {
            rotation: Mat3::new(rows[0], rows[1], rows[2]).transposed(),
            origin: vector(motion.position, body) - place,
            velocity: twist(body),
            ..LinkFrame::at_rest()
        };
        let v = twist(root).at(vector(motion.position, root) - place);
        (frame, place, [v.x, v.y])
    }

    #[allow(clippy::too_many_arguments)]
    fn add_body(
        &self,
        k: usize,
        axes: &[f64],
        wrench: &Spatial,
        drag: &[Spatial; 6],
        dt: f64,
        force: &mut [f64],
        inertia: &mut [f64],
    ) {
        let axis = |dof: usize| &axes[6 * dof..6 * dof + 6];
        let dot = |a: &[f64], b: &Spatial| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let chain = &self.chains[k];
        for (i, dof) in chain.iter().enumerate() {
            force[*dof] += dot(axis(*dof), wrench);
            let held: Spatial = drag.map(|row| dt * dot(axis(*dof), &row));
            let start = self.tree.row_start[*dof] as usize;
            let columns = &self.tree.column[start..start + self.tree.row_count[*dof] as usize];
            let row = &mut inertia[start..start + columns.len()];
            // The columns of a row are the degrees of freedom on the way to the root, in ascending order.
            if columns.len() == chain.len() - i {
                for (entry, other) in row.iter_mut().zip(chain[i..].iter().rev()) {
                    *entry += dot(axis(*other), &held);
                }
            } else if let Some(own) = row.last_mut() {
                *own += self.dominant(chain, *dof, axes, drag, dt);
            }
        }
    }

    /// The diagonal entry of `dof` for a body that floats alone with its centre of mass at its origin: MuJoCo then
    /// keeps only the diagonal of M. The diagonal matrix with entries √H_ii Σ_j |H_ij|/√H_jj takes the place of
    /// H = dt JᵀCJ. This matrix minus H is positive semidefinite (Gershgorin, after scaling by 1/√H_ii), so the motion
    /// stays stable. The accelerations differ from those with H by a term of order dt.
    fn dominant(&self, chain: &[usize], dof: usize, axes: &[f64], drag: &[Spatial; 6], dt: f64) -> f64 {
        let axis = |dof: usize| &axes[6 * dof..6 * dof + 6];
        let dot = |a: &[f64], b: &Spatial| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let held = |dof: usize| -> Spatial { drag.map(|row| dt * dot(axis(dof), &row)) };
        let own = held(dof);
        let scale = dot(axis(dof), &own).max(0.0).sqrt();
        let one = |other: &usize| {
            let size = dot(axis(*other), &held(*other)).max(0.0).sqrt();
            if size > 0.0 { dot(axis(*other), &own).abs() / size } else { 0.0 }
        };
        scale * chain.iter().map(one).sum::<f64>()
    }
}

/// A call of `with` for each body in the sand.
struct EachBody<'a, F> {
    all: &'a JointSand,
    motion: &'a TreeMotion<'a>,
    with: F,
}

impl<F: FnMut(usize, Spatial, [Spatial; 6])> EightWork for EachBody<'_, F> {
    type Out = ();

    fn run<R: Eight>(self) {
        let ground = EightGround::<R>::of(&self.all.sand);
        self.on(&ground);
    }

    fn single(self) {
        let ground = LaneGround::<f64>::of(&self.all.sand);
        self.on(&ground);
    }
}

impl<F: FnMut(usize, Spatial, [Spatial; 6])> EachBody<'_, F> {
    fn on(mut self, ground: &impl BodyForce<f64>) {
        for (k, body) in self.all.bodies.cut().iter().enumerate() {
            let (frame, place, travel) = self.all.frame(self.motion, k);
            let Some(total) = ground.on(body, &frame, &place, travel) else { continue };
            let (f, t) = (total.wrench.force, total.wrench.moment);
            (self.with)(k, [t.x, t.y, t.z, f.x, f.y, f.z], angular_first(&matrix(&total.inertia(), 0)));
        }
    }
}

/// Reorders a matrix from (linear, angular) to (angular, linear).
fn angular_first(m: &[[f64; 6]; 6]) -> [Spatial; 6] {
    std::array::from_fn(|i| std::array::from_fn(|j| m[(i + 3) % 6][(j + 3) % 6]))
}
