//! The instruction set of the hot path. It is chosen when a session is made, so one binary runs on every processor.

use super::{Kernel, Portable, Real};
use crate::error::{Error, Result};

/// An instruction set for lanes of environments.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Isa {
    /// 16 lanes of `f32`.
    Avx512,
    /// 8 lanes of `f32`, fused multiply-add.
    Avx2,
    /// 4 lanes of `f32` in portable code, for every processor.
    Baseline,
    /// One lane of `f64`: the reference for all other instruction sets.
    F64,
}

/// Work that is generic over the number type of an instruction set, see [`Isa::with`].
pub trait Work {
    type Out;
    fn run<R: Real>(self) -> Self::Out;
}

impl Isa {
    pub const ALL: [Self; 4] = [Self::Avx512, Self::Avx2, Self::Baseline, Self::F64];

    pub fn name(self) -> &'static str {
        match self {
            Self::Avx512 => "avx512",
            Self::Avx2 => "avx2",
            Self::Baseline => "baseline",
            Self::F64 => "f64",
        }
    }

    /// Number of environments in one block.
    pub fn lanes(self) -> usize {
        match self {
            Self::Avx512 => 16,
            Self::Avx2 => 8,
            Self::Baseline => 4,
            Self::F64 => 1,
        }
    }

    /// Can this machine run this instruction set?
    pub fn available(self) -> bool {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => is_x86_feature_detected!("avx512f") && is_x86_feature_detected!("avx512dq"),
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma"),
            #[cfg(not(target_arch = "x86_64"))]
            Self::Avx512 | Self::Avx2 => false,
            Self::Baseline | Self::F64 => true,
        }
    }

    /// Runs `work` with the number type of this instruction set. Types that need special instructions are accessible
    /// only here, so a processor never runs instructions that it does not have. The error names the missing instruction
    /// set.
    pub fn with<W: Work>(self, work: W) -> Result<W::Out> {
        if !self.available() {
            return Err(Error::invalid("instruction set", format!("this machine has no {}", self.name())));
        }
        Ok(match self {
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => work.run::<super::x86::Avx512>(),
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => work.run::<super::x86::Avx2>(),
            Self::F64 => work.run::<f64>(),
            _ => work.run::<Portable>(),
        })
    }

    /// Runs `kernel` compiled for this instruction set if the machine has it, otherwise in portable code.
    pub fn run<K: Kernel>(self, kernel: K) {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 if self.available() => super::x86::Avx512::dispatch(kernel),
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 if self.available() => super::x86::Avx2::dispatch(kernel),
            _ => kernel.run(),
        }
    }

    /// The instruction set that the environment variable `SANDGAIT_ISA` names, or else the widest that the machine has.
    pub fn choose() -> Result<Self> {
        let Ok(name) = std::env::var("SANDGAIT_ISA") else {
            return Ok(Self::ALL.into_iter().find(|isa| isa.available()).unwrap_or(Self::Baseline));
        };
        let known = Self::ALL.map(Self::name);
        let isa = Self::ALL.into_iter().find(|isa| isa.name() == name);
        let isa = isa.ok_or_else(|| Error::unknown("SANDGAIT_ISA", &name, &known))?;
        if isa.available() {
            Ok(isa)
        } else {
            Err(Error::invalid("SANDGAIT_ISA", format!("this machine has no {name}")))
        }
    }
}
