"""The scoreboard: its rows are those of tests/data, its errors are what they are said to be, wrong use is refused."""

from __future__ import annotations

import csv
import html
import importlib
import importlib.util
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sandgait
from sandgait import scoring, server
from sandgait.errors import InvalidRequest
from sandgait.scoring import rows

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "examples"))
WHEELS = ROOT / "tests/data/real_wheel"
LAWS = ("li2013", "agarwal2023", "penetration-drag-1d")


class Answers:
    """An entry that looks the measured forces up, and multiplies them."""

    def __init__(self, factor: float) -> None:
        self.factor = factor
        known = rows.read()
        #: Two beds may have the same motion; their forces are asked in this order.
        self._forces: dict[Any, list[Any]] = {}
        for group in known.groups:
            for course in group.courses:
                self._forces.setdefault(self._key(group.body, course.motion), []).append(course.force)
        self._speeds = {(w.robot, gait): s for w in known.walks for gait, s in zip(w.gaits, w.speed, strict=True)}

    def _key(self, body: Any, motion: Any) -> tuple[str, bytes]:
        return body.name, motion.position.tobytes() + motion.velocity.tobytes() + motion.t.tobytes()

    def force(self, body: Any, motion: Any, sand: Any) -> Any:
        measured = self._forces[self._key(body, motion)].pop(0)
        return self.factor * np.concatenate([measured, np.zeros_like(measured)], axis=1)

    def walk(self, robot: Any, gait: Any) -> float:
        return self.factor * float(self._speeds[robot, gait])


class Gives:
    """An entry with a force from a function of the number of samples."""

    def __init__(self, force: Callable[[int], Any]) -> None:
        self._force = force

    def force(self, body: Any, motion: Any, sand: Any) -> Any:
        return self._force(len(motion))


def sandgait_command(*words: str | Path) -> str:
    run = [*server.command(), *map(str, words)]
    return subprocess.run(run, capture_output=True, text=True, check=True).stdout


def board(entry: Any, **options: Any) -> sandgait.Scoreboard:
    return sandgait.scoreboard({"entry": entry}, against=(), progress=False, **options)


@pytest.fixture(scope="module")
def ours() -> sandgait.Scoreboard:
    """Our laws and MuJoCo in all rows."""
    return sandgait.scoreboard(progress=False)


@pytest.mark.parametrize(("factor", "error"), [(1.0, 0.0), (0.0, 1.0), (1.5, 0.5), (-1.0, 2.0)])
def test_the_error_is_the_share_of_the_force_that_is_missed(factor: float, error: float) -> None:
    """0 for an entry that gives the data, 100 % for one that gives no force, in every group and set, walks too."""
    found = board(Answers(factor))
    assert set(found["set"]) == {"wheels", "discs", "plates", "legs", "drag", "memory", "walks"}
    assert np.allclose(found["error"], error, rtol=0, atol=1e-12)
    assert np.allclose(found["ratio"], factor, rtol=0, atol=1e-12)
    parts = np.nansum([found[f"error_{axis}"] ** 2 for axis in "xyz"], axis=0)
    assert np.allclose(parts, found["error"] ** 2)
    several = ~np.isnan(found["low"])
    assert {"drag", "memory"}.isdisjoint(found["set"][several])
    assert np.allclose(found["low"][several], error)
    assert np.allclose(found["high"][several], error)


def test_intervals_contain_the_error_and_grow_with_the_scatter() -> None:
    """An entry that is wrong in one condition only: the interval is wide. Equally wrong in each: it has no width."""

    class Odd:
        def force(self, body: Any, motion: Any, sand: Any) -> Any:
            wrench = Answers(1.0).force(body, motion, sand)
            wrench[::9] *= 2.0
            return wrench

    found = board(Odd(), sets=["wheels"])
    assert (found["low"] < found["error"]).all()
    assert (found["error"] < found["high"]).all()


@pytest.mark.parametrize("law", LAWS)
def test_wheels_are_those_of_validate(law: str, ours: sandgait.Scoreboard, tmp_path: Path) -> None:
    """The same 126 rows. `sandgait validate` prints errors in % of the mean load."""
    for file in ("validation.toml", "wheel_smooth.csv", "wheel_grouser.csv"):
        text = (WHEELS / file).read_text(encoding="utf-8")
        (tmp_path / file).write_text(re.sub("(?m)^fitted.*\n", "", text), encoding="utf-8")
    sand = (WHEELS / "sand_discs.toml").read_text(encoding="utf-8")
    (tmp_path / "sand_discs.toml").write_text(sand.replace('"agarwal2023"', f'"{law}"'), encoding="utf-8")
    printed = re.search(
        r"^\| all \| (\d+) \|(.*)", sandgait_command("validate", "--data", tmp_path), flags=re.MULTILINE
    )
    assert printed
    table = ours.predictions
    mine = (table["entry"] == law) & (table["set"] == "wheels")
    assert mine.sum() == int(printed[1]) == 126
    missed = [np.sqrt(np.mean((table[f"{f}_predicted"][mine] - table[f][mine]) ** 2)) for f in ("Fx", "Fy", "Fz")]
    theirs = [float(number) for number in re.findall(r"([\d.]+) \[", printed[2])[:3]]
    assert np.allclose(100 * np.array(missed) / table["Fz"][mine].mean(), theirs, rtol=0, atol=0.051)
    frame = sandgait.validate(tmp_path, progress=False)
    for name in ("Fx", "Fy", "Fz"):
        assert np.array_equal(table[name][mine], frame[name])
        assert np.allclose(table[f"{name}_predicted"][mine], frame[f"{name}_predicted"], rtol=0, atol=1e-9)


def test_legs_are_those_of_validate(ours: sandgait.Scoreboard, tmp_path: Path) -> None:
    """The table that `validate` and `reproduce` print: errors for the mean of two beds in % of the greatest force."""
    sandgait_command("reproduce", "--figure", "3", "--out", tmp_path)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    lines = [[re.sub("<.*", "", cell) for cell in line.split("<td>")[1:]] for line in page.split("<tr>")]
    printed = [line for line in lines if len(line) == 9 and line[4] in LAWS]
    assert len(printed) == 2 * 2 * 2 * 3
    table = ours.predictions
    for leg, speed, component, _, law, rms, peak, *_ in ([html.unescape(cell) for cell in line] for line in printed):
        group = f"{leg.removesuffix('-leg')}, {speed} rad/s"
        mine = (table["entry"] == law) & (table["group"] == group)
        name, sign = ("Fz", 1.0) if component.startswith("lift") else ("Fx", -1.0)
        predicted, measured = (sign * table[n][mine].reshape(2, -1) for n in (f"{name}_predicted", name))
        mean = measured.mean(axis=0)
        # The report rounds, and cuts a leg into plates of another size.
        error = 100 * np.sqrt(np.mean((predicted[0] - mean) ** 2)) / mean.max()
        assert abs(error - float(rms.removesuffix(" %"))) < 0.6, (leg, speed, component, law)
        assert abs(predicted[0].max() / mean.max() - float(peak)) < 0.006 + 0.005 * float(peak)


def test_rows_are_the_files_of_the_tests() -> None:
    """Each file with rows is one of tests/data, byte for byte; walking speeds are those of the program's source."""
    own = {"scoreboard.toml", "walks.csv"}
    sources = {
        path.name: path
        for folder in ("real_wheel", "grains", "memory", "drag")
        for path in (ROOT / "tests/data" / folder).iterdir()
    }
    names = {path.name for path in rows.DATA.iterdir()}
    assert names > own
    for name in names - own:
        assert (rows.DATA / name).read_bytes() == sources[name].read_bytes(), name
    assert sum(path.stat().st_size for path in rows.DATA.iterdir()) < 500_000
    source = (ROOT / "src/validate/others.rs").read_text(encoding="utf-8")
    table = re.search(r"const WALKS.*?;\n", source, flags=re.DOTALL)
    assert table
    walks = {
        leg: [float(v) for v in speeds.split(", ")] for leg, speeds in re.findall(r'"(\w+)", \[([\d., ]+)\]', table[0])
    }
    assert walks == {walk.robot.leg: walk.speed.tolist() for walk in rows.read().walks}
    frequencies = re.search(r"FREQUENCIES: \[f64; 4\] = \[([\d., ]+)\]", source)
    assert frequencies
    listed = [float(f) for f in frequencies[1].split(", ")]
    assert all([gait.frequency for gait in walk.gaits] == listed for walk in rows.read().walks)


def test_no_calibration_is_scored() -> None:
    """ζ comes from the 60 mm disc and from the plate's slowest pushes; neither is a row."""
    groups = rows.read().groups
    assert not [g.name for g in groups if g.set == "discs" and g.body.solids[0].sizes["radius"] < 0.035]
    speeds = [abs(c.motion.velocity[0, 2]) for g in groups if g.set == "plates" and "down" in g.name for c in g.courses]
    assert min(speeds) == pytest.approx(0.2)


def test_mujoco_is_fitted_to_the_push_and_has_dry_friction(ours: sandgait.Scoreboard) -> None:
    from sandgait.scoring.soft_contact import SoftContact

    for group in rows.read().groups[::6]:
        push, sand = group.sand.push, group.sand
        area = {"cylinder": np.pi * 0.03**2, "box": 0.038 * 0.025}[push.solids[0].kind]
        still = np.zeros((1, 3))
        place = np.array([[0.0, 0.0, -0.01 - push.lowest]])
        level = np.array([[1.0, 0.0, 0.0, 0.0]])
        moves = scoring.Motion(np.zeros(1), place, level, np.array([[0.05, 0.0, 0.0]]), still, True)
        wrench = SoftContact().force(push, moves, sand)[0]
        assert wrench[2] == pytest.approx(1e6 * sand.zeta * area * 0.01, rel=0.02)
        assert wrench[0] == pytest.approx(-sand.friction * wrench[2], rel=1e-6)
        above = scoring.Motion(np.zeros(1), place + np.array([0.0, 0.0, 0.011]), level, still, still, True)
        assert not SoftContact().force(push, above, sand).any()
    # A push of the same plate in the same grains is close to the fit; a leg, which has another area, is not.
    errors = {g: e for n, g, e in zip(ours["entry"], ours["group"], ours["error"], strict=True) if n == "mujoco"}
    assert errors["down, 0.2 m/s"] < 0.2
    assert errors["L, 2.5 rad/s"] > 1.0


def test_motions_and_bodies_are_as_described() -> None:
    known = {group.name: group for group in rows.read().groups}
    wheel = known["smooth wheel"].courses[0].motion
    assert wheel.steady
    assert np.array_equal(wheel.rotation[0], np.eye(3))
    lines = (WHEELS / "wheel_smooth.csv").read_text(encoding="utf-8").splitlines()
    first = next(csv.DictReader(line for line in lines if not line.startswith("#")))
    assert wheel.position[0, 2] == pytest.approx(0.0625 - float(first["depth"]))
    leg = known["L, 2.5 rad/s"]
    tip = np.array([0.0, 0.0, -0.076])
    motion = leg.courses[0].motion
    theta = -2.0616
    assert motion.position[0] + motion.rotation[0] @ tip == pytest.approx(
        [0.076 * np.sin(theta), 0, 0.02 - 0.076 * np.cos(theta)]
    )
    assert motion.angular_velocity[0].tolist() == [0.0, -2.5, 0.0]
    ends = np.concatenate([[s.position for s in leg.body.solids], leg.body.plates()["center"]])
    assert (ends[:, 0] > 0).all()  # an L bulges forward
    for group in known.values():
        for course in group.courses:
            assert (np.diff(course.motion.t) > 0).all() or course.motion.steady
            assert np.isfinite(course.force).all()


def test_tables_can_be_kept(ours: sandgait.Scoreboard, tmp_path: Path) -> None:
    assert str(ours) == ours.to_markdown(tmp_path / "board.md") == (tmp_path / "board.md").read_text(encoding="utf-8")
    assert str(ours).count("| group | rows | li2013 |") == 7
    assert "3d-terramechanics" in str(ours)
    lines = ours.summary().splitlines()
    assert lines[0] == f"| set | rows | {' | '.join(scoring.ENTRIES)} |"
    assert [line.split(" | ")[0] for line in lines[2:]] == [f"| {name}" for name in dict.fromkeys(ours["set"].tolist())]
    assert {line.count("|") for line in lines} == {len(scoring.ENTRIES) + 3}
    page = ours.to_html(tmp_path / "board.html")
    assert page == (tmp_path / "board.html").read_text(encoding="utf-8")
    assert page.count("<table>") == page.count("</table>") == 7
    assert "http" not in page
    ours.to_csv(tmp_path / "board.csv")
    with (tmp_path / "board.csv").open(newline="") as file:
        written = list(csv.DictReader(file))
    assert [float(line["error"]) for line in written] == ours["error"].tolist()
    assert [line["group"] for line in written] == ours["group"].tolist()
    assert list(written[0]) == list(ours)
    assert ours.to_frame().shape == (len(written), len(ours))


def test_memory_helps_where_sand_was_moved(ours: sandgait.Scoreboard) -> None:
    """And changes nothing in steady motions, each of which has fresh sand."""
    error = {(n, g): e for n, g, e in zip(ours["entry"], ours["group"], ours["error"], strict=True)}
    for law in ("li2013", "agarwal2023"):
        assert error[f"{law} with memory", "furrow of three passes"] < 0.8 * error[law, "furrow of three passes"]
        assert error[f"{law} with memory", "smooth wheel"] == error[law, "smooth wheel"]


@pytest.mark.parametrize(
    ("force", "words"),
    [
        (
            lambda n: np.zeros((n, 3)),
            r"entry 'entry': force in set wheels, smooth wheel: has shape \(81, 3\), not \(81, 6\)",
        ),
        (lambda n: np.zeros(6), r"has shape \(6,\), not \(81, 6\)"),
        (lambda n: np.full((n, 6), np.nan), r"nan at \[0, 0\] is not finite"),
        (lambda n: np.full((n, 6), -np.inf), r"-inf at \[0, 0\] is not finite"),
        (lambda n: None, r"has shape \(\), not|expected a wrench"),
        (lambda n: "strong", "expected a wrench for each sample"),
        (lambda n: [[1.0] * 6] * n + [[1.0]], "expected a wrench for each sample"),
    ],
)
def test_wrong_wrenches_are_refused(force: Callable[[int], Any], words: str) -> None:
    with pytest.raises(InvalidRequest, match=words):
        board(Gives(force))


def test_wrong_use_is_refused(tmp_path: Path) -> None:
    class Walks:
        def walk(self, robot: Any, gait: Any) -> float:
            return 0.0

    class Stands(Answers):
        def walk(self, robot: Any, gait: Any) -> Any:
            return [1.0, 2.0]

    class Fails:
        def force(self, body: Any, motion: Any, sand: Any) -> Any:
            raise RuntimeError("out of memory")

    with pytest.raises(sandgait.WrongType, match=r"'Walks' has no method force\(body, motion, sand\)"):
        sandgait.scoreboard(Walks())
    with pytest.raises(sandgait.WrongType, match=r"'Answers' is a class; give an object of it, Answers\(\)"):
        sandgait.scoreboard({"Answers": Answers})
    with pytest.raises(InvalidRequest, match=r"walk of L at 1 Hz: has shape \(2,\), not \(\): a speed"):
        board(Stands(1.0), sets=["walks"])
    with pytest.raises(InvalidRequest, match="there is none"):
        sandgait.scoreboard(against=())
    with pytest.raises(InvalidRequest, match="is an entry of this package"):
        sandgait.scoreboard({"mujoco": Answers(1.0)})
    with pytest.raises(InvalidRequest, match="agarwal2023"):
        sandgait.scoreboard(against=["agarwal"])
    with pytest.raises(InvalidRequest, match="wheels"):
        board(Answers(1.0), sets=["wheel"])
    with pytest.raises(InvalidRequest, match=r"scoreboard\.toml"):
        board(Answers(1.0), rows=tmp_path)
    with pytest.raises(RuntimeError) as error:
        board(Fails())
    assert error.value.__notes__ == ["entry 'entry': force in set wheels, smooth wheel"]


OWN = """
[sand.mine]
name = "my sand"
calibration = "mine.toml"
push = "cylinder:radius=0.02,height=0.002"
friction = 0.5
[set.mine]
title = "My pushes"
source = "my laboratory"
licence = "CC0"
[[group]]
set = "mine"
name = "ball"
sand = "mine"
body = "sphere:radius=0.02"
rows = "ball.csv"
course = ["trial"]
"""
ROWS = "trial,depth,vz,Fz\na,0.01,-0.1,1\na,0.02,-0.1,2\nb,0.01,-0.1,1.5\nb,0.02,-0.1,2.5\n"


def own_rows(folder: Path, description: str = OWN, text: str = ROWS) -> Path:
    (folder / "scoreboard.toml").write_text(description, encoding="utf-8")
    (folder / "mine.toml").write_text("bulk_density = 1500.0\n[sand]\nzeta = 0.5\n", encoding="utf-8")
    (folder / "ball.csv").write_text(text, encoding="utf-8")
    return folder


def test_rows_of_ones_own_are_scored(tmp_path: Path) -> None:
    seen = []

    class Pushes:
        def force(self, body: Any, motion: Any, sand: Any) -> Any:
            seen.append((motion.t.tolist(), motion.position[:, 2].tolist(), sand.zeta, sand.bulk_density))
            return np.array([[0.0, 0.0, f, 0.0, 0.0, 0.0] for f in (1.0, 2.0)])

    found = board(Pushes(), rows=own_rows(tmp_path))
    assert seen == [([0.0, pytest.approx(0.1)], pytest.approx([0.01, 0.0]), 0.5, 1500.0)] * 2
    assert found["group"].tolist() == ["ball", "all"]
    assert found["error"][0] == pytest.approx((0.5 / 13.5) ** 0.5)
    assert found["rows"].tolist() == [4, 4]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("rows = ", "row = ", "key"),
        ('sand = "mine"', 'sand = "yours"', "sand"),
        ("sphere:radius=0.02", "sphere", "no shape"),
        ("ball.csv", "balls.csv", "balls.csv"),
        ('course = ["trial"]', 'course = ["bed"]', "no column 'bed'"),
        ('course = ["trial"]', 'columns = { Fz = "force" }', "no column 'force'"),
        ('course = ["trial"]', "most = { depth = 0.001 }", "no row is left"),
        ('licence = "CC0"', "", "title, source and licence"),
        ("[sand.mine]", "[sand.mine", "scoreboard.toml"),
        ("friction = 0.5", "", "no 'friction'"),
    ],
)
def test_wrong_rows_are_refused(old: str, new: str, words: str, tmp_path: Path) -> None:
    assert old in OWN
    with pytest.raises(InvalidRequest, match=words):
        board(Answers(1.0), rows=own_rows(tmp_path, OWN.replace(old, new)))


def test_wrong_cells_are_refused(tmp_path: Path) -> None:
    for cell in ("two", "nan", ""):
        with pytest.raises(InvalidRequest, match=r"ball\.csv.*'Fz'"):
            board(Answers(1.0), rows=own_rows(tmp_path, text=ROWS.replace("2.5", cell)))


def test_forces_that_are_all_zero_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidRequest, match=r"ball\.csv: every force of group 'ball' is 0"):
        board(Answers(1.0), rows=own_rows(tmp_path, text="trial,depth,vz,Fz\na,0.01,-0.1,0\na,0.02,-0.1,0\n"))


def test_progress_is_told() -> None:
    told: list[tuple[float, str]] = []
    sandgait.scoreboard(
        Answers(1.0), against=(), sets=["discs"], progress=lambda share, what: told.append((share, what))
    )
    assert told == [(0.0, "Answers: discs, disc of 80 mm"), (0.5, "Answers: discs, disc of 100 mm")]


def test_without_mujoco_its_entry_is_left_out_and_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.warns(UserWarning, match="mujoco is left out"):
        found = sandgait.scoreboard(Answers(1.0), sets=["discs"], progress=False)
    assert set(found["entry"]) == {"Answers", *scoring.ENTRIES} - {"mujoco"}


@pytest.mark.parametrize("dt", [0.001, 0.004, 0.05])
def test_time_steps_reach_each_sample(dt: float) -> None:
    """The pose at a sample is the sample's within the way of half a step, and velocities lead from step to step."""
    for group in rows.read().groups[::4]:
        motion = group.courses[0].motion
        speed = np.linalg.norm(motion.velocity, axis=1).max() + 0.2
        seen = []
        for number, run in enumerate(motion.runs(dt, way=0.02)):
            if number == 3:
                break
            place = motion.position[number if motion.steady else 0] + np.array([0.0, 0.0, 0.1])
            for step in run:
                place = place + dt * step.velocity
                assert place == pytest.approx(step.position, abs=1e-9)
                for sample in step.samples:
                    seen.append(sample)
                    if not motion.steady:
                        assert np.linalg.norm(step.position - motion.position[sample]) <= speed * dt
                    assert step.position[2] == pytest.approx(motion.position[sample, 2], abs=speed * dt)
                    assert step.angular_velocity == pytest.approx(motion.angular_velocity[sample])
        assert seen == list(range(3 if motion.steady else len(motion)))


def test_time_steps_turn_a_wheel() -> None:
    """A steady wheel comes straight down without a turn, then turns with its spin."""
    motion = rows.read().groups[0].courses[0].motion
    number = int(np.argmax(motion.angular_velocity[:, 1]))
    run = list(list(motion.runs(0.01, above=0.05, way=0.03))[number])
    down = [step for step in run if not step.angular_velocity.any()]
    assert len(down) in (49, 50)
    assert all(np.allclose(step.velocity, [0.0, 0.0, -0.1]) for step in down[:-1])
    seconds = (len(run) - 50) * 0.01
    assert seconds == pytest.approx(0.03 / np.linalg.norm(motion.velocity[number]), abs=0.01)
    half = 0.5 * motion.angular_velocity[number, 1] * seconds
    assert run[-1].quaternion == pytest.approx([np.cos(half), 0.0, np.sin(half), 0.0], abs=1e-9)


@pytest.mark.parametrize(
    ("module", "entry"), [("newton", "NewtonSand"), ("chrono", "ChronoSand"), ("genesis", "GenesisSand")]
)
def test_stubs_follow_the_protocol(module: str, entry: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """With a scene that gives no force. Their simulators are not installed, so nothing else of them is tested."""
    stub = importlib.import_module(f"scoreboard_{module}")
    assert "It was never run here" in " ".join(str(stub.__doc__).split())
    poses = []

    class Scene:
        def __init__(self, *given: Any) -> None:
            poses.clear()

        def move(self, step: Any) -> Any:
            poses.append(step.position)
            return np.zeros(3 if module == "genesis" else 6)

    monkeypatch.setattr(stub, "Scene", Scene)
    made = object.__new__(getattr(stub, entry))
    made.gs = None
    assert np.allclose(board(made, sets=["drag"])["error"], 1.0)
    assert len(poses) > 100
