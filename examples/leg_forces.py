# %% [markdown]
# # Forces on a leg that rotates through sand
#
# A leg turns about a hip that is fixed 2 cm above the sand, as in the experiments of Li et al. 2012, section 3. How do
# the leg's shape and the sand change lift and drag? Run this file as a script or cell by cell. It needs
# `sandgait[plot]`.

# %%
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import sandgait

OUT = Path("runs/leg_forces.png")
OUT.parent.mkdir(exist_ok=True)

# %% [markdown]
# ## Shapes
#
# When a robot walks forward, the convex side of an L- or C-leg leads. With reversed legs the concave side leads.

# %%
SHAPES = {"L": "L", "revL": "reversed L", "C": "C", "revC": "reversed C", "flat": "flat"}
by_shape = {name: sandgait.intrude(shape) for shape, name in SHAPES.items()}

for name, forces in by_shape.items():
    k = np.argmax(forces.Fz)
    print(f"{name:<11} lifts {forces.Fz[k]:4.1f} N at {np.degrees(forces.theta[k]):4.0f}°, ", end="")
    print(f"drags {-forces.Fx.min():4.1f} N, torque up to {np.abs(forces.Ty).max():.2f} N·m")

# %% [markdown]
# ## Sands
#
# The same L-leg rotates in different sands whose stiffness is published. The results are also a pandas DataFrame.

# %%
MEDIA = ("poppy-loose", "poppy-close", "glass-beads", "plastic-pellets")
by_medium = {medium: sandgait.intrude("L", medium=medium) for medium in MEDIA}
print(by_medium["poppy-loose"].to_frame().describe().round(3))

# %%
figure, (lift, drag, sands) = plt.subplots(1, 3, figsize=(13, 4.2), layout="constrained")
for name, forces in by_shape.items():
    style = "--" if name.startswith("reversed") else "-"
    color = {"L": "C0", "C": "C1", "t": "0.3"}[name[-1]]
    degrees = np.degrees(forces.theta)
    lift.plot(degrees, forces.Fz, style, color=color, label=name)
    drag.plot(degrees, -forces.Fx, style, color=color, label=name)
for medium, forces in by_medium.items():
    sands.plot(np.degrees(forces.theta), forces.Fz, label=medium)
lift.set(title="Lift by shape, poppy-loose", ylabel="lift Fz [N]")
drag.set(title="Drag by shape, poppy-loose", ylabel="drag −Fx [N]")
sands.set(title="Lift on the L-leg by sand", ylabel="lift Fz [N]")
for axes in (lift, drag, sands):
    axes.set_xlabel("leg angle θ [°], 0: tip straight down")
    axes.set_xticks(range(-90, 91, 30))
    axes.axhline(0.0, color="0.7", linewidth=0.8, zorder=0)
    axes.grid(alpha=0.3)
lift.legend()
sands.legend()
figure.savefig(OUT, dpi=120)
print(f"figure: {OUT}")
