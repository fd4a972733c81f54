//! What a body has found of the sand's memory.

use super::MemorySettings;
use serde::{Deserialize, Serialize};

/// The level and the compaction of the sand that a body has found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LocalSand {
    /// Height from which its depth counts [m]: `ground`, lowered where the heap of the theory is still missing.
    pub level: f32,
    /// How compacted the sand is, from 0 to 1.
    pub packed: f32,
    /// Radius of a disc with the second moment of the area with which the body has entered [m].
    pub size: f32,
    /// Is the body in the sand?
    pub inside: bool,
    /// Height of the surface that it has found [m].
    pub ground: f32,
    /// Height [m] and compaction of the sand that it finds next.
    pub next: [f32; 2],
    /// The heap that it pushes now: mean height [m] along the direction in which it has pushed it.
    pub heap: [f32; 2],
}

impl LocalSand {
    /// Length of [`Self::to_bytes`].
    pub(super) const BYTES: usize = 33;

    /// A body at the surface or just below: height [m] and compaction of the sand under it, and its own size [m].
    #[inline(always)]
    pub(super) fn at([under, packed, size]: [f64; 3], inside: bool) -> Self {
        let [level, packed, size] = [under, packed, size].map(|x| x as f32);
        Self { level, packed, size, inside, ground: level, next: [level, packed], heap: [0.0; 2] }
    }

    /// The body has travelled on, by this share of the lag's length, and finds this height [m] and compaction ahead.
    #[inline(always)]
    pub(super) fn go_on(&mut self, beyond: [f64; 2], way: f64) {
        let share = way.min(1.0);
        let follow = |own: f32, to: f64| f64::from(own) + (to - f64::from(own)) * share;
        let next = [0, 1].map(|k| follow(self.next[k], beyond[k]));
        let missing = f64::from(self.ground) - f64::from(self.level);
        let ground = follow(self.ground, next[0]);
        (self.ground, self.level) = (ground as f32, (ground - missing) as f32);
        self.packed = follow(self.packed, next[1]) as f32;
        self.next = next.map(|x| x as f32);
    }

    fn numbers(&self) -> [f32; 5] {
        [self.ground, self.next[0], self.next[1], self.heap[0], self.heap[1]]
    }

    /// All numbers, little-endian.
    pub(super) fn to_bytes(self) -> impl Iterator<Item = u8> {
        let first = [self.level, self.packed, self.size].map(f32::to_le_bytes);
        let rest = self.numbers().map(f32::to_le_bytes);
        first.into_iter().flatten().chain([u8::from(self.inside)]).chain(rest.into_iter().flatten())
    }

    /// From its [`Self::to_bytes`]; None if it cannot be of these settings.
    pub(super) fn from_bytes(s: &MemorySettings, bytes: &[u8; Self::BYTES]) -> Option<Self> {
        let (first, rest) = bytes.split_first_chunk::<12>()?;
        let (inside, rest) = rest.split_first()?;
        let number = |bytes: &[u8], k: usize| bytes.as_chunks::<4>().0.get(k).map(|four| f32::from_le_bytes(*four));
        let found = Self {
            level: number(first, 0)?,
            packed: number(first, 1)?,
            size: number(first, 2)?,
            inside: *inside == 1,
            ground: number(rest, 0)?,
            next: [number(rest, 1)?, number(rest, 2)?],
            heap: [number(rest, 3)?, number(rest, 4)?],
        };
        // Heights end at 32 cells; twice that for levels and sizes is our choice.
        let most = (64.0 * s.cell) as f32;
        let heights = [found.level, found.ground, found.next[0], found.heap[0], found.heap[1]];
        let possible = heights.iter().all(|height| height.abs() < most)
            && [found.packed, found.next[1]].iter().all(|packed| (0.0..=1.0).contains(packed))
            && (0.0..=most).contains(&found.size);
        (possible && *inside <= 1).then_some(found)
    }
}
