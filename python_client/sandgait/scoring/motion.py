"""Motions of the scoreboard's bodies, as arrays for laws and as time steps for simulators that move grains."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

#: Speed at which the bodies came down to their first sample [m/s], as those in grains did (tests/data/drag).
_DOWN = 0.1


class MotionStep(NamedTuple):
    """Where a body is at the end of a time step, and how it moves in the step."""

    #: Of the body's origin [m].
    position: Array
    #: w, x, y, z.
    quaternion: Array
    #: [m/s]
    velocity: Array
    #: In the world's axes [rad/s].
    angular_velocity: Array
    #: Samples of the motion that this step reaches, whose wrench is that of this step.
    samples: list[int]


@dataclass(frozen=True)
class Motion:
    """A course of a body, sample by sample, in a world whose z points up and whose sand is level at z = 0.

    Before the first sample the body came straight down into sand that nothing had moved. If `steady`, the samples are
    no course: each is a state of its own in such sand, moved on with constant velocity until the force is constant.
    """

    #: [samples], s.
    t: Array
    #: Of the body's origin: [samples, 3], m.
    position: Array
    #: Attitude w, x, y, z: [samples, 4].
    quaternion: Array
    #: Of the body's origin: [samples, 3], m/s.
    velocity: Array
    #: In the world's axes: [samples, 3], rad/s.
    angular_velocity: Array
    steady: bool

    def __len__(self) -> int:
        """Number of samples."""
        return len(self.t)

    @property
    def rotation(self) -> Array:
        """Matrices from the body's frame to the world's axes: [samples, 3, 3]."""
        w, x, y, z = self.quaternion.T
        rows = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
        return np.moveaxis(np.array(rows), -1, 0)

    def runs(self, dt: float, above: float = 0.1, way: float = 0.1) -> Iterator[Iterator[MotionStep]]:
        """The motion in time steps of `dt` [s], for simulators in which forces depend on earlier motion.

        Each run begins in fresh sand, with the body `above` [m] its first pose, and comes straight down at 0.1 m/s. A
        course is one run through all its samples. Steady motions are one run for each sample: after it came down, the
        body moves on by `way` [m], or turns once if it stays where it is. The sample is reached at the end.
        """
        for first in range(len(self)) if self.steady else (0,):
            yield self._run(first, dt, above, way)

    def _run(self, first: int, dt: float, above: float, way: float) -> Iterator[MotionStep]:
        start = above / _DOWN
        times, indices = start + self.t - self.t[0], list(range(len(self)))
        if self.steady:
            speed, turning = (float(np.linalg.norm(part[first])) for part in (self.velocity, self.angular_velocity))
            times, indices = np.array([start + (way / speed if speed else 2.0 * np.pi / max(turning, 1e-9))]), [first]
        before = self.position[first] + [0.0, 0.0, above]
        # Each sample belongs to the nearest step, so the last step has the last sample.
        reached = np.maximum(1, np.ceil(times / dt - 0.5 - 1e-9))
        for step in range(1, int(reached[-1]) + 1):
            time = step * dt - start
            position, quaternion, spin = self._pose(first, max(time, 0.0))
            if time < 0.0:
                position, spin = position - [0.0, 0.0, _DOWN * time], np.zeros(3)
            samples = [index for index, last in zip(indices, reached, strict=True) if last == step]
            yield MotionStep(position, quaternion, (position - before) / dt, spin, samples)
            before = position

    def _pose(self, first: int, time: float) -> tuple[Array, Array, Array]:
        """Place, attitude and spin at a time after the first sample."""
        if self.steady:
            spin = self.angular_velocity[first]
            turn = np.linalg.norm(spin) * time
            axis = spin / max(np.linalg.norm(spin), 1e-12)
            turned = _product(np.concatenate([[np.cos(turn / 2)], np.sin(turn / 2) * axis]), self.quaternion[first])
            return self.position[first] + time * self.velocity[first], turned, spin
        at = self.t - self.t[0]
        position, quaternion, spin = (
            np.array([np.interp(time, at, column) for column in part.T])
            for part in (self.position, self.quaternion, self.angular_velocity)
        )
        return position, quaternion / np.linalg.norm(quaternion), spin


def _product(first: Array, second: Array) -> Array:
    """Product of two quaternions: the rotation `second`, then `first`."""
    (a, u), (b, v) = (first[0], first[1:]), (second[0], second[1:])
    return np.concatenate([[a * b - u @ v], a * v + b * u + np.cross(u, v)])
