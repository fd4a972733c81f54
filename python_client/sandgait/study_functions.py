"""Studies as functions. `sandgait studies --python` writes this file from the declarations in src/study/."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy.typing as npt

from .arguments import checked
from .results import Diagnosis, Evaluation, Sweep, Walks
from .study_call import Data, FilePath, ProgressOption, StudyCall
from .tables import Table

__all__ = [
    "calibrate",
    "diagnose",
    "evaluate",
    "intrude",
    "reproduce",
    "sweep",
    "validate",
    "walk",
]


@checked
def walk(
    frequency: float | npt.ArrayLike,
    leg: str | None = None,
    engine: str = "lanes",
    medium: str | None = None,
    law: str | None = None,
    sand: FilePath | None = None,
    slope_deg: float = 0.0,
    dt: float | None = None,
    robot: FilePath | bytes = "xplorer",
    record: FilePath | None = None,
    address: str | None = None,
    progress: ProgressOption = True,
    **options: Any,
) -> Walks:
    """Simulate walks with an alternating tripod at constant stride frequencies, and measure speed and work.

    The speed is measured over four strides, after two others. At frequency 0 the robot stands for 10 s, and its sinkage
    and drift are measured. `options` changes the robot and its sand by an option of HexapodGait; the other arguments
    take precedence. The table has a row for each frequency; the numbers of a walk that diverged are blank.

    `frequency`: Turns of the hips in a second [Hz], one or several; with a negative frequency the robot walks backward,
    with 0 it stands.
    `leg`: Shape of the legs: L, revL, C, revC, flat or xi=DEGREES; default: the robot's own.
    `engine`: Engine that integrates the motion.
    `medium`: Sand: a name from `sandgait media`, zeta=VALUE or mu=VALUE,rho=VALUE; default: poppy-loose.
    `law`: Resistive force law: li2013, penetration-drag-1d or agarwal2023; default: li2013.
    `sand`: A sand.toml, for example from a diagnosis, instead of `medium` and `law`.
    `slope_deg`: Slope of the surface [°]; a positive slope rises in the walking direction.
    `dt`: Time step [s]; default: 0.001, with engine rapier 0.0005.
    `robot`: A built-in robot or a FILE.toml.
    `options`: Option of the task, repeatable (`sandgait tasks NAME` lists them). VALUE is a number, a word, or JSON
    such as [0.1,0.6] or {"key": 1}; a number stands for a range of that number, and null for None. Of sand, hardware
    and robot VALUE can be a path.
    `record`: Record the walk in this file, with 100 states in a second, for `sandgait replay`.
    `address`: a running server that computes the study; by default this process computes it. `progress`: shows the
    progress, or a function that gets it. Ctrl-C stops the study.
    """
    call = StudyCall("walk")
    call.numbers("--frequency", "frequency", frequency)
    call.value("--leg", "leg", leg)
    call.value("--engine", "engine", engine)
    call.value("--medium", "medium", medium)
    call.value("--law", "law", law)
    call.file("--sand", "sand", sand)
    call.value("--slope-deg", "slope_deg", slope_deg)
    call.value("--dt", "dt", dt)
    call.file("--robot", "robot", robot)
    call.options("--option", "options", options)
    call.output("--record", "record", record)
    result: Walks = call.run(address, progress)
    return result


@checked
def intrude(
    shape: str | None = None,
    chord: float | None = None,
    width: float | None = None,
    hip_height: float | None = None,
    omega: float | None = None,
    medium: str | None = None,
    law: str | None = None,
    sand: FilePath | None = None,
    body: FilePath | bytes | None = None,
    rows: Data | None = None,
    mu_s: float | None = None,
    plate_size: float | None = None,
    memory: bool = False,
    repose_deg: float | None = None,
    cell: float | None = None,
    surface: FilePath | None = None,
    grain_size: float | None = None,
    address: str | None = None,
    progress: ProgressOption = True,
) -> Any:
    """Compute the forces of sand on a rotating leg, or on any body that moves with constant velocity.

    With `shape` a leg rotates about a hip that is fixed above the sand, as on a robot arm. The table has columns theta
    [rad], Fx, Fz [N] and Ty [N·m] about the hip, for angles from −1.75 to 1.75 rad. At θ = 0 the tip is straight down,
    at positive θ it is forward (+x). Forces are those on the leg.

    With `body` a body moves with constant velocity. Each row of `rows` is one motion: vx, vy, vz [m/s], wx, wy, wz
    [rad/s] (x heading, y axle, z up; 0 if absent), and either depth [m] of the body's lowest point or load [N] that the
    sand carries. The table has Fx, Fy, Fz, Tx, Ty, Tz, depth and status, after the other columns of a file. The status
    is ok, or no_equilibrium if the sand cannot carry the load. If a body that is not round turns, forces are means over
    a turn.

    With `memory` the sand remembers: rows with the same `trial` are one path in time, from level sand on. Each row has
    a time t [s]. x and y [m] are the place of the body's origin; without them the body moves on with the velocities of
    the row above. Depths are below the undisturbed surface.

    `shape`: Shape of the leg: L, revL, C, revC, flat or xi=DEGREES.
    `chord`: Distance from hip to tip [m]; default: 0.076.
    `width`: Width of the leg [m]; default: 0.025.
    `hip_height`: Height of the hip above the surface [m]; default: 0.02.
    `omega`: Angular speed of the leg [rad/s]; with a negative one the tip moves backward; default: 0.2.
    `medium`: Sand: a name from `sandgait media`, zeta=VALUE or mu=VALUE,rho=VALUE; default: poppy-loose.
    `law`: Resistive force law: li2013, penetration-drag-1d or agarwal2023; default: li2013.
    `sand`: A sand.toml, for example from a diagnosis, instead of `medium` and `law`.
    `body`: Body: cylinder:radius=M,width=M (axle along y), box:length=M,width=M,height=M, sphere:radius=M, FILE.stl or
    FILE.obj [metres].
    `rows`: Motions of the body, one in each row.
    `mu_s`: Friction coefficient μ_s of the body's surface, instead of the sand's friction_clip.
    `plate_size`: Size of the plates into which the surface is cut [m]; default: a fiftieth of the body's longest side.
    `memory`: Sand that was moved stays moved: paths in time, with heaps, furrows and prints (docs/memory.md).
    `repose_deg`: Angle of repose of the sand [°]; default: 25 for glass beads, 28 for other media.
    `cell`: Side of a cell of the surface [m]; default: a tenth of the body's longest horizontal side.
    `surface`: File for the surface after each trial: trial, x, y and height of the cells that were moved (CSV).
    `grain_size`: Diameter of the grains [m], for the passing part of sliding_face.
    `address`: a running server that computes the study; by default this process computes it. `progress`: shows the
    progress, or a function that gets it. Ctrl-C stops the study.
    """
    call = StudyCall("intrude")
    call.value("--shape", "shape", shape)
    call.value("--chord", "chord", chord)
    call.value("--width", "width", width)
    call.value("--hip-height", "hip_height", hip_height)
    call.value("--omega", "omega", omega)
    call.value("--medium", "medium", medium)
    call.value("--law", "law", law)
    call.file("--sand", "sand", sand)
    call.file("--body", "body", body)
    call.data("--trials", "rows", rows)
    call.value("--mu-s", "mu_s", mu_s)
    call.value("--plate-size", "plate_size", plate_size)
    call.flag("--memory", "memory", memory)
    call.value("--repose-deg", "repose_deg", repose_deg)
    call.value("--cell", "cell", cell)
    call.output("--surface", "surface", surface)
    call.value("--grain-size", "grain_size", grain_size)
    result: Any = call.run(address, progress)
    return result


@checked
def sweep(
    vary: Mapping[str, Any],
    set: Mapping[str, Any] | None = None,
    robot: FilePath | bytes = "xplorer",
    frequency: float | None = None,
    medium: str | None = None,
    law: str | None = None,
    sand: FilePath | None = None,
    measure: str = "speed",
    optimize: str | None = None,
    address: str | None = None,
    progress: ProgressOption = True,
) -> Sweep:
    """Study a design: simulate walks of a robot over a grid of one or two parameters, or search for the best design.

    The table has a row for each design, first the varied parameters and then the columns of a walk; the last parameter
    varies fastest. A search gives one row. A grid also has a figure, a heat map for two parameters or a line for one. A
    parameter is varied with NAME=FIRST:LAST:COUNT or NAME=VALUE,VALUE,… and fixed with `set` NAME=VALUE. Names: xi [°],
    leg, chord [m], width [m], leg-mass [kg], base-mass [kg], hip-height [m], belly [m], frequency [Hz], phase [rad],
    medium, zeta [N/cm³], law, slope [°], payload [kg], torque-limit [N·m], kp [N·m/rad].

    `vary`: Parameters and their values, one or two.
    `set`: Parameters with one value.
    `robot`: Built-in robot or FILE.toml, with one joint in each leg.
    `frequency`: Stride frequency [Hz]; default: 2.
    `medium`: Sand: a name from `sandgait media`, zeta=VALUE or mu=VALUE,rho=VALUE; default: poppy-loose.
    `law`: Resistive force law: li2013, penetration-drag-1d or agarwal2023; default: li2013.
    `sand`: A sand.toml, for example from a diagnosis, instead of `medium` and `law`.
    `measure`: Measure of the figure and of the best design: speed or cost-of-transport.
    `optimize`: Search for the best design between the least and the greatest value of each parameter instead of
    simulating the grid, by speed or cost-of-transport.
    `address`: a running server that computes the study; by default this process computes it. `progress`: shows the
    progress, or a function that gets it. Ctrl-C stops the study.
    """
    call = StudyCall("sweep")
    call.settings("--vary", "vary", vary)
    call.settings("--set", "set", set)
    call.file("--robot", "robot", robot)
    call.value("--frequency", "frequency", frequency)
    call.value("--medium", "medium", medium)
    call.value("--law", "law", law)
    call.file("--sand", "sand", sand)
    call.value("--measure", "measure", measure)
    call.value("--optimize", "optimize", optimize)
    result: Sweep = call.run(address, progress)
    return result


@checked
def evaluate(
    policy: FilePath | bytes,
    task: str | None = None,
    seeds: int | None = None,
    media: Iterable[str] | None = None,
    slopes: float | npt.ArrayLike | None = None,
    strengths: float | npt.ArrayLike | None = None,
    commands: bool = False,
    address: str | None = None,
    progress: ProgressOption = True,
    **options: Any,
) -> Evaluation:
    """Evaluate a gait: returns, speeds, costs and falls over seeds that no training uses, for each medium and slope.

    POLICY is an ONNX file (`sandgait train` and sandgait.export_onnx write one) or a fixed gait. Task and options of a
    policy are those in settings.json beside it, where `task` and `options` say nothing. With tripod:HZ every hip turns
    at this rate. tripod has the best rate, searched on other seeds than those of the evaluation. clock:FILE.json and
    clock:N,N,… repeat one action of control="clock". standing and random are for comparison. docs/evaluate.md defines
    every figure.

    A policy of LeggedVelocity follows commands. How well it follows them is measured for nine commands, half or nearly
    all of the ranges of its training, without randomness. With `media`, `slopes` or `strengths` the table has a line
    for each ground, and the CSV one for each command on it.

    `policy`: Gait: the folder of a training or FILE.onnx, tripod[:HZ], clock:FILE.json, clock:N,N,…, standing or
    random.
    `task`: Name or id of the task [default: the policy's, or HexapodGait].
    `options`: Option of the task, repeatable (`sandgait tasks NAME` lists them). VALUE is a number, a word, or JSON
    such as [0.1,0.6] or {"key": 1}; a number stands for a range of that number, and null for None. Of sand, hardware
    and robot VALUE can be a path.
    `seeds`: Number of episodes; their seeds begin at 1,000,000 [default: 100], in [2, 100000].
    `media`: Media, instead of the medium in the options; of LeggedVelocity grounds, such as rigid.
    `slopes`: Slopes [°], instead of the slope in the options.
    `strengths`: Factors on the sand's stress, of LeggedVelocity.
    `commands`: How well a policy of LeggedVelocity follows commands; its folder says so already.
    `address`: a running server that computes the study; by default this process computes it. `progress`: shows the
    progress, or a function that gets it. Ctrl-C stops the study.
    """
    call = StudyCall("evaluate")
    call.file("", "policy", policy)
    call.value("--task", "task", task)
    call.options("--option", "options", options)
    call.value("--seeds", "seeds", seeds)
    call.names("--media", "media", media)
    call.numbers("--slopes", "slopes", slopes)
    call.numbers("--strengths", "strengths", strengths)
    call.flag("--commands", "commands", commands)
    result: Evaluation = call.run(address, progress)
    return result


@checked
def diagnose(
    data: Any,
    experiment: FilePath | Mapping[str, Any],
    address: str | None = None,
    progress: ProgressOption = True,
) -> Diagnosis:
    """Find where the simulation disagrees with measured data, name the cause, extend the model and measure the gain.

    The files are report.json, report.html, sand.toml and hardware.toml. The table "curves" has a row for each sample:
    trial, condition, shape and progress (angle [rad] or position along the path [m]). Each measured channel C has four
    columns: C, the predictions C_plain and C_extended of the two models, and C_sd, the standard deviation of one
    repetition.

    `data`: Measured data as CSV; `python -m sandgait.logs` converts Parquet, LeRobot data sets, MCAP and ROS bags.
    `experiment`: Facts that the data file does not contain: medium, shapes, units (TOML).
    `address`: a running server that computes the study; by default this process computes it. `progress`: shows the
    progress, or a function that gets it. Ctrl-C stops the study.
    """
    call = StudyCall("diagnose")
    call.measured("", "data", data)
    call.tables("--experiment", "experiment", experiment)
    result: Diagnosis = call.run(address, progress)
    return result


@checked
def calibrate(
    data: FilePath | Iterable[FilePath],
    area: float | None = None,
    depth_unit: str | None = None,
    force_unit: str | None = None,
    out: FilePath | None = None,
    plot: FilePath | None = None,
    compliance: float | None = None,
    address: str | None = None,
    progress: ProgressOption = True,
) -> Table:
    """Measure the scale ζ of your sand with slow vertical penetrations of a horizontal plate.

    A file has columns depth (downward from the surface) and force (upward on the plate): a log, or ten readings by
    hand. They are recorded on the way down at less than 0.5 m/s. The header has the units, for example "depth
    [mm],force [N]", or the options have them; without either they are m and N. Prints ζ, for --medium zeta=VALUE of
    every command, and ξ_n of agarwal2023, with 95 % confidence intervals. With `out` it writes a sand.toml.

    Three or more pushes in beds that were prepared anew are better than one: only then does the interval contain the
    scatter between pushes. Give one file for each push, or one file with a column trial. Pushes of several sizes
    (column diameter, or length and width) show how the resistance grows with size. Prints the law of depth and size
    that fits, its errors for a push and for a size that its fit did not use, the repeatability of pushes, the
    compliance of the rig, and the limits of the calibration.

    `data`: CSV with columns depth and force; of several files each is one push.
    `area`: Area of the plate [m²]; default: 3.8 × 2.5 cm, the plate of Li et al. 2012.
    `depth_unit`: Unit of the depths: m, cm, mm or in.
    `force_unit`: Unit of the forces: N, mN, kN, gf, kgf or lbf.
    `out`: Write the sand to this file, for --sand of other commands and option sand of the tasks.
    `plot`: Draw the test and the fitted line to this SVG file.
    `compliance`: Compliance of the rig for several pushes [m/N]; default: it is fitted.
    `address`: a running server that computes the study; by default this process computes it. `progress`: shows the
    progress, or a function that gets it. Ctrl-C stops the study.
    """
    call = StudyCall("calibrate")
    call.files("", "data", data)
    call.value("--area", "area", area)
    call.value("--depth-unit", "depth_unit", depth_unit)
    call.value("--force-unit", "force_unit", force_unit)
    call.output("--out", "out", out)
    call.output("--plot", "plot", plot)
    call.value("--compliance", "compliance", compliance)
    result: Table = call.run(address, progress)
    return result


@checked
def reproduce(
    figure: int | None = None,
    address: str | None = None,
    progress: ProgressOption = True,
) -> Table:
    """Reproduce Li, Zhang & Goldman 2012: figures 2 to 5, and every claim with a number.

    The table has each claim with the paper's value, ours, a verdict (reproduced, not_reproduced or no_data) and its
    reason. The files are the figures as SVG, report.html and claims.json.

    `figure`: Make only this figure: 2, 3, 4 or 5.
    `address`: a running server that computes the study; by default this process computes it. `progress`: shows the
    progress, or a function that gets it. Ctrl-C stops the study.
    """
    call = StudyCall("reproduce")
    call.value("--figure", "figure", figure)
    result: Table = call.run(address, progress)
    return result


@checked
def validate(
    data: FilePath | None = None,
    address: str | None = None,
    progress: ProgressOption = True,
) -> Table:
    """Compare the model with measurements, and print the errors of its predictions.

    Without `data` the references are: two wheels and three discs in dry sand, measured at Carnegie Mellon University;
    legs in simulated grains; walks of independent programs; and robots in pinocchio and MuJoCo. The table has each
    measured row with its predictions, in each comparison.

    `data`: Folder with a validation.toml and the files of rows that it names.
    `address`: a running server that computes the study; by default this process computes it. `progress`: shows the
    progress, or a function that gets it. Ctrl-C stops the study.
    """
    call = StudyCall("validate")
    call.file("--data", "data", data)
    result: Table = call.run(address, progress)
    return result
