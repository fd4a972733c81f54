"""What notebooks show: `_repr_html_` of environments and results. Every text in it is escaped."""

from __future__ import annotations

import base64
import json
import re
import subprocess
import sys
import zlib
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

import sandgait
from conftest import ID
from sandgait import adapt, notebook
from sandgait.adapt import Adaptation, Posterior
from sandgait.certify import Case, Certificate, Outcome, Request
from sandgait.certify.ground import ground_of
from sandgait.diagnosis import Diagnosis
from sandgait.plant import Conditions
from sandgait.recording import Recording, Section
from sandgait_deploy import Verification, read_policy

ROOT = Path(__file__).parents[2]
CAT = ROOT / "examples/policies/LeggedVelocity-sandcat"
HOSTILE = "<script>alert(1)</script>'\"><img src=x onerror=alert(2)>"
ACTION = np.full(6, 0.4, dtype=np.float32)


class Parts(HTMLParser):
    """The tags, their attributes and the text of a representation."""

    def __init__(self, shown: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str | None]] = []
        self.text = ""
        self.feed(shown)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += attrs

    def handle_data(self, data: str) -> None:
        self.text += data + " "


def parts(thing: Any) -> Parts:
    """The representation of `thing`, which has no script, no handler, and no picture from elsewhere."""
    found = Parts(thing._repr_html_())
    assert "script" not in found.tags
    for name, value in found.attributes:
        assert not name.startswith("on"), name
        assert name != "src" or str(value).startswith("data:image/"), value
    return found


def pixels(found: Parts) -> np.ndarray:
    """The picture of a representation, u8 [height, width, 3]."""
    png = base64.b64decode(dict(found.attributes)["src"].removeprefix("data:image/png;base64,"))  # type: ignore[union-attr]
    assert png.startswith(b"\x89PNG\r\n\x1a\n")
    width, height = np.frombuffer(png[16:24], ">u4")
    start = png.index(b"IDAT") + 4
    rows = np.frombuffer(zlib.decompress(png[start : start + int.from_bytes(png[start - 8 : start - 4])]), np.uint8)
    return rows.reshape(height, 1 + 3 * width)[:, 1:].reshape(height, width, 3)


def table(**columns: Any) -> sandgait.Table:
    made = {name: np.asarray(values) for name, values in columns.items()}
    return sandgait.Table(made, dict.fromkeys(made, "m"))


def training(curve: sandgait.Table, name: str = "task", score: dict[str, Any] | None = None) -> sandgait.Training:
    return sandgait.Training(Path(name), 2000, 3.25, curve, score, f"{name}: done\nmore")


def diagnosis(name: str, page: str) -> Diagnosis:
    divided = {"parts": [{"name": name, "error": -0.025}, {"name": "there", "error": 0.4}]}
    report = {"verdict": "named", "headline": name, "action": f"Do {name}", "split": divided}
    return Diagnosis(json.dumps(report), page, "", "", table(x=[1.0]))


def certificate(name: str) -> Certificate:
    policy = read_policy(CAT)
    ground = ground_of(policy, "rigid")
    failed = Outcome(ground.conditions(), (), refused=name)
    grid = ((Case("latency", name, Conditions(), required=True), failed),)
    request = Request(CAT, Path(name))
    return Certificate(policy, request, ground, Verification(()), {}, {"rigid": failed}, failed, grid, None, (name,))


def recording(name: str, **columns: tuple[int, ...]) -> Recording:
    header = {
        "task": name,
        "robot": name,
        "rate": 50.0,
        "columns": [{"name": column, "shape": list(shape)} for column, shape in columns.items()]
        + [{"name": name, "shape": []}],
    }
    width = 1 + sum(int(np.prod(shape)) for shape in columns.values())
    return Recording((Section(header, np.arange(10.0 * width, dtype=np.float32).reshape(10, width)),))


def adaptation(name: str) -> Adaptation:
    request = adapt.Request(Path(name), CAT, Path(name), Path("out"))
    found = Posterior("rigid", name, (), "", "", "")
    return Adaptation(request, found, None, None, None, name)


def scores(name: str) -> sandgait.Scoreboard:
    columns: dict[str, Any] = {key: np.array([name]) for key in ("entry", "set", "group")}
    columns |= {"rows": np.array([3]), **{key: np.array([0.5]) for key in ("error", "low", "high")}}
    about = {name: dict.fromkeys(("title", "source", "licence"), name)}
    return sandgait.Scoreboard(columns, dict.fromkeys(columns, ""), table(x=[1.0]), about)


def hostile_environment(name: str) -> sandgait.SandgaitEnv:
    env = sandgait.SandgaitEnv(ID, hardware=f"# {name}\n")
    env.close()
    return env


@pytest.mark.parametrize(
    "make",
    [
        lambda name: table(**{name: [name, "b"]}),
        lambda name: training(table(steps=[1.0, 2.0], **{"return": [1.0, 2.0]}), name, {name: name}),
        lambda name: diagnosis(name, f"<h3>{notebook.escaped(name)}</h3><div class=panels><svg ></svg></div>"),
        certificate,
        adaptation,
        scores,
        recording,
        hostile_environment,
    ],
    ids=["table", "training", "diagnosis", "certificate", "adaptation", "scoreboard", "recording", "environment"],
)
def test_hostile_names_are_text(make: Callable[[str], Any]) -> None:
    thing = make(HOSTILE)
    assert HOSTILE in parts(thing).text
    assert "&lt;script&gt;alert(1)" in thing._repr_html_()


def test_scripts_of_a_page_stay_in_a_picture() -> None:
    """An `img` runs no scripts, whatever is in the report's drawings."""
    drawn = parts(diagnosis("it", "<h3>a</h3><div class=panels><svg ><script>alert(1)</script></svg>\n</div>"))
    source = str(dict(drawn.attributes)["src"])
    assert b"<script>" in base64.b64decode(source.removeprefix("data:image/svg+xml;base64,"))


def test_an_environment_shows_robot_task_and_options() -> None:
    env = sandgait.SandgaitEnv(ID, render_size=(64, 48), leg="L", command=(0.1, 0.4), slope_deg=5)
    assert "No picture: render before reset" in parts(env).text
    env.reset(seed=0)
    found = parts(env)
    assert f" {ID} " in f" {found.text}"
    assert "environments 1 slope_deg 5 " in found.text
    assert "leg" not in found.text.split("environments")[1], "an option that is equal to its default"
    assert "command" not in found.text.split("environments")[1]
    rendering = sandgait.SandgaitEnv(ID, render_mode="rgb_array", render_size=(64, 48), slope_deg=5)
    rendering.reset(seed=0)
    assert np.array_equal(pixels(found), rendering.render())  # type: ignore[arg-type]
    env.step(ACTION)
    assert not np.array_equal(pixels(parts(env)), pixels(found))
    for one in (env, rendering):
        one.close()
    assert "No picture: the environment is closed." in parts(env).text


def test_many_environments_show_their_number_and_the_first_robot() -> None:
    envs = sandgait.SandgaitVectorEnv(ID, num_envs=3, render_size=(64, 48))
    envs.reset(seed=0)
    found = parts(envs)
    assert found.text.endswith("environments 3 ")
    assert pixels(found).shape == (48, 64, 3)
    envs.send(np.tile(ACTION, (3, 1)))
    assert "No picture: a step is in flight." in parts(envs).text
    envs.recv()
    envs.close()


def test_the_limit_of_gymnasium_is_no_option_of_the_user() -> None:
    env = gymnasium.make(ID)
    assert "max_episode_steps" not in parts(env.unwrapped).text
    env.close()
    env = gymnasium.make(ID, max_episode_steps=40, slope_deg=3)
    assert "slope_deg 3" in parts(env.unwrapped).text
    env.close()


def test_the_end_of_an_episode_is_shown_until_the_next_one() -> None:
    env = sandgait.SandgaitEnv(ID, render_mode="rgb_array", render_size=(64, 48), max_episode_steps=3)
    env.reset(seed=0)
    while not env.step(ACTION)[3]:
        pass
    assert np.array_equal(pixels(parts(env)), env.render())  # type: ignore[arg-type]
    env.close()


def test_a_recording_shows_its_facts_and_the_way(tmp_path: Path) -> None:
    env = sandgait.SandgaitEnv(ID, slope_deg=5)
    env.record(tmp_path / "walk.rec")
    env.reset(seed=7)
    for _ in range(20):
        env.step(ACTION)
    env.close()
    found = parts(sandgait.read_recording(tmp_path / "walk.rec"))
    assert f"task {ID} robot xplorer" in found.text
    assert "slope_deg 5 " in found.text
    assert "episodes 1 states 21, 0.42 s" in found.text
    assert "polyline" in found.tags
    assert "sandgait replay FILE --html film.html" in found.text
    assert "No curve" in parts(recording("stroke", time=())).text
    assert "No curve" in parts(recording("odd", time=(2,), position=(3,))).text


def test_a_training_shows_its_learning_curve() -> None:
    rows = table(steps=[100.0, 200.0, 300.0, 400.0], **{"return": [np.nan, 10.0, 40.0, 30.0]})
    found = parts(training(rows, score={"speed": {"mean": 0.25, "low": 0.2, "high": 0.3}, "rate": None}))
    points = str(dict(found.attributes)["points"]).split()
    assert len(points) == 3, "a row without an episode that ended has no point"
    heights = [float(point.split(",")[1]) for point in points]
    assert heights[0] > heights[2] > heights[1], "y goes down"
    assert "environment steps" in found.text
    assert "return" in found.text
    assert "speed 0.25 (95 % interval 0.2 to 0.3)" in found.text
    assert "rate" not in found.text.split("duration")[1]
    assert "steps 2000 duration [s] 3.25 folder task" in found.text
    empty = training(table(steps=np.empty(0), **{"return": np.empty(0)}))
    assert "No curve of return over environment steps: it has 0 points." in parts(empty).text


def test_a_constant_curve_is_drawn_in_the_middle() -> None:
    drawn = notebook.curve(np.arange(3.0), np.full(3, 5.0), "x", "y")
    heights = {point.split(",")[1] for point in re.findall(r"points='(.*?)'", drawn)[0].split()}
    assert heights == {"106.0"}


def test_a_diagnosis_shows_three_lines_and_the_worst_condition() -> None:
    data = ROOT / "examples/data"
    made = sandgait.diagnose(data / "force_log.csv", data / "force_log.toml", progress=False)
    found = parts(made)
    assert made.headline in found.text
    assert made.action in found.text
    assert re.search(r"of the plain model: [+-]\d+% .*, [+-]\d+% ", found.text), found.text
    assert found.tags.count("img") == 2, "Fx and Fz"
    assert "No picture: the report has none." in parts(diagnosis("it", "")).text


def test_a_certificate_shows_verdict_and_cases() -> None:
    found = parts(certificate("it slips"))
    assert found.text.startswith(
        "DO NOT DEPLOY: it slips reason: it slips the robot as stated: does not start: it slips"
    )
    assert "case required holds walk latency it slips yes no does not start: it slips" in found.text


def test_tables_show_rows_with_units() -> None:
    found = parts(table(a=[1.0, 0.123456], b=["x", "y"]))
    assert found.text.split() == ["a", "[m]", "b", "[m]", "1", "x", "0.1235", "y"]
    many = parts(table(a=np.arange(351)))
    assert [word for word in many.text.split() if word.isdigit()][:20] == [
        str(k) for k in [*range(10), *range(341, 351)]
    ]
    assert "351 rows, of which the first and the last 10 are shown" in many.text
    assert "speed [m/s]" in parts(sandgait.walk([1, 2])).text
    assert "return_low" in parts(sandgait.evaluate("tripod:2", slopes=[0], seeds=2, progress=False)).text
    assert parts(sandgait.Table({}, {})).tags.count("td") == 0


def test_a_sweep_shows_its_figure_or_its_rows() -> None:
    columns = {"leg": np.array(["L", HOSTILE]), "speed": np.array([0.1, 0.2])}
    units = {"leg": "", "speed": "m/s"}
    found = parts(sandgait.Sweep(columns, units, "speed", f"<svg><text>{HOSTILE}</text></svg>"))
    assert found.tags == ["img"]
    assert ("alt", "speed of leg") in found.attributes
    assert HOSTILE in parts(sandgait.Sweep(columns, units, "speed")).text


def test_long_texts_are_cut_off() -> None:
    assert len(notebook.shown("x" * 10_000)) < 200


def test_options_equal_to_their_defaults_are_left_out() -> None:
    defaults = {"a": 5, "b": [1, 2], "c": "x", "d": {"e": None}}
    equal = {"a": 5.0, "b": (1, 2.0), "c": "x", "d": {"e": None}}
    assert notebook.differing(equal, defaults) == {}
    others = {"a": "5", "b": np.array([1, 3]), "c": np.arange(2), "d": {}, "f": 1}
    assert notebook.differing(others, defaults) == others


def test_nothing_heavy_is_imported() -> None:
    program = "import sandgait, sys; print([m for m in ('matplotlib', 'pandas', 'IPython', 'PIL') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
