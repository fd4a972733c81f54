"""Environments of other packages, on sand: `OnSand`. Needs `sandgait[mujoco]`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import gymnasium

from .errors import InvalidRequest
from .mujoco import ModelSand, add_sand
from .sand import Sand, Shape

try:
    import mujoco
except ImportError as error:
    raise ImportError("mujoco is not installed: pip install 'sandgait[mujoco]'") from error


class OnSand(gymnasium.Wrapper[Any, Any, Any, Any], gymnasium.utils.RecordConstructorArgs):
    """A MuJoCo environment whose floor is sand.

        env = OnSand(gymnasium.make("Ant-v5"), medium="poppy-loose")

    Rewards, observations and ends are the environment's own; its `contact_forces` include those of the sand. `sand`, a
    `sandgait.Sand`, replaces `medium` and `law`. `bodies` and `plate_size`: as for `sandgait.mujoco.add_sand`. With
    `show_forces=True` pictures have an arrow for each force.

    An environment of dm_control is changed in place and returned: `env = OnSand(suite.load("quadruped", "walk"))`.
    """

    def __new__(cls, env: Any = None, medium: str = "poppy-loose", **options: Any) -> Any:
        if env is None or isinstance(env, gymnasium.Env):  # None: a copy is made
            return super().__new__(cls)
        physics = getattr(env, "physics", None)
        if physics is None:
            raise InvalidRequest(f"env: {type(env).__name__} is no environment of gymnasium or dm_control")
        options.pop("show_forces", None)
        ground = _sand(physics.model.ptr, medium, **options)

        def step(nstep: int = 1) -> None:
            # dm_control's own step ends with `mj_step1`, so that observations are those of the new positions.
            data = physics.data.ptr
            with physics.check_invalid_state():
                for _ in range(nstep):
                    ground.press(data)
                    mujoco.mj_step2(ground.model, data)
                    mujoco.mj_step1(ground.model, data)

        physics.step = step
        return env

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        medium: str = "poppy-loose",
        *,
        law: str = "li2013",
        sand: Sand | None = None,
        bodies: Iterable[str] | Mapping[str, Shape | Iterable[Shape]] | None = None,
        plate_size: float | None = None,
        show_forces: bool = False,
    ) -> None:
        gymnasium.utils.RecordConstructorArgs.__init__(
            self, medium=medium, law=law, sand=sand, bodies=bodies, plate_size=plate_size, show_forces=show_forces
        )
        gymnasium.Wrapper.__init__(self, env)
        model = getattr(env.unwrapped, "model", None)
        if not isinstance(model, mujoco.MjModel) or not hasattr(env.unwrapped, "_step_mujoco_simulation"):
            raise InvalidRequest(f"env: {env.unwrapped} has no MuJoCo model that gymnasium's MujocoEnv steps")
        #: The sand below the model.
        self.ground: ModelSand = _sand(model, medium, law=law, sand=sand, bodies=bodies, plate_size=plate_size)
        self._show_forces = show_forces
        # gymnasium's environments make all steps of MuJoCo by this method.
        env.unwrapped._step_mujoco_simulation = self._step

    def _step(self, ctrl: Any, n_frames: int) -> None:
        data = self.env.unwrapped.data  # type: ignore[attr-defined]
        data.ctrl[:] = ctrl
        self.ground.step(data, n_frames)
        mujoco.mj_rnePostConstraint(self.ground.model, data)
        self.ground.add_contact_forces(data)

    def render(self) -> Any:
        renderer = getattr(self.env.unwrapped, "mujoco_renderer", None)
        if renderer is not None and self.env.render_mode is not None:
            viewer = renderer._get_viewer(self.env.render_mode)
            data = self.env.unwrapped.data  # type: ignore[attr-defined]
            for marker in self.ground.markers(data, forces=self._show_forces):
                viewer.add_marker(**marker)
        return self.env.render()

    def close(self) -> None:
        self.ground.remove()
        vars(self.env.unwrapped).pop("_step_mujoco_simulation", None)
        super().close()


def _sand(
    model: mujoco.MjModel, medium: str, *, law: str = "li2013", sand: Sand | None = None, **options: Any
) -> ModelSand:
    return add_sand(model, Sand(medium, law=law) if sand is None else sand, **options)
