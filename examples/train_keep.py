"""Copies the results of trainings with several seeds into the repository.

    python examples/train_keep.py runs/legs-0 runs/legs-1 runs/legs-2

The folder examples/policies/TASK-ALGORITHM/ gets the first run's policy (policy.onnx) and settings, and the curves and
scores of all runs. curve.png shows all curves. tests/python/test_kept_policies.py evaluates the policy again.
"""

from __future__ import annotations

import argparse
import json
import shutil
from pathlib import Path

from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize
from train_curves import draw
from training import ALGORITHMS, task_id

import sandgait

POLICIES = Path(__file__).parent / "policies"


def main() -> None:
    parser = argparse.ArgumentParser(description=str(__doc__).split("\n\n", maxsplit=1)[0])
    parser.add_argument("runs", type=Path, nargs="+", help="output directories of train.py, one for each seed")
    arguments = parser.parse_args()
    all_settings = [json.loads((run / "settings.json").read_text()) for run in arguments.runs]
    settings = all_settings[0]
    name = f"{settings['task']}-{settings['algorithm']}"
    folder = POLICIES / name
    folder.mkdir(parents=True, exist_ok=True)
    model = ALGORITHMS[settings["algorithm"]].load(arguments.runs[0] / "policy.zip", device="cpu")
    single = DummyVecEnv([lambda: sandgait.SandgaitEnv(task_id(settings["task"]), **settings["options"])])
    normalized = VecNormalize.load(str(arguments.runs[0] / "normalize.pkl"), single)
    sandgait.export_onnx(model, folder / "policy.onnx", normalized)
    single.close()
    seeds = {str(one["seed"]): one["score"] for one in all_settings}
    (folder / "settings.json").write_text(json.dumps({**settings, "seeds": seeds}, indent=2) + "\n")
    curves = [folder / f"curve-{one['seed']}.csv" for one in all_settings]
    for run, curve in zip(arguments.runs, curves, strict=True):
        shutil.copy(run / "curve.csv", curve)
    draw(curves, folder / "curve.png", name)
    print(f"kept in {folder}/")


if __name__ == "__main__":
    main()
