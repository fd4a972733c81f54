//! Which instruction set the hot path runs on; chosen when a session is made, so one binary runs everywhere.

use crate::error::{Error, Result};

/// A way to compute lanes of environments.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Isa {
    /// 16 lanes of `f32`.
    Avx512,
    /// 8 lanes of `f32`, fused multiply-add.
    Avx2,
    /// 4 lanes of `f32` in portable code; every processor.
    Baseline,
    /// One lane of `f64`: the reference the others are measured against.
    F64,
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

    /// Environments that one block carries.
    pub fn lanes(self) -> usize {
        match self {
            Self::Avx512 => 16,
            Self::Avx2 => 8,
            Self::Baseline => 4,
            Self::F64 => 1,
        }
    }

    /// Can this machine run it?
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

    /// The environment variable `SANDGAIT_ISA` if set, else the widest that the machine has.
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
