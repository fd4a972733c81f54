"""The page in a real browser: it loads, shows the robot at its recorded place, and requests nothing from other hosts.

If $SANDGAIT_SHOTS is set, screenshots are written to this directory. The pictures of docs/seeing.md are made this way.
"""

from __future__ import annotations

import gzip
import json
import os
import struct
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


#: Number of solids of each body, and its position and quaternion.
PARTS = """player.world.figures.bodies.map((b) => b.children.flatMap((c) => c.children.length ? c.children : [c])
    .filter((c) => c.isMesh && c.geometry.attributes.position.count > 2).length)"""
HUNG = "player.world.figures.bodies.map((b) => [...b.position.toArray(), ...b.quaternion.toArray()])"


def turned(q: np.ndarray, by: np.ndarray) -> np.ndarray:
    """Product of two quaternions w, x, y, z."""
    (w, u), (s, v) = (q[0], q[1:]), (by[0], by[1:])
    return np.array([w * s - u @ v, *(w * v + s * u + np.cross(u, v))])


def hung(section: sandgait.Section, k: int) -> np.ndarray:
    """Position and quaternion x, y, z, w of each body of a robot from a file, from the numbers alone."""
    poses = [(section["position"][k].astype(float), section["orientation"][k].astype(float))]
    for body, angle in zip(section.header["bodies"][1:], section["angles"][k].astype(float), strict=True):
        at, q = poses[body["parent"]]
        place = turned(turned(q, np.array([0.0, *body["joint"]])), q * [1, -1, -1, -1])[1:]
        hinge = np.array([np.cos(angle / 2), *(np.sin(angle / 2) * np.array(body["axis"]))])
        poses.append((at + place, turned(turned(q, np.array(body["turn"])), hinge)))
    return np.array([[*at, *q[1:], q[0]] for at, q in poses])


@pytest.mark.parametrize("ground", ["poppy-loose", "dunes"])
def test_a_robot_from_a_file_is_drawn_by_its_shapes(page: Page, tmp_path: Path, ground: str) -> None:
    robot = Path(__file__).parents[2] / "robots" / "sandcat.urdf"
    env = sandgait.SandgaitEnv("sandgait/LeggedVelocity-v1", robot=robot, ground=ground, domain_rand=None)
    env.record(tmp_path / "cat.rec")
    for seed in range(2):
        env.reset(seed=seed)
        for t in range(50):
            env.step(0.4 * np.sin(0.4 * t + np.arange(12)).astype(np.float32))
    env.close()
    section = sandgait.read_recording(tmp_path / "cat.rec").sections[1]
    html = tmp_path / f"{ground}.html"
    subprocess.run([*server.command(), "replay", tmp_path / "cat.rec", "--html", html], check=True)
    page.open(f"file://{html}")
    page.until("player.world?.pose !== undefined && player.world.pose !== null")
    page.ask("player.play(false)")
    start = page.ask("player.recording.moments.find((m) => m.section === player.recording.sections[1]).at")
    for k in (0, 30):
        page.ask(f"player.time = {start + k / 50 + 1e-4}")
        page.until(f"Math.abs(player.world.pose.bodies[0].position.x - {section['position'][k, 0]}) < 1e-3")
        page.until("player.world.section === player.recording.sections[1]")
        drawn, told = np.array(page.ask(HUNG)), hung(section, k)
        told[:, 3:] *= np.sign((told[:, 3:] * drawn[:, 3:]).sum(axis=1, keepdims=True))
        assert drawn == pytest.approx(told, abs=2e-3)
    shapes = section.header["shapes"]["shapes"]
    each = [sum(len(s["form"]) + 2 * ("capsule" in s["form"]) for s in shapes if s["body"] == b) for b in range(13)]
    assert page.ask(PARTS) == each
    for chart in ("gait", "speed", "torque", "reward"):
        assert colours(page, chart) > 10, chart
    x, y, z = section["position"][30]
    assert page.ask(f"height_at(player.world.section.header.relief, {x}, {y})" if ground == "dunes" else "0") < z
    page.picture(shots(tmp_path) / f"cat_{ground}.png")
    assert not page.troubles


#: Sum of the forces that the arrows show [N].
SHOWN = """(() => { const { shafts, scale } = player.world.arrows, m = new THREE.Matrix4(), sum = new THREE.Vector3();
    for (let k = 0; k < shafts.count; k += 1) { shafts.getMatrixAt(k, m);
        sum.add(new THREE.Vector3().setFromMatrixColumn(m, 1).divideScalar(scale)); }
    return sum.toArray(); })()"""


def colour(page: Page, place: list[float]) -> list[int]:
    """Red, green and blue of the canvas where it shows a place of the world [m]."""
    found = page.ask(f"""(() => {{ const {{ canvas, tilted, camera }} = player.world;
        const p = tilted.localToWorld(new THREE.Vector3(...{place})).project(camera);
        const d = document.createElement('canvas'), x = d.getContext('2d');
        [d.width, d.height] = [canvas.width, canvas.height]; x.drawImage(canvas, 0, 0);
        const at = [(p.x + 1) / 2 * d.width, (1 - p.y) / 2 * d.height].map(Math.round);
        return Array.from(x.getImageData(...at, 1, 1).data); }})()""")
    assert found[3] == 255, f"{place} is outside the picture"
    return list(found[:3])


def as_before(path: Path) -> None:
    """Removes from a recording what those of older versions lack: hard ground, and forces of robots from files."""
    stream, kept = gzip.decompress(path.read_bytes()), b""
    while stream:
        kind, length = struct.unpack("<4sI", stream[:8])
        content, stream = stream[8 : 8 + length], stream[8 + length :]
        if kind == b"HEAD":
            header = json.loads(content)
            added = 6 * len(header.pop("touching"))
            header.pop("hard")
            assert [c["name"] for c in header["columns"][-2:]] == ["ground_forces", "ground_points"]
            del header["columns"][-2:]
            content = json.dumps(header).encode()
        else:
            content = content[: -4 * added]
        kept += struct.pack("<4sI", kind, len(content)) + content
    path.write_bytes(gzip.compress(kept))


def test_hard_ground_and_forces_are_seen(page: Page, tmp_path: Path) -> None:
    robot = Path(__file__).parents[2] / "robots" / "sandcat.urdf"
    options: dict[str, Any] = {"domain_rand": None, "angle_noise": 0.0}
    env = sandgait.SandgaitEnv("sandgait/LeggedVelocity-v1", robot=robot, ground="mixed", **options)
    env.record(tmp_path / "cat.rec")
    env.reset(seed=1)
    for _ in range(200):
        env.step(np.zeros(12, np.float32))
    env.close()
    for old in (False, True):
        if old:
            as_before(tmp_path / "cat.rec")
        html = tmp_path / f"cat_{old}.html"
        subprocess.run([*server.command(), "replay", tmp_path / "cat.rec", "--html", html], check=True)
        page.open(f"file://{html}")
        page.until("player.world?.pose !== undefined && player.world.pose !== null")
        page.ask("player.play(false)")
        page.ask("player.time = player.recording.end")
        page.until("player.world.pose.bodies[0].position.z < 0.3 && player.time === player.recording.end")
        page.ask("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
        assert page.ask("document.getElementById('arrows').parentElement.hidden") is old
        # Behind the robot: on the slab, which ends at 0.4 m, and beside it.
        (red, _, blue), (_, _, _) = slab, sand = [colour(page, [x, 0.3, 0.0]) for x in (0.37, 0.45)]
        assert sand[0] - sand[2] > 40, sand
        assert (abs(red - blue) < 15) is not old, slab
        if not old:
            weight = page.ask("player.world.section.header.mass") * 9.81
            assert page.ask(SHOWN) == pytest.approx([0, 0, weight], abs=0.03 * weight)
            page.picture(shots(tmp_path) / "cat_mixed.png")
    assert not page.troubles


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

    def __init__(self, address: str, envs: int, task: str = ID, **options: Any) -> None:
        self.env = sandgait.SandgaitVectorEnv(task, envs, address, **options)
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


@pytest.fixture
def live(page: Page, tmp_path: Path) -> Iterator[tuple[Page, str]]:
    """The live page of a new server, and the server's address. At the end the page must have had no trouble."""
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
    yield page, address
    page.until(
        "document.getElementById('status').textContent === 'No session yet: make an environment on this server.'"
    )
    assert not page.troubles
    assert all(request.startswith((url, "data:", "blob:")) for request in page.requests), page.requests
    process.communicate(timeout=10)


def test_the_live_page_follows_a_session(live: tuple[Page, str], tmp_path: Path) -> None:
    page, address = live
    walker = Walker(address, 2, leg="C", command=[0.2, 0.2])
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


def test_the_live_page_follows_a_robot_from_a_file(live: tuple[Page, str], tmp_path: Path) -> None:
    page, address = live
    robot = Path(__file__).parents[2] / "robots" / "sandcat.xml"
    options: dict[str, Any] = {"robot": robot, "ground": "mixed", "domain_rand": None, "angle_noise": 0.0}
    walker = Walker(address, 2, "sandgait/LeggedVelocity-v1", **options)
    try:
        page.until("player.recording.end - player.recording.start > 3.0")
        page.until("player.recording.end - player.time < 1.1")
        status = page.ask("document.getElementById('status').textContent")
        assert "LeggedVelocity-v1 · sandcat · poppy-loose and hard ground" in status
        # The first one stands on a slab in the middle of the picture, and the ground carries it.
        assert page.ask(HUNG)[0][:3] == pytest.approx([0, 0, 0.22], abs=0.06)
        weight = page.ask("player.world.section.header.mass") * 9.81
        assert page.ask(SHOWN) == pytest.approx([0, 0, weight], abs=0.1 * weight)
        slab, trunk = colour(page, [0.25, -0.35, 0.0]), colour(page, page.ask(HUNG)[0][:3])
        assert abs(slab[0] - slab[2]) < 15, slab
        assert np.abs(np.subtract(slab, trunk)).max() > 20, (slab, trunk)
        page.picture(shots(tmp_path) / "live_cat.png")
    finally:
        walker.close()


def test_arrow_keys_steer_a_robot(page: Page, tmp_path: Path) -> None:
    arguments = [*server.command(), "play", "HexapodGait", "--no-browser", "--seconds", "120"]
    process = subprocess.Popen(arguments, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        url = process.stdout.readline().strip()
        assert url.startswith("http://127.0.0.1:")
        assert "/#key=" in url
        page.open(url)
        page.until("document.getElementById('steering').textContent.startsWith('↑')")
        page.until("player.recording.moments.length > 20")
        newest = "player.recording.moments[player.recording.moments.length - 1]"
        command = f"{newest}.section.get({newest}.row, 'commanded_speed')[0]"
        # Without a key the command is the value nearest to 0 with which the policy was trained.
        assert page.ask(command) == pytest.approx(0.1)
        page.call("Input.dispatchKeyEvent", type="keyDown", code="ArrowUp", key="ArrowUp")
        page.until(f"Math.abs({command} - 0.4) < 1e-6")
        x = page.ask("player.world.pose.bodies[0].position.x")
        page.until(f"Math.abs(player.world.pose.bodies[0].position.x - {x}) > 0.2")
        page.picture(shots(tmp_path) / "play.png")
        page.call("Input.dispatchKeyEvent", type="keyUp", code="ArrowUp", key="ArrowUp")
        page.until(f"Math.abs({command} - 0.1) < 1e-6")
        assert not page.troubles
        page.ask("location.hash = '#key=wrong'")
        page.ask("location.reload()")
        page.until("document.getElementById('steering')?.textContent.includes('it has the key')")
    finally:
        process.terminate()
        process.communicate(timeout=10)
