"""The journal of a campaign, in a folder that ``log:FOLDER`` reads.

``campaign.json`` lists the experiments, each before it begins, and what the machine refused. The trace of a run is on
disk before the next begins. The table ``rollouts.csv`` follows from both.
"""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from s2r_spec import logs
from s2r_spec.diagnose.simulator.experiments import Experiment
from s2r_spec.errors import NotBegunError, UsageError
from s2r_spec.files import save
from s2r_spec.protocols import PROTOCOL
from s2r_spec.trace import Trace

FILE, TABLE, SCHEMA = "campaign.json", "rollouts.csv", "s2r.campaign/1"


@dataclass
class Journal:
    """The attempts of a campaign so far.

    Attributes:
        folder: folder of the files; it is made if needed.
        units: the machine's units: parameter → unit.
        steps: the experiments, with the simulator's parameters.
        refused: number of an experiment → why the machine refused it.
        rows: rows of the table.
    """

    folder: Path
    units: Mapping[str, str]
    steps: list[Experiment] = field(default_factory=list)
    refused: dict[int, str] = field(default_factory=dict)
    rows: list[dict[str, str]] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Read what the folder has.

        Raises:
            UsageError: the folder has recordings of no campaign, or its journal is damaged.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        path, instead = self.folder / FILE, f"diagnose its recordings with --real log:{self.folder}"
        if not path.exists():
            if (self.folder / TABLE).exists() or any(self.folder.glob("[!.]*.npz")):
                raise UsageError(
                    f"{self.folder} has recordings and no {FILE}; use an empty folder, or {instead}"
                )
            return
        try:
            found = json.loads(path.read_text(encoding="utf-8"))
            if found["schema"] != SCHEMA:
                raise ValueError
            for each in found["steps"]:
                values = {name: float(value) for name, value in each["params"].items()}
                self.steps.append(Experiment(str(each["protocol"]), tuple(sorted(values.items()))))
                if each["refused"]:
                    self.refused[len(self.steps) - 1] = str(each["refused"])
        except (ValueError, KeyError, TypeError, AttributeError):
            raise UsageError(f"{path} is not the journal of a campaign; restore it, or {instead}") from None

    def run(
        self, number: int, experiment: Experiment, params: Mapping[str, float], run: Callable[[], Trace]
    ) -> Trace | None:
        """Return the trace of an experiment, from the disk if it is there; None if the machine refuses a protocol.

        Args:
            number: its place in the campaign.
            experiment: with the simulator's parameters.
            params: the machine's parameters.
            run: runs it on the machine.

        Raises:
            UsageError: the journal has another experiment, the machine refuses a test, or a file cannot be written.
        """
        path = self.folder / f"{number:04d}.npz"
        if number == len(self.steps):
            self.steps.append(experiment)
            self._save()
        elif not _same(self.steps[number], experiment):
            raise UsageError(
                f"{path} was recorded with {self.steps[number]}, but this run plans {experiment} in its place. Use the "
                f"spec, budget, protocols and seed of the first run, or diagnose its recordings with "
                f"--real log:{self.folder}"
            )
        if number in self.refused:
            return None
        if not path.exists():
            try:
                trace = run()
            except (UsageError, NotBegunError) as error:
                if not experiment.protocol:
                    raise
                self.refused[number] = str(error)
                self._save()
                return None
            logs.write(trace, path)
        columns = {f"{n} [{self.units[n]}]" if self.units.get(n) else n: repr(v) for n, v in params.items()}
        self.rows.append({"id": path.stem, PROTOCOL: experiment.protocol} | columns)
        if len(self.rows) >= len(list(self.folder.glob("[!.]*.npz"))):
            self._tabulate()
        return logs.read(path)  # as a resumed campaign reads it

    def _save(self) -> None:
        steps = [
            {"protocol": e.protocol, "params": dict(e.params), "refused": self.refused.get(number, "")}
            for number, e in enumerate(self.steps)
        ]
        save(self.folder / FILE, json.dumps({"schema": SCHEMA, "steps": steps}, indent=1) + "\n")

    def _tabulate(self) -> None:
        left_out = () if any(row[PROTOCOL] for row in self.rows) else (PROTOCOL,)
        columns = dict.fromkeys(name for row in self.rows for name in row if name not in left_out)
        text = io.StringIO(newline="")
        writer = csv.DictWriter(text, columns, extrasaction="ignore")
        writer.writeheader()
        writer.writerows(self.rows)
        save(self.folder / TABLE, text.getvalue())


def _same(one: Experiment, other: Experiment) -> bool:
    """Return whether two experiments are equal up to rounding."""
    here, there = dict(one.params), dict(other.params)
    return (one.protocol, here.keys()) == (other.protocol, there.keys()) and all(
        math.isclose(here[name], there[name], rel_tol=1e-9, abs_tol=1e-12) for name in here
    )
