"""Modules that only certain files of the package may import."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import sandgait

PACKAGE = Path(sandgait.__file__).parent


def imports(path: Path) -> set[str]:
    """Top-level names of all absolute imports in the file."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            names.add(str(node.module).split(".")[0])
    return names


@pytest.mark.parametrize(
    ("module", "where"),
    [
        ("grpc", set()),
        ("google", set()),
        ("stable_baselines3", {"sb3.py", "export.py", "from_rust.py"}),
        ("ray", {"ray.py"}),
        ("torch", {"export.py", "from_rust.py", "identified.py", "sb3.py"}),
        ("pandas", set()),
        ("pyarrow", {"logs_reader.py"}),
        ("mcap", {"logs_ros.py"}),
        ("rosbags", {"logs_ros.py"}),
        ("matplotlib", set()),
        ("mujoco", {"mujoco.py", "mujoco_floor.py", "plant.py", "wrappers.py"}),
        ("pygame", {"view.py"}),
    ],
)
def test_one_file_imports(module: str, where: set[str]) -> None:
    assert {path.name for path in PACKAGE.glob("*.py") if module in imports(path)} == where


def test_the_package_is_typed() -> None:
    assert (PACKAGE / "py.typed").exists()
