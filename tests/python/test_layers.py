"""What each file may know, and that generated files are what their sources make."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from google.protobuf import descriptor_pb2

import sandgait
from sandgait._proto.sandgait.v1 import sandgait_pb2, studies_pb2

PACKAGE = Path(sandgait.__file__).parent
ROOT = Path(__file__).parents[2]


def imports(path: Path) -> set[str]:
    """First names of all absolute imports, wherever they stand in the file."""
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
        ("grpc", {"client.py"}),
        ("google", {"client.py"}),
        ("stable_baselines3", {"sb3.py", "export.py"}),
        ("ray", {"ray.py"}),
        ("torch", {"export.py"}),
        ("pandas", set()),
        ("matplotlib", set()),
        ("pygame", {"view.py"}),
    ],
)
def test_one_file_imports(module: str, where: set[str]) -> None:
    assert {path.name for path in PACKAGE.glob("*.py") if module in imports(path)} == where


@pytest.mark.parametrize("messages", [sandgait_pb2, studies_pb2])
def test_the_messages_are_those_of_the_proto(messages: Any, tmp_path: Path) -> None:
    """Compares descriptors, which do not depend on the generator's version; `make proto` mends it."""
    output = tmp_path / "set.binpb"
    proto = messages.DESCRIPTOR.name
    arguments = [f"--proto_path={ROOT}/proto", f"--descriptor_set_out={output}", proto]
    subprocess.run([sys.executable, "-m", "grpc_tools.protoc", *arguments], check=True)
    made = descriptor_pb2.FileDescriptorSet.FromString(output.read_bytes()).file[0]
    for field in (field for message in made.message_type for field in message.field):
        field.ClearField("json_name")  # derived, and not in what the generator embeds
    assert made == descriptor_pb2.FileDescriptorProto.FromString(messages.DESCRIPTOR.serialized_pb)


def test_the_package_is_typed() -> None:
    assert (PACKAGE / "py.typed").exists()
