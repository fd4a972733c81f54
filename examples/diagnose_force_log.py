# %% [markdown]
# # What does the simulation get wrong about my data?
#
# A force log says where plain resistive force theory errs. The diagnosis names the cause, extends the sand, and says
# what the extension is worth on conditions held out. Then the robot walks on the extended sand. Run as a script or cell
# by cell; needs `sandgait[plot]`.

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
# One row a sample, SI units; repetitions of a condition tell noise from misfit. The log comes from a paper laboratory,
# so its truth is known: one effect beyond plain theory, `inertial_drag` = 0.393.

# %%
log = pd.read_csv(DATA / "force_log.csv", dtype={"trial": str, "condition": str})
print(log.groupby("shape").agg(trials=("trial", "nunique"), slowest=("omega", "min"), fastest=("omega", "max")))

# %% [markdown]
# ## The diagnosis

# %%
diagnosis = sandgait.diagnose(log, DATA / "force_log.toml")
print(diagnosis.verdict, "-", diagnosis.summary)
for cause in diagnosis.causes:
    low, high = cause["ci95"]
    print(f"{cause['id']}: {cause['value']:.3f}, 95 % interval {low:.3f} to {high:.3f}")
gain = diagnosis.report["gain"]
print(f"error on held-out conditions: {gain['held_out_rmse_plain']:.3f} N plain, ", end="")
print(f"{gain['held_out_rmse_extended']:.3f} N extended; repetitions scatter by {gain['noise_floor']:.3f} N")

# %%
diagnosis.save(OUT)  # report.html is the whole record, with figures; sand.toml is what simulations load
diagnosis.plot().savefig(OUT / "curves.png", dpi=120)

# %% [markdown]
# ## What it means for a walk
#
# Every study and every environment takes the sand that the diagnosis saved.

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
