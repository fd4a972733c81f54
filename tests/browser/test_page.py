"""The page in a real browser: it loads, shows the robot at its recorded place, and requests nothing from other hosts.

If $SANDGAIT_SHOTS is set, screenshots are written to this directory. The pictures of docs/seeing.md are made this way.
"""

from __future__ import annotations

import os
import subprocess
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from chromium import Page

import sandgait
from sandgait import server

ID = "sandgait/HexapodGait-v1"
ACTION = np.full(6, 0.4, dtype=np.float32)


@pytest.fixture
def page(tmp_path: Path) -> Iterator[Page]:
    page = Page(tmp_path / "profile")
    yield page
    page.close()


def shots(tmp_path: Path) -> Path:
    chosen = Path(os.environ.get("SANDGAIT_SHOTS", tmp_path))
    chosen.mkdir(exist_ok=True)
    return chosen


def colours(page: Page, canvas: str) -> int:
    """Number of different colours on a canvas; 1 if nothing was drawn."""
    copy = "Object.assign(document.createElement('canvas'), {width: c.width, height: c.height})"
    return int(
        page.ask(f"""(() => {{ const c = document.getElementById('{canvas}'), d = {copy}, x = d.getContext('2d');
        x.drawImage(c, 0, 0); const p = new Uint32Array(x.getImageData(0, 0, c.width, c.height).data.buffer);
        return new Set(p).size; }})()""")
    )


def tips(section: sandgait.Section, k: int) -> np.ndarray:
    """Tips of the legs [legs, 3] of a robot with one joint in each leg, from the recorded numbers."""
    w, x, y, z = section["orientation"][k].astype(float)
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    places = []
    for body, angle in zip(section.header["bodies"][1:], section["angles"][k].astype(float), strict=True):
        axis, reach = np.array(body["axis"]), np.array(body["reach"])
        along = axis * (axis @ reach)
        swung = along + (reach - along) * np.cos(angle) + np.cross(axis, reach) * np.sin(angle)
        places.append(section["position"][k] + turn @ (np.array(body["joint"]) + swung))
    return np.array(places)


TIPS = """player.world.figures.bodies.slice(1).map((b, k) => new THREE.Vector3(
    ...player.world.section.header.bodies[k + 1].reach).applyQuaternion(b.quaternion).add(b.position).toArray())"""


def recorded(path: Path, steps: int, **options: Any) -> sandgait.Recording:
    env = gymnasium.make(ID, **options).unwrapped
    assert isinstance(env, sandgait.SandgaitEnv)
    env.record(path)
    env.reset(seed=1)
    for _ in range(steps):
        env.step(ACTION)
    env.close()
    return sandgait.read_recording(path)


@pytest.mark.parametrize(("name", "options"), [("level", {"leg": "C"}), ("slope", {"leg": "C", "slope_deg": 10})])
def test_a_recording_plays(page: Page, tmp_path: Path, name: str, options: dict[str, Any]) -> None:
    section = recorded(tmp_path / "walk.rec", 200, command=[0.2, 0.2], **options).sections[0]
    html = tmp_path / f"{name}.html"
    subprocess.run([*server.command(), "replay", tmp_path / "walk.rec", "--html", html], check=True)
    page.open(f"file://{html}")
    page.until("player.world?.pose !== undefined && player.world.pose !== null")
    first = page.ask("player.time")
    page.until(f"player.time > {first} + 0.3")
    page.ask("player.play(false)")
    for k in (0, 55, 200):
        page.ask(f"player.time = {k / 50 + 1e-4}")
        page.until(f"Math.abs(player.world.pose.bodies[0].position.x - {section['position'][k, 0]}) < 1e-3")
        assert np.array(page.ask(TIPS)) == pytest.approx(tips(section, k), abs=2e-3)
    assert colours(page, "world") > 500
    for chart in ("gait", "speed", "torque", "reward"):
        assert colours(page, chart) > 10, chart
    downhill = page.ask("new THREE.Vector3(1, 0, 0).applyQuaternion(player.world.tilted.quaternion).z")
    assert downhill == pytest.approx(np.sin(np.radians(options.get("slope_deg", 0))), abs=1e-6)
    page.picture(shots(tmp_path) / f"replay_{name}.png")
    assert not page.troubles
    assert all(url.startswith(("file:", "data:", "blob:")) for url in page.requests), page.requests


def test_slow_motion_and_pause(page: Page, tmp_path: Path) -> None:
    recorded(tmp_path / "walk.rec", 400)
    html = tmp_path / "walk.html"
    subprocess.run([*server.command(), "replay", tmp_path / "walk.rec", "--html", html], check=True)
    page.open(f"file://{html}")
    page.until("player.world?.pose !== undefined")
    page.ask("(() => { const s = document.getElementById('pace'); s.value = '0.1'; s.onchange(); player.time = 1; })()")
    # Advances by a fifth of a second by hand, because without a GPU the rate of frames is irregular.
    moved = "(() => { const t = player.time; tick(0.2); return player.time - t; })()"
    assert page.ask(moved) == pytest.approx(0.02, abs=1e-9)
    at = page.ask("player.time")
    page.until(f"player.time > {at} + 0.05")
    page.ask("document.getElementById('play').click()")
    assert page.ask("document.getElementById('play').textContent") == "Play"
    assert page.ask(moved) == 0
    page.ask("(() => { const s = document.getElementById('scrub'); s.value = 6.5; s.oninput(); })()")
    page.until("document.getElementById('readout').textContent.includes('6.50 s')")
    assert not page.troubles


class Walker:
    """A session on a server that makes steps at the control rate, as a training would."""

    def __init__(self, address: str, envs: int) -> None:
        self.env = sandgait.SandgaitVectorEnv(ID, envs, address, leg="C", command=[0.2, 0.2])
        self.env.reset(seed=1)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._walk)
        self._thread.start()

    def _walk(self) -> None:
        actions = np.zeros(self.env.action_space.shape, np.float32)
        actions[1] = 0.4
        while not self._over.is_set():
            self.env.step(actions)
            time.sleep(0.02)

    def close(self) -> None:
        self._over.set()
        self._thread.join()
        self.env.close()


def test_the_live_page_follows_a_session(page: Page, tmp_path: Path) -> None:
    address = f"unix:{tmp_path}/s"
    arguments = [*server.command(), "serve", "--listen", address, "--viewer", "127.0.0.1:0", "--exit-on-stdin-close"]
    log = tmp_path / "log"
    with log.open("w") as out:
        process = subprocess.Popen(arguments, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=out, text=True)
    assert process.stdout is not None
    process.stdout.readline()
    url = log.read_text().split("browsers see the sessions at ")[1].split()[0]
    page.open(url)
    page.until("document.getElementById('status').textContent.startsWith('No session yet')")
    walker = Walker(address, 2)
    try:
        page.until("document.getElementById('environment').options.length === 2")
        page.until("player.recording.moments.length > 20")
        assert page.ask("Math.abs(player.world.pose.bodies[0].position.x)") < 0.02, "the first one stands"
        choose = "(() => { const c = document.getElementById('environment'); c.selectedIndex = 1; c.onchange(); })()"
        page.ask(choose)
        page.until("player.recording.moments.length > 20")
        x = page.ask("player.world.pose.bodies[0].position.x")
        page.until(f"player.world.pose.bodies[0].position.x > {x} + 0.1")
        assert "sandgait/HexapodGait-v1" in page.ask("document.getElementById('status').textContent")
        page.until("player.recording.end - player.recording.start > 4.5")
        drawn = "new Promise(done => requestAnimationFrame(() => done(player.recording.end - player.time)))"
        assert page.ask(drawn) < 1.1, "it keeps up"
        page.picture(shots(tmp_path) / "live.png")
        page.ask("player.play(false)")
        time.sleep(0.3)
        held = page.ask("player.time")
        time.sleep(0.5)
        assert page.ask("player.time") == held
    finally:
        walker.close()
    page.until(
        "document.getElementById('status').textContent === 'No session yet: make an environment on this server.'"
    )
    assert not page.troubles
    assert all(request.startswith((url, "data:", "blob:")) for request in page.requests), page.requests
    process.communicate(timeout=10)
