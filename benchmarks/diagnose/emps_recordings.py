"""The recordings of the real EMPS axis as folders of rollouts, and the gap that the simulator has to them.

Run: python -m benchmarks.diagnose.emps_recordings --data ../shared/data/emps --out FOLDER

Each file of 24.8 s becomes twelve rollouts of 2 s, FOLDER/friction from DATA_EMPS.mat and FOLDER/pulses from
DATA_EMPS_PULSES.mat, in the form that ``log:FOLDER/friction`` reads, for specs/emps_recorded.stl. The simulator of
the same tests is ``emps:reference=DATA_EMPS.mat``. What is written comes from a data set without a licence of its own:
it stays out of the repository.

Printed is the mean and the largest |rho_real - rho_sim| over the twelve, for the frictionless axis and for one with
the friction that the machine's authors document.
"""

from __future__ import annotations

import argparse
import csv
import sys
from pathlib import Path

import numpy as np

import s2r_spec as s2r
from s2r_emps import EmpsBackend
from s2r_emps.physics import GAIN
from s2r_spec import logs
from s2r_spec.trace import Trace

SPEC = Path(__file__).parents[2] / "specs" / "emps_recorded.stl"
FILES = {"friction": "DATA_EMPS.mat", "pulses": "DATA_EMPS_PULSES.mat"}
SECONDS, RATE = 2.0, 1000
DOCUMENTED = {"viscous": {"coefficient": 203.5}, "coulomb": {"force": 20.4}, "offset": {"force": -3.2}}
"""Janot, Gautier, Brunot 2019."""

Recorded = list[tuple[dict[str, float], Trace]]


def segments(path: Path) -> Recorded:
    """Return ({"start": s}, trace) of every whole segment of a recording, with the channels of ``emps``.

    The speed is the difference of two positions, as the drive forms it; the first of
    the record is taken to be the second.
    """
    from scipy.io import loadmat

    data = {name: np.ravel(value) for name, value in loadmat(path).items() if not name.startswith("__")}
    q, ticks = data["qm"].astype(np.float64), round(SECONDS * RATE)
    speed = np.diff(q) * RATE
    channels = {
        "q_ref": data["qg"],
        "q": q,
        "v": np.concatenate((speed[:1], speed)),
        "u": data["vir"],
        "force": GAIN * data["vir"],
    }
    units = {channel.name: channel.unit for channel in EmpsBackend().channels}
    return [
        (
            {"start": first / RATE},
            Trace(
                np.arange(ticks + 1) / RATE,
                {name: values[first : first + ticks + 1] for name, values in channels.items()},
                units,
                {"source": path.name},
            ),
        )
        for first in range(0, q.size - ticks, ticks)
    ]


def write(recorded: Recorded, folder: Path) -> None:
    """Write a folder of rollouts."""
    folder.mkdir(parents=True)
    with (folder / "rollouts.csv").open("w", newline="") as stream:
        table = csv.writer(stream, lineterminator="\n")
        table.writerow(["id", "start [s]"])
        for params, trace in recorded:
            name = f"from-{params['start']:04.1f}"
            logs.write(trace, folder / f"{name}.npz")
            table.writerow([name, params["start"]])


def gaps(recorded: Recorded, axis: EmpsBackend, seeds: int = 3) -> np.ndarray:
    """Return (recordings,) of rho_real - mean rho_sim [m]."""
    spec = s2r.load_spec(SPEC)

    def rho(trace: Trace, params: dict[str, float]) -> float:
        return spec.robustness(trace, params)["tracks"]

    return np.array(
        [
            rho(trace, params) - np.mean([rho(axis.rollout(params, seed), params) for seed in range(seeds)])
            for params, trace in recorded
        ]
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--data", type=Path, required=True, help="folder of the two .mat files")
    parser.add_argument("--out", type=Path, required=True)
    arguments = parser.parse_args()
    for name, file in FILES.items():
        path = arguments.data / file
        if not path.exists():
            sys.exit(f"there is no {path}; the data set is at nonlinearbenchmark.org (EMPS)")
        if (arguments.out / name).exists():
            sys.exit(f"{arguments.out / name} already exists; give another --out")
        recorded = segments(path)
        write(recorded, arguments.out / name)
        axis = EmpsBackend(f"reference={path}").with_duration(SECONDS)
        for what, model in (("frictionless", axis), ("documented", axis.with_effects(DOCUMENTED))):
            gap = 1e6 * np.abs(gaps(recorded, model))
            print(f"{name:9s} {what:13s} mean gap {gap.mean():6.1f} um, largest {gap.max():6.1f} um")


if __name__ == "__main__":
    main()
