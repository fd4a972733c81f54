"""Motors' parameters that PACE or iit-DLSLab's identification found, as a `hardware.toml`.

    python -m sandgait.identified logs/pace/anymal/26_01_05_10-00-00/mean_199.pt --dt 0.0025 --out hardware.toml
    python -m sandgait.identified isaaclab_identified_parameters.py --dt 0.005 --out hardware.toml

PACE (leggedrobotics/pace-sim2real, `optim/cma_es.py`) writes `mean_NNN.pt`: for n joints n inertias of rotor and gear
[kg·m²], n viscous frictions [N·m·s/rad], n dry frictions [N·m], n errors of the encoders' zeros [rad] and one delay of
the torques in time steps of its simulation. iit-DLSLab (simple-robot-identification-isaaclab) keeps the same numbers
in `isaaclab_identified_parameters.py`, as lists.

A file of ours has one value for all joints: the mean of the joints', with their lowest and highest as its interval, so
that `domain_rand={"hardware": …}` draws between them. Errors of zeros become the standard deviation of `bias`, which
each joint draws for itself.
"""

from __future__ import annotations

import argparse
import ast
import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sandgait_deploy import Refused

from .command_line import check_file

Floats = npt.NDArray[np.float64]

#: Parts of PACE's row in their order.
_PARTS = ("armature", "viscous_friction", "friction", "bias")

#: Names of dry friction in iit-DLSLab's files; in each file there is one.
_FRICTIONS = ("dynamic_friction", "static_friction", "friction")


def hardware_of(file: str | Path, dt: float) -> str:
    """The text of the hardware.toml for the parameters in `file`; `dt`: time step of the simulation in which they were
    found [s]. Raises Refused with one line if the file is not one of these."""
    if not 0.0 < dt <= 0.1:
        raise Refused(f"dt: {dt} s is outside (0, 0.1]")
    path = Path(file)
    found = _of_python(path) if path.suffix == ".py" else _of_torch(path)
    rows: dict[str, Floats] = {name: np.asarray(found[name], np.float64).reshape(-1) for name in (*_PARTS, "delay")}
    if not all(np.isfinite(row).all() and row.size for row in rows.values()):
        raise Refused(f"{path}: has parameters that are not finite")
    actuator = {
        "friction": rows["friction"],
        "damping": rows["viscous_friction"],
        "rotor_inertia": rows["armature"],
    }
    for name, row in actuator.items():
        if row.min() < 0.0:
            raise Refused(f"{path}: {name} is negative")
    delay, bias = dt * rows["delay"], np.sqrt(np.mean(np.square(rows["bias"]), keepdims=True))
    lines = [f"source = {json.dumps(f'{path.name}, time step {dt:g} s', ensure_ascii=False)}"]
    lines += [f"action_delay = {_quantity(delay)}", "", "[actuator]"]
    lines += [f"{name} = {_quantity(row)}" for name, row in actuator.items()]
    lines += ["", "[sensors.joint_position]", f"bias = {_quantity(bias)}", ""]
    return "\n".join(lines)


def _quantity(row: Floats) -> str:
    value, low, high = (float(f"{number:.6g}") for number in (row.mean(), row.min(), row.max()))
    return f"{{ value = {min(max(value, low), high)!r}, interval = [{low!r}, {high!r}] }}"


def _of_torch(path: Path) -> Mapping[str, Any]:
    """PACE's row of 4 n + 1 numbers."""
    try:
        import torch
    except ImportError:
        raise Refused(f"{path}: is read by torch: pip install torch") from None
    try:
        row = torch.load(path, map_location="cpu", weights_only=True)
        numbers = np.asarray(row, np.float64).reshape(-1)
    except OSError as error:
        raise Refused(f"{path}: cannot be read: {error.strerror}") from None
    except Exception as error:  # torch has many errors for damaged files, and other files of PACE hold dictionaries
        raise Refused(f"{path}: is no mean_NNN.pt of PACE ({type(error).__name__})") from None
    count, rest = divmod(len(numbers), len(_PARTS))
    if rest != 1 or not count:
        raise Refused(f"{path}: has {len(numbers)} numbers; mean_NNN.pt of PACE has four for each joint and a delay")
    parts = {name: numbers[k * count : (k + 1) * count] for k, name in enumerate(_PARTS)}
    return {**parts, "delay": numbers[-1]}


def _of_python(path: Path) -> Mapping[str, Any]:
    """The lists in a file of iit-DLSLab, which is not run."""
    try:
        tree = ast.parse(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise Refused(f"{path}: cannot be read: {error.strerror}") from None
    except (SyntaxError, ValueError) as error:
        raise Refused(f"{path}: is no Python file: {error}") from None
    found: dict[str, Any] = {}
    for line in tree.body:
        if isinstance(line, ast.Assign) and isinstance(line.targets[0], ast.Name):
            try:
                found[line.targets[0].id] = np.asarray(ast.literal_eval(line.value), np.float64)
            except (ValueError, TypeError):
                continue
    friction = next((name for name in _FRICTIONS if name in found), None)
    if friction is not None:
        found["friction"] = found[friction]
    missing = [name for name in (*_PARTS, "delay") if name not in found]
    if missing:
        raise Refused(f"{path}: has no {missing[0]}; give isaaclab_identified_parameters.py or PACE's mean_NNN.pt")
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit code 0; 2 with one line if the file cannot be used, and nothing is written."""
    parser = argparse.ArgumentParser(
        prog="python -m sandgait.identified", description="Makes a hardware.toml of identified motors' parameters."
    )
    parser.add_argument("file", type=Path, help="PACE's mean_NNN.pt, or isaaclab_identified_parameters.py")
    parser.add_argument("--dt", type=float, required=True, metavar="S", help="time step of that simulation [s]")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="the hardware.toml to write")
    given = parser.parse_args(arguments)
    try:
        text = hardware_of(given.file, given.dt)
        check_file(given.out)
        given.out.write_text(text, encoding="utf-8")
    except Refused as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
