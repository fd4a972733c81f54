//! Rigid obstacles on and in the sand: steps, walls, hard patches, rocks. Data only; [`super::solid`] computes
//! their geometry.
//!
//! Sand and obstacles do not influence each other: a wall does not stop the sand's flow around a leg beside it. The
//! sand pushes on each part of a robot below the surface, also on a part that overlaps an obstacle there.

use super::solid::Solid;
use crate::error::{Error, Result, check_range};
use serde::{Deserialize, Serialize};

/// Largest number of obstacles of one scene: our choice, because each makes a step slower.
pub const MOST: usize = 256;

/// Largest number of corners of a hull: our choice; a random rock has 12.
const MOST_CORNERS: usize = 64;

/// Depth of steps, walls and patches under the surface [m]: our choice, more than the length of a leg of `xplorer`.
const FOUNDATION: f64 = 0.05;

/// Friction coefficient of a leg in Li, Zhang & Goldman 2012. They give none for rock; to use the same value is our choice.
pub const FRICTION: f64 = 0.36;

/// One rigid obstacle.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Obstacle {
    pub shape: ObstacleShape,
    /// Centre of mass at the start [m].
    pub position: [f64; 3],
    /// Unit quaternion w, x, y, z at the start: own frame to world.
    #[serde(default = "upright")]
    pub orientation: [f64; 4],
    /// Uniform density [kg/m³] of an obstacle that moves; None: it is fixed.
    #[serde(default)]
    pub density: Option<f64>,
    /// Coulomb coefficient against the robot; between two obstacles the larger one applies.
    #[serde(default = "friction")]
    pub friction: f64,
}

/// Shape of an obstacle about its centre of mass; lengths in m.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase", deny_unknown_fields)]
pub enum ObstacleShape {
    Sphere {
        radius: f64,
    },
    /// Length, width, height.
    Box {
        size: [f64; 3],
    },
    /// Convex hull of these points, moved so that its centre of mass is the origin.
    Hull {
        points: Vec<[f64; 3]>,
    },
}

fn upright() -> [f64; 4] {
    [1.0, 0.0, 0.0, 0.0]
}

fn friction() -> f64 {
    FRICTION
}

impl Obstacle {
    /// A fixed, upright obstacle with the default friction.
    pub fn fixed(shape: ObstacleShape, position: [f64; 3]) -> Self {
        Self { shape, position, orientation: upright(), density: None, friction: FRICTION }
    }

    /// A step or wall: a fixed block around (x, y) [m] with its top `height` [m] above the surface, turned by `yaw`
    /// [rad], with a foundation in the sand. With height 0 it is a hard patch flush with the sand.
    pub fn block([x, y]: [f64; 2], [length, width]: [f64; 2], height: f64, yaw: f64) -> Self {
        let size = [length, width, height + FOUNDATION];
        Self::fixed(ObstacleShape::Box { size }, [x, y, height - size[2] / 2.0]).turned(yaw)
    }

    /// The obstacle with the orientation `yaw` about the vertical [rad].
    pub fn turned(self, yaw: f64) -> Self {
        let (sin, cos) = (yaw / 2.0).sin_cos();
        Self { orientation: [cos, 0.0, 0.0, sin], ..self }
    }

    /// This obstacle as a body that can move, of `density` [kg/m³].
    pub fn loose(self, density: f64) -> Self {
        Self { density: Some(density), ..self }
    }

    pub fn moves(&self) -> bool {
        self.density.is_some()
    }

    /// Checks every number and builds the geometry. The ranges catch wrong units: our choice.
    pub fn solid(&self) -> Result<Solid> {
        for p in self.position {
            check_range("obstacle.position", p, -1e3..=1e3)?;
        }
        let norm = self.orientation.iter().map(|c| c * c).sum::<f64>().sqrt();
        check_range("obstacle.orientation (length)", norm, 0.999..=1.001)?;
        check_range("obstacle.friction", self.friction, 0.0..=10.0)?;
        check_range("obstacle.density", self.density.unwrap_or(1.0), 1.0..=3e4)?;
        match &self.shape {
            ObstacleShape::Sphere { radius } => {
                Ok(Solid::sphere(check_range("obstacle.radius", *radius, 1e-3..=10.0)?))
            }
            ObstacleShape::Box { size } => {
                for s in size {
                    check_range("obstacle.size", *s, 1e-3..=100.0)?;
                }
                Ok(Solid::cuboid(*size))
            }
            ObstacleShape::Hull { points } => {
                if !(4..=MOST_CORNERS).contains(&points.len()) {
                    let reason = format!("{} is outside [4, {MOST_CORNERS}]", points.len());
                    return Err(Error::invalid("obstacle.points (number)", reason));
                }
                for c in points.iter().flatten() {
                    check_range("obstacle.points", *c, -10.0..=10.0)?;
                }
                Solid::hull(points)
            }
        }
    }
}
