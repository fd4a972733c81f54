"""Policies of legged_gym, Isaac Lab, mjlab, MuJoCo Playground, unitree_rl_gym and rsl_rl here: `import_policy` makes of
an ONNX or TorchScript file, and a TOML file that describes it, a folder as `sandgait train` leaves one.

    python -m sandgait.foreign g1.toml --out runs/g1
    sandgait certify g1.toml --quick

docs/foreign_policies.md has the TOML file's keys. Needs `sandgait[deploy]`.
"""

from __future__ import annotations

from pathlib import Path

from sandgait_deploy import Refused

from .description import Description, Term, read_description

__all__ = ["Description", "Term", "import_policy", "read_description"]


def import_policy(description: str | Path, folder: str | Path) -> Path:
    """Writes the foreign policy of the TOML file `description` into the new `folder`, as `sandgait train` writes one:
    settings.json, policy.onnx, policy.json and golden.csv. Then `sandgait certify`, `evaluate`, `play` and the
    Controller run it. Returns the folder.

    Raises Refused with one line if the description, the network or the robot cannot be used; then nothing is written.
    """
    try:
        from .making import make_policy
    except ImportError as error:
        raise Refused(f"{error.name} is not installed: pip install 'sandgait[deploy]'") from None
    return make_policy(Path(description), Path(folder))
