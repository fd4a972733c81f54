"""Foreign policies: the kept policy of sandcat, rewritten as legged_gym or Isaac Lab would have it, acts as before."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
import torch
from onnx import helper, numpy_helper

from sandgait.certify.walk import Job, outcome
from sandgait.foreign import import_policy
from sandgait.foreign.__main__ import main
from sandgait.plant import Conditions
from sandgait_deploy import Controller, Refused, read_policy
from sandgait_deploy.golden import read_trace
from sandgait_deploy.network import Network
from sandgait_deploy.observer import Observer

ROOT = Path(__file__).parents[2]
CAT = ROOT / "examples/policies/LeggedVelocity-sandcat"
ROBOT = ROOT / "robots/sandcat.xml"

#: The joints as Isaac Lab has them: by kind.
BY_KIND = [3 * leg + kind for kind in range(3) for leg in range(4)]
#: Terms of legged_gym with its scales.
SCALES = {
    "base_lin_vel": 2.0,
    "base_ang_vel": 0.25,
    "projected_gravity": 1.0,
    "commands": [2.0, 2.0, 0.25],
    "dof_pos": 1.0,
    "dof_vel": 0.05,
    "actions": 1.0,
}


def described(folder: Path, network: str = "policy.onnx", **changed: Any) -> Path:
    """The TOML file of a foreign policy of sandcat."""
    servos = [read_policy(CAT).servos[k] for k in BY_KIND]
    terms = changed.pop("terms", [{"term": name, "scale": scale} for name, scale in SCALES.items()])
    told = {
        "network": network,
        "robot": str(ROBOT),
        "control_period": 0.02,
        "joints": {
            "names": [servo.joint for servo in servos],
            "default": [servo.default for servo in servos],
            "kp": [servo.stiffness for servo in servos],
            "kd": [servo.damping for servo in servos],
        },
        "action": {"scale": 0.25},
        **changed,
    }
    text = "".join(f"{key} = {json.dumps(value)}\n" for key, value in told.items() if not isinstance(value, dict))
    for table, keys in told.items():
        if isinstance(keys, dict):
            text += f"[{table}]\n" + "".join(f"{key} = {json.dumps(value)}\n" for key, value in keys.items())
    for term in terms:
        text += "[[observation]]\n" + "".join(f"{key} = {json.dumps(value)}\n" for key, value in term.items())
    path = folder / "foreign.toml"
    path.write_text(text)
    return path


def of_layers(path: Path, layers: list[tuple[Any, Any, str]], separate: bool = False) -> None:
    """Writes dense layers as an exporter does: weights [outputs, inputs], functions as nodes. `separate`: numbers in
    another file."""
    nodes, numbers, x = [], [], "obs"
    for k, (weights, bias, kind) in enumerate(layers):
        numbers += [
            numpy_helper.from_array(np.asarray(n, np.float32), f"{w}{k}") for w, n in (("w", weights), ("b", bias))
        ]
        nodes.append(helper.make_node("Gemm", [x, f"w{k}", f"b{k}"], [f"h{k}"], transB=1))
        x = f"h{k}"
        if kind == "Swish":
            nodes += [helper.make_node("Sigmoid", [x], [f"s{k}"]), helper.make_node("Mul", [x, f"s{k}"], [f"y{k}"])]
        elif kind:
            nodes.append(helper.make_node(kind, [x], [f"y{k}"]))
        x = f"y{k}" if kind else x
    info = [helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, [1, size])
            for name, size in (("obs", np.shape(layers[0][0])[1]), (x, np.shape(layers[-1][0])[0]))]  # fmt: skip
    graph = helper.make_graph(nodes, "foreign", info[:1], info[1:], numbers)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=10)
    onnx.save(model, path, save_as_external_data=separate, location=f"{path.name}.data", size_threshold=0)


def random_layers(width: int, kind: str = "Elu", seed: int = 0) -> list[tuple[Any, Any, str]]:
    random = np.random.default_rng(seed)
    sizes = [width, 16, 12]
    return [
        (random.normal(scale=a**-0.5, size=(b, a)), random.normal(scale=0.1, size=b), function)
        for a, b, function in zip(sizes, sizes[1:], (kind, ""), strict=False)
    ]


def cat_as_foreign(folder: Path) -> Path:
    """The kept network behind a layer that undoes the foreign layout, and before one that makes the foreign action."""
    policy = read_policy(CAT)
    width = len(policy.observation)
    # From the foreign observation to ours: divided by the scales, the joints back in our order.
    back, offset = np.zeros((width, width)), np.zeros(width)
    ours = {name: k for k, name in enumerate(("base_lin_vel", "base_ang_vel", "projected_gravity", "commands"))}
    scales = np.array([servo.scale for servo in policy.servos])
    for term, (name, scale) in enumerate(SCALES.items()):
        if name in ours:
            for k in range(3):
                back[3 * ours[name] + k, 3 * term + k] = 1.0 / (scale[k] if isinstance(scale, list) else float(scale))
            continue
        first = 12 + 12 * (list(SCALES).index(name) - 4)
        for place, joint in enumerate(BY_KIND):
            factor = 1.0 / float(scale)  # type: ignore[arg-type]
            back[first + joint, first + place] = factor * (0.25 / scales[joint] if name == "actions" else 1.0)
    out = np.zeros((12, 12))
    for place, joint in enumerate(BY_KIND):
        out[place, joint] = scales[joint] / 0.25
    model = onnx.load(CAT / "policy.onnx")
    graph = model.graph
    (name_in, name_out), first = (graph.input[0].name, graph.output[0].name), "foreign"
    graph.initializer.extend(numpy_helper.from_array(n.astype(np.float32), name) for name, n in
                             (("back", back.T.copy()), ("offset", offset), ("out", out.T.copy())))  # fmt: skip
    graph.node.insert(0, helper.make_node("Gemm", [first, "back", "offset"], [name_in]))
    graph.node.append(helper.make_node("MatMul", [name_out, "out"], ["foreign_action"]))
    graph.input[0].name, graph.output[0].name = first, "foreign_action"
    onnx.save(model, folder / "policy.onnx")
    # The bounds of its actions, so that its last action is what it was.
    return described(folder, action={"scale": 0.25, "clip": float(scales.max() / 0.25)})


def test_a_kept_policy_in_foreign_form_acts_as_before(tmp_path: Path) -> None:
    made = import_policy(cat_as_foreign(tmp_path), tmp_path / "made")
    controller, own = Controller(made), read_policy(CAT)
    verified = controller.verify()
    assert all(boundary.identical for boundary in verified.boundaries), str(verified)
    trace = read_trace(own)
    seen = np.array([trace[f"obs:{k}"] for k in range(len(own.observation))]).T
    acted = np.array([trace[f"action:{k}"] for k in range(12)]).T
    scales = np.array([servo.scale for servo in own.servos])
    ratio = scales / np.array([servo.scale for servo in controller.policy.servos])
    for row, action in zip(seen, acted, strict=True):
        row[36:] *= ratio  # the last action, in the units of the made policy
        assert controller.act(row) == pytest.approx(action * ratio, abs=1e-5)


def test_it_walks_in_the_other_engine(tmp_path: Path) -> None:
    made = import_policy(cat_as_foreign(tmp_path), tmp_path / "made")
    walked = outcome(Job(str(made), str(ROBOT), Conditions(), ((0.4, 0.0, 0.0), (0.0, 0.0, 0.8))))
    assert walked.holds, walked.words


@pytest.mark.parametrize("kind", ["Elu", "Relu", "Sigmoid", "Tanh", "Swish"])
def test_functions_of_the_field_are_the_simulator_s_to_the_last_bit(tmp_path: Path, kind: str) -> None:
    of_layers(tmp_path / "policy.onnx", random_layers(48, kind), separate=kind == "Elu")
    verified = Controller(import_policy(described(tmp_path), tmp_path / "made")).verify()
    assert all(boundary.identical for boundary in verified.boundaries), str(verified)


@pytest.mark.parametrize("by", ["term", "step"])
@pytest.mark.parametrize("first", ["oldest", "newest"])
def test_histories_are_stacked_as_the_field_does(tmp_path: Path, by: str, first: str) -> None:
    terms = [{"term": "base_ang_vel", "scale": 0.5}, {"term": "joint_pos"}, {"term": "gait_phase", "period": 0.8,
             "parts": ["cos", "-sin"]}, {"term": "last_action"}]  # fmt: skip
    layers = random_layers(3 * (3 + 12 + 2 + 12))
    of_layers(tmp_path / "policy.onnx", layers)
    told = described(tmp_path, terms=terms, history={"length": 3, "by": by, "first": first})
    made = import_policy(told, tmp_path / "made")
    policy = read_policy(made)
    assert set(policy.readings) == {"gyroscope", "joint_position"}
    rows: list[dict[str, np.ndarray]] = []
    random, observer, last = np.random.default_rng(1), Observer(policy), np.zeros(12, np.float32)
    network = Network(policy.network, len(policy.observation), 12)
    scale = np.array([servo.scale for servo in policy.servos])[BY_KIND]
    for step in range(5):
        read = {"gyroscope": random.normal(size=3), "joint_position": random.normal(size=12)}
        phase = 2.0 * np.pi * 0.02 * step / 0.8
        rows.append({
            "base_ang_vel": 0.5 * read["gyroscope"],
            "joint_pos": read["joint_position"][BY_KIND],
            "gait_phase": np.array([np.cos(phase), -np.sin(phase)]),
            "last_action": last[BY_KIND] * scale / 0.25,
        })  # fmt: skip
        action = network.act(observer.observe(read, np.zeros(3), last, 0.02 * step))
        held = [rows[max(0, step - age)] for age in (2, 1, 0)]
        held = held if first == "oldest" else held[::-1]
        names = [term["term"] for term in terms]
        stacked = [row[n] for n in names for row in held] if by == "term" else [row[n] for row in held for n in names]
        wanted = of_numpy(layers)(np.concatenate(stacked)) * 0.25 / scale
        assert action[BY_KIND] == pytest.approx(wanted, abs=1e-5)
        last = action


def of_numpy(layers: list[tuple[Any, Any, str]]) -> Callable[[np.ndarray], np.ndarray]:
    (w0, b0, _), (w1, b1, _) = layers

    def act(x: np.ndarray) -> np.ndarray:
        h = w0 @ x + b0
        return np.asarray(w1 @ np.where(h > 0.0, h, np.expm1(np.minimum(h, 0.0))) + b1)

    return act


class EmpiricalNormalization(torch.nn.Module):
    """As rsl_rl has it."""

    def __init__(self, size: int) -> None:
        super().__init__()
        self.eps = 1e-2
        self.register_buffer("_mean", torch.linspace(-1.0, 1.0, size)[None])
        self.register_buffer("_std", torch.linspace(0.5, 2.0, size)[None])

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return (x - self._mean) / (self._std + self.eps)  # type: ignore[operator]


class Exported(torch.nn.Module):
    """As rsl_rl exports a policy: the layers first, then the normalization, which is computed before them."""

    def __init__(self, normalizer: torch.nn.Module) -> None:
        super().__init__()
        torch.manual_seed(0)
        self.actor = torch.nn.Sequential(torch.nn.Linear(48, 16), torch.nn.ELU(), torch.nn.Linear(16, 12))
        self.normalizer = normalizer

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return self.actor(self.normalizer(x))  # type: ignore[no-any-return]


@pytest.mark.parametrize("normalizer", [torch.nn.Identity(), EmpiricalNormalization(48)], ids=["plain", "normalized"])
def test_torchscript_is_read(tmp_path: Path, normalizer: torch.nn.Module) -> None:
    module = Exported(normalizer)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.jit.script(module).save(tmp_path / "policy.pt")
    policy = read_policy(import_policy(described(tmp_path, "policy.pt"), tmp_path / "made"))
    network = Network(policy.network, 48, 12)
    # Of all readings 0, in the default pose, the foreign observation is 0, too.
    with torch.no_grad():
        wanted = module(torch.zeros(1, 48))[0].numpy() * 0.25 / np.array([s.scale for s in policy.servos])
    assert network.act(np.zeros(48))[BY_KIND] == pytest.approx(wanted, abs=1e-6)


def test_networks_with_memory_are_refused(tmp_path: Path) -> None:
    class Walker(torch.nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.memory = torch.nn.LSTM(48, 12)

        def forward(self, x: torch.Tensor) -> torch.Tensor:
            return self.memory(x)[0]  # type: ignore[no-any-return]

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.jit.script(Walker()).save(tmp_path / "policy.pt")
    with pytest.raises(Refused, match="the layer LSTM; a network with memory is not run"):
        import_policy(described(tmp_path, "policy.pt"), tmp_path / "made")


JOINTS = [read_policy(CAT).servos[k].joint for k in BY_KIND]
POSE = [read_policy(CAT).servos[k].default for k in BY_KIND]


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"network": "none.onnx"}, "none.onnx: there is no such file beside the description"),
        ({"control_period": 0.01}, "control_period: 0.01 s; LeggedVelocity acts every 0.02 s"),
        ({"control_perod": 0.02}, "control_period"),
        ({"action": {"scale": 0.0}}, "action.scale: must be above 0"),
        ({"action": {"scale": [0.25] * 11}}, "action.scale: has 11 numbers, 12 are needed"),
        ({"joints": {"names": JOINTS, "default": 0.0, "kp": 20.0}}, "joints.kd: is missing"),
        ({"joints": {"names": [*JOINTS[:-1], "tail"], "default": 0.0, "kp": 20.0, "kd": 1.0}}, "tail"),
        (
            {
                "joints": {"names": JOINTS[:-1], "default": POSE[:-1], "kp": 20.0, "kd": 1.0},
                "terms": [{"term": "dof_pos"}] * 4
                + [{"term": "base_ang_vel"}, {"term": "gait_phase", "period": 1.0, "parts": ["sin"]}],
            },
            f"only one of policy and robot has {JOINTS[-1]!r}",
        ),
        ({"terms": [{"term": "base_ang_vell"}]}, "base_ang_vel"),
        ({"terms": [{"term": "base_ang_vel"}]}, "the terms have 3 numbers, the network's input 48"),
        ({"terms": [{"term": "base_ang_vel", "period": 1.0}]}, "observation.period: belongs to gait_phase"),
        ({"history": {"length": 2}}, "the terms have 96 numbers, the network's input 48"),
        ({"history": {"by": "joint"}}, "history.by: 'joint' is none of term, step"),
        ({"commands": {"lin_vel_x": [1.0, -1.0]}}, "is no range"),
        ({"options": {"action_scale": 1.0}}, "action_scale follows from the other keys"),
        ({"options": {"dt": -1.0}}, "dt"),
        ({"options": [1]}, "options: must be a table"),
        ({"joints": {"names": "abc"}}, "joints.names: is no list of texts"),
        ({"terms": [{"term": "gait_phase", "period": 1.0, "parts": "sin"}]}, "observation.parts: is no list of texts"),
    ],
)
def test_wrong_descriptions_are_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], changed: dict[str, Any], said: str
) -> None:
    of_layers(tmp_path / "policy.onnx", random_layers(48))
    told = described(tmp_path, **changed)
    assert main([str(told), "--out", str(tmp_path / "made")]) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ")
    assert error.count("\n") == 1
    assert said in error
    assert not (tmp_path / "made").exists()


def test_a_file_that_is_no_network_is_refused(tmp_path: Path) -> None:
    (tmp_path / "policy.onnx").write_bytes(b"\x08" * 40)
    with pytest.raises(Refused, match=r"policy\.onnx cannot be read as ONNX"):
        import_policy(described(tmp_path), tmp_path / "made")


def test_a_robot_on_two_feet_hangs_in_a_gantry_until_it_walks() -> None:
    from sandgait.certify.walk import make_plant

    policy = read_policy(CAT)
    plant = make_plant(policy, ROBOT, Conditions(), seed=0)
    plant.reset({servo.joint: servo.default for servo in policy.servos})
    plant.data.qpos[2] += 0.1
    base, none = plant.data.qpos[:7].copy(), np.zeros(12)
    plant.drive(None, none, none, 0.1, held=True)
    assert (plant.data.qpos[:7] == base).all()
    plant.drive(None, none, none, 0.1)
    assert plant.data.qpos[2] < base[2] - 0.02
