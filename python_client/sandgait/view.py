"""Pictures, a window and recordings of environments.

The simulating process or server draws the pictures. `render_mode="rgb_array"` needs no display, no GPU and no other
package. `"human"` shows the same pictures in a window of pygame.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from . import _native
from .door import Camera
from .errors import InvalidRequest, OutOfOrder, SandgaitError, unknown
from .recording import FilePath, Recorder
from .shards import Shards

Pictures = npt.NDArray[np.uint8]

RENDER_MODES = ["rgb_array", "human"]

#: Default width and height of a picture [px].
SIZE = (480, 360)


def camera(given: Mapping[str, Any] | None) -> Camera:
    """The camera of the keyword `render_camera`: a dictionary with some of azimuth_deg, elevation_deg, distance and
    follow."""
    known = {"azimuth_deg": None, "elevation_deg": None, "distance": None, "follow": True}
    for name, value in (given or {}).items():
        if name not in known:
            raise unknown("render_camera:", name, known)
        if not isinstance(value, bool if name == "follow" else (int, float)):
            raise InvalidRequest(
                f"render_camera: {name} {value!r} is not {'True or False' if name == 'follow' else 'a number'}"
            )
    azimuth, elevation, distance, follow = {**known, **(given or {})}.values()
    chosen: Camera = (azimuth, elevation, distance, bool(follow))
    try:
        _native.check_camera(chosen)
    except InvalidRequest as error:
        raise InvalidRequest(f"render_{error}") from None
    return chosen


class Window:
    """A window that shows pictures, at most `rate` of them in a second."""

    def __init__(self, title: str, rate: float) -> None:
        try:
            import pygame
        except ImportError as error:
            raise SandgaitError(
                "render_mode: 'human' shows a window by pygame, which is not installed: pip install 'sandgait[human]', "
                "or take 'rgb_array'"
            ) from error
        self._pygame = pygame
        self._title, self._rate = title, rate
        self._screen: Any = None
        self._clock: Any = None

    def show(self, picture: Pictures) -> None:
        """Shows a picture, u8 [height, width, 3]."""
        pygame = self._pygame
        height, width, _ = picture.shape
        if self._screen is None:
            # SDL would load OpenGL even for a plain window. Mesa loads the system LLVM with its symbols visible to all
            # libraries; then torch's own LLVM (triton, at the first optimizer) ends Python with a segmentation fault.
            os.environ.setdefault("SDL_FRAMEBUFFER_ACCELERATION", "0")
            try:
                pygame.display.init()
                self._screen = pygame.display.set_mode((width, height))
            except pygame.error as error:
                raise SandgaitError(f"render_mode: 'human' cannot open a window: {error}; take 'rgb_array'") from error
            pygame.display.set_caption(self._title)
            self._clock = pygame.time.Clock()
        self._screen.blit(pygame.image.frombuffer(picture.tobytes(), (width, height), "RGB"), (0, 0))
        pygame.event.pump()
        pygame.display.flip()
        self._clock.tick(self._rate)

    def close(self) -> None:
        if self._screen is not None:
            self._screen = None
            self._pygame.display.quit()


class View:
    """Makes the pictures, window and recording of one or many environments."""

    def __init__(
        self, shards: Shards, render_mode: str | None, size: tuple[int, int], camera_options: Mapping[str, Any] | None
    ) -> None:
        if render_mode is not None and render_mode not in RENDER_MODES:
            raise unknown("render_mode:", render_mode, RENDER_MODES)
        for name, side in zip(("width", "height"), size, strict=True):
            if not 16 <= side <= 4096:
                raise InvalidRequest(f"render_size: {name} {side} is outside [16, 4096]")
        self._shards = shards
        self._camera = camera(camera_options)
        self._size = (int(size[0]), int(size[1]))
        self._recorder: Recorder | None = None
        #: The environment that is recorded.
        self.index = 0
        self._window = Window(shards.task.id, shards.task.control_rate) if render_mode == "human" else None

    @classmethod
    def of(
        cls, shards: Shards, render_mode: str | None, size: tuple[int, int], camera_options: Mapping[str, Any] | None
    ) -> View:
        """The view of a session. If it cannot be made, the session is closed."""
        try:
            return cls(shards, render_mode, size, camera_options)
        except BaseException:
            shards.close()
            raise

    def pictures(self, indices: list[int], ended: bool = False) -> Pictures:
        """Pictures, u8 [indices, height, width, 3]. `ended`: show the last state of an episode that ended in this
        step."""
        width, height = self._size
        try:
            pixels = self._shards.render(indices, self._size, ended, self._camera)
        except InvalidRequest as error:  # the number of pixels: the caller has chosen their size, not the indices
            raise InvalidRequest(re.sub("^indices: ", "render_size: ", str(error))) from None
        return np.frombuffer(pixels, np.uint8).reshape(len(indices), height, width, 3).copy()

    def moved(self, *, record_ended: bool, show_ended: bool) -> None:
        """Records the state after a reset or step, and shows it in the window.

        The arguments matter if an episode ended in the step: if an argument is true, the last state of that episode is
        taken, else the first state of the next one.
        """
        if self._recorder is not None:
            self._recorder.add(*self._shards.observe(self.index, record_ended))
        if self._window is not None:
            self.show(show_ended)

    def show(self, ended: bool = False) -> None:
        """Shows the first environments in the window, at most four."""
        assert self._window is not None
        self._window.show(tiles(self.pictures(list(range(min(self._shards.num_envs, 4))), ended)))

    def record(self, path: FilePath, index: int) -> None:
        """Starts a recording of environment `index` to the file `path`: its state after each reset or step from now
        on."""
        if not 0 <= index < self._shards.num_envs:
            raise InvalidRequest(f"index: {index} is outside [0, {self._shards.num_envs})")
        if self._recorder is not None:
            raise OutOfOrder("record: a recording is being made; call stop_recording first")
        self._recorder, self.index = Recorder(path), index

    def stop_recording(self) -> None:
        """Completes the recording, if there is one in progress."""
        if self._recorder is not None:
            self._recorder.close()
            self._recorder = None

    def close(self) -> None:
        self.stop_recording()
        if self._window is not None:
            self._window.close()


def tiles(pictures: Pictures) -> Pictures:
    """Joins pictures [n, height, width, 3] to one picture, side by side in rows."""
    count, height, width, _ = pictures.shape
    across = math.ceil(math.sqrt(count))
    down = math.ceil(count / across)
    grid = np.zeros((down * across, height, width, 3), np.uint8)
    grid[:count] = pictures
    return grid.reshape(down, across, height, width, 3).swapaxes(1, 2).reshape(down * height, across * width, 3)
