# %% [markdown]
# # What does the simulation get wrong about my data?
#
# A force log shows where plain resistive force theory is wrong. The diagnosis names the cause, extends the sand, and
# measures the gain of the extended sand on held-out conditions. Then the robot walks on the extended sand. Run this
# file as a script or cell by cell. It needs `sandgait[plot]`.

# %%
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

import sandgait

DATA = Path("examples/data")
OUT = Path("runs/diagnose_force_log")
OUT.mkdir(parents=True, exist_ok=True)

# %% [markdown]
# ## The data
#
# The log has one row for each sample, in SI units. Repetitions of a condition show which errors are noise. The log is
# simulated, so its true cause is known: `inertial_drag` = 0.393.

# %%
log = pd.read_csv(DATA / "force_log.csv", dtype={"trial": str, "condition": str})
print(log.groupby("shape").agg(trials=("trial", "nunique"), slowest=("omega", "min"), fastest=("omega", "max")))

# %% [markdown]
# ## The diagnosis

# %%
diagnosis = sandgait.diagnose(log, DATA / "force_log.toml")
print(diagnosis.verdict, "-", diagnosis.headline)
for cause in diagnosis.causes:
    low, high = cause["ci95"]
    print(f"{cause['id']}: {cause['value']:.3f}, 95 % interval {low:.3f} to {high:.3f}")
gain = diagnosis.report["gain"]["in_units"]
errors = [f"{gain[key]:.3f} {gain['unit']}" for key in ("plain", "extended", "noise_floor")]
print("error on held-out conditions: {} plain, {} extended; repetitions scatter by {}".format(*errors))

# %%
diagnosis.save(OUT)  # writes the report with figures (report.html) and the extended sand for simulations (sand.toml)
diagnosis.plot().savefig(OUT / "curves.png", dpi=120)

# %% [markdown]
# ## The effect on a walk
#
# The file sand.toml of the diagnosis is an option of every study and of every environment.

# %%
frequency = np.arange(1.0, 5.01, 0.5)
figure, axes = plt.subplots(figsize=(6.4, 4.2), layout="constrained")
for color, leg, name in (("C0", "L", "L-legs"), ("C1", "revL", "reversed L-legs")):
    plain = sandgait.walk(frequency, leg=leg)
    extended = sandgait.walk(frequency, leg=leg, sand=OUT / "sand.toml")
    axes.plot(frequency, 100 * plain.speed, "--", color=color, label=f"{name}, plain theory")
    axes.plot(frequency, 100 * extended.speed, "-", color=color, label=f"{name}, as diagnosed")
axes.set(xlabel="stride frequency [Hz]", ylabel="forward speed [cm/s]", title="Walking on the diagnosed sand")
axes.grid(alpha=0.3)
axes.legend()
figure.savefig(OUT / "walks.png", dpi=120)
print(f"figures and report: {OUT}")
