# %% [markdown]
# # Which leg walks best?
#
# The reference hexapod walks on loose poppy seeds, with legs of different knee angles ξ and at different stride
# frequencies. With ξ > 0 the convex side of a leg leads; the L-leg has 45°. Hundreds of walks take seconds. Run this
# file as a script or cell by cell. It needs `sandgait[plot]`.

# %%
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import sandgait

OUT = Path("runs/design_sweep.png")
OUT.parent.mkdir(exist_ok=True)

# %% [markdown]
# ## A map of two parameters

# %%
XI, FREQUENCY = np.arange(-75, 76, 5), np.arange(1.0, 5.01, 0.25)
walks = sandgait.sweep({"xi": XI, "frequency": FREQUENCY})
fastest = walks.best()
cheapest = walks.best("cost-of-transport")
print(f"{len(walks.speed)} walks")
for word, best in (("fastest", fastest), ("cheapest", cheapest)):
    print(f"{word}: ξ = {best['xi']:.0f}° at {best['frequency']:.2f} Hz: ", end="")
    print(f"{100 * best['speed']:.1f} cm/s at a cost of transport of {best['cost_of_transport']:.2f}")

# %% [markdown]
# ## A search
#
# A particle swarm searches for the best knee angle and leg length together, at 2 Hz and between given bounds.

# %%
found = sandgait.sweep({"xi": [0, 75], "chord": [0.03, 0.05]}, optimize="speed").best()
print(f"best at 2 Hz: ξ = {found['xi']:.1f}°, chord {1000 * found['chord']:.1f} mm: {100 * found['speed']:.1f} cm/s")

# %% [markdown]
# ## Is the result the same on other sands?

# %%
MEDIA = ("poppy-loose", "poppy-close", "quikrete-medium")
by_medium = sandgait.sweep({"medium": MEDIA, "xi": np.arange(-75, 76, 5)})

# %%
figure, (speed, cost, sands) = plt.subplots(1, 3, figsize=(14, 4.2), layout="constrained")
by_medium.plot(axes=sands)
for axes, best, title, values in (
    (speed, fastest, "Speed [cm/s]", 100 * walks.speed),
    (cost, cheapest, "Cost of transport", walks.cost_of_transport),
):
    # The last parameter varies fastest. A notebook shows a map like this as `walks`.
    mesh = axes.pcolormesh(FREQUENCY, XI, values.reshape(len(XI), len(FREQUENCY)), shading="nearest")
    figure.colorbar(mesh, ax=axes)
    axes.plot(best["frequency"], best["xi"], "*", color="white", markeredgecolor="black", markersize=13, label="best")
    axes.set(title=title, xlabel="stride frequency [Hz]", ylabel="knee angle ξ [°]", yticks=range(-60, 61, 30))
    axes.legend(loc="lower left")
sands.set(title="Speed at 2 Hz by sand", xlabel="knee angle ξ [°]", xticks=range(-60, 61, 30))
sands.set_ylim(10, 42)
sands.legend(loc="upper left")
sands.grid(alpha=0.3)
figure.savefig(OUT, dpi=120)
print(f"figure: {OUT}")
