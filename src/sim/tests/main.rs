//! Tests of this crate. They are a program of their own, so that the engines for all instruction sets are compiled once.

mod actuator;
#[cfg(target_arch = "x86_64")]
mod denormals;
mod hardware;
mod heights;
mod inertia;
mod joint_values;
mod leg_planes;
#[path = "../../../tests/testbed/long.rs"]
mod long;
mod plane;
mod pose;
mod relief;
mod solid;
mod symmetry;
mod tree;
mod used;
