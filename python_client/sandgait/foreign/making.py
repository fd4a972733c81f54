"""Makes a policy of LeggedVelocity from a foreign one."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from sandgait_deploy import Refused
from sandgait_deploy.network import Network

from .. import _native
from ..command_line import check_folder
from ..deploy import describe
from ..errors import SandgaitError
from ..options import with_files
from ..spaces import Task
from .description import Description, Floats, read_description
from .layout import action_map, action_scale, observation_map
from .onnx_file import OnnxFile
from .steps import Steps
from .torchscript_file import TorchScriptFile

TASK = "sandgait/LeggedVelocity-v1"

#: Observations at which the made network is compared with the foreign one, and their largest difference as a part of
#: the largest output: our choices; rounding to 32 bits in another order gives some 1e-6.
_COMPARED, _DIFFERENT = 16, 1e-4

#: Sensors that are left out of the observation if the network has no use for them.
_LEFT_OUT = ("lin_vel", "gyroscope", "gravity", "joint_velocity")


def make_policy(description: Path, folder: Path) -> Path:
    """See `sandgait.foreign.import_policy`."""
    told, place = read_description(description), folder
    check_folder(place)
    network = _network(told)
    options = _options(told)
    try:
        packed = dict(with_files(options))
        about = _about(packed)
        onnx = _onnx(told, network, about)
        _compare(told, network.function(), about, onnx)
        with tempfile.TemporaryDirectory() as made:  # nothing is left behind if it cannot be described
            _write(Path(made), told, packed, onnx)
            describe(made)
            place.mkdir(parents=True, exist_ok=True)
            for file in Path(made).iterdir():
                (place / file.name).write_bytes(file.read_bytes())
    except (SandgaitError, _native.StatusError) as error:
        raise Refused(f"{told.path}: {error}") from None
    except OSError as error:
        raise Refused(f"{place}: cannot be written: {error.strerror}") from None
    return place


def _network(told: Description) -> OnnxFile | TorchScriptFile:
    torchscript = told.network.suffix in (".pt", ".pth", ".jit")
    try:
        network = TorchScriptFile(told.network) if torchscript else OnnxFile(told.network)
    except Refused as error:
        raise Refused(f"{told.path}: {error}") from None
    width = network.width(told.width)
    if width != told.width:
        raise Refused(f"{told.path}: observation: the terms have {told.width} numbers, the network's input {width}")
    return network


def _options(told: Description) -> dict[str, Any]:
    """Options of LeggedVelocity with which the foreign policy runs."""
    used = {term.reading for term in told.terms}
    joints = dict(zip(told.joints, np.array([told.default, told.kp, told.kd]).T.tolist(), strict=True))
    clock = next((1.0 / term.period for term in told.terms if term.period), None)
    return {
        "ground": "rigid",
        "domain_rand": None,
        **told.options,
        "robot": str(told.robot),
        "curriculum": None,
        "commands": told.commands,
        "default_joint_angles": {name: values[0] for name, values in joints.items()},
        "stiffness": {name: values[1] for name, values in joints.items()},
        "damping": {name: values[2] for name, values in joints.items()},
        "action_scale": action_scale(told),
        "gait_clock": clock,
        "history": told.history,
        "sensors": {"without": [name for name in _LEFT_OUT if name not in used]},
    }


def _about(options: dict[str, Any]) -> dict[str, Any]:
    """policy.json of a network that does nothing, which has the order of joints and observations."""
    local = _native.Local(TASK, 1, options, 1)
    task = Task.of(local.task)
    local.close()
    steps = Steps(len(task.observation))
    still = steps.file(steps.dense("observation", np.zeros((len(task.observation), len(task.action))), 0.0))
    about: dict[str, Any] = json.loads(_native.describe_policy(TASK, options, still)[0])
    return about


def _onnx(told: Description, network: OnnxFile | TorchScriptFile, about: dict[str, Any]) -> bytes:
    joints = [target["joint"] for target in about["targets"]]
    wrong = [name for name in told.joints if name not in joints] or [name for name in joints if name not in told.joints]
    if wrong:
        raise Refused(f"{told.path}: joints.names: only one of policy and robot has {wrong[0]!r}; the robot's are "
                      f"{', '.join(joints)}; weld joints that the policy does not drive")  # fmt: skip
    matrix, offset = observation_map(told, about["observation"], about["joints"])
    steps = Steps(len(about["observation"]))
    try:
        output = network.add(steps, steps.dense("observation", matrix.T, offset))
    except Refused as error:
        raise Refused(f"{told.path}: {error}") from None
    if steps.widths[output] != len(joints):
        raise Refused(f"{told.path}: network: its output has {steps.widths[output]} numbers for {len(joints)} joints")
    action = steps.dense(output, action_map(told, joints).T, 0.0)
    one = np.ones(1, np.float32)
    return steps.file(steps.both("Min", steps.both("Max", action, -one), one))


def _compare(told: Description, foreign: Callable[[Floats], Floats], about: dict[str, Any], onnx: bytes) -> None:
    """Refuses a network that was not read right."""
    matrix, offset = observation_map(told, about["observation"], about["joints"])
    joints = [target["joint"] for target in about["targets"]]
    back = action_map(told, joints)
    random = np.random.default_rng(0)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "policy.onnx"
        path.write_bytes(onnx)
        made = Network(path, len(about["observation"]), len(joints))
    for _ in range(_COMPARED):
        row = random.normal(size=len(offset))  # of the network's input, in whose units its numbers are near 1
        seen = np.linalg.pinv(matrix) @ (row - offset)
        with np.errstate(over="ignore"):  # of exponents, whose results are not used where they overflow
            wanted = np.clip(back @ foreign(matrix @ seen + offset), -1.0, 1.0)
        worst = float(np.abs(made.act(seen) - wanted).max())
        if worst > _DIFFERENT * max(1.0, float(np.abs(wanted).max())):
            raise Refused(f"{told.path}: network: the network that was read differs from the file's by {worst:.2g}; "
                          "export it as ONNX with one input and one output")  # fmt: skip


def _write(folder: Path, told: Description, options: dict[str, Any], onnx: bytes) -> None:
    (folder / "policy.onnx").write_bytes(onnx)
    settings = {"task": TASK, "options": options, "imported_from": told.source or told.network.name}
    (folder / "settings.json").write_text(json.dumps(settings, indent=1), encoding="utf-8")
