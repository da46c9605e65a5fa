"""The journal of a campaign, in a folder that ``log:FOLDER`` reads.

``campaign.json`` has the seed, and lists the experiments, each before it begins, and what the machine refused. The
trace of a run is on disk before the next begins. The table ``rollouts.csv`` follows from both.
"""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from s2r_spec import logs
from s2r_spec.backend.protocols import PROTOCOL
from s2r_spec.base.errors import NotBegunError, UsageError
from s2r_spec.base.files import save
from s2r_spec.diagnose.simulator.experiments import Experiment
from s2r_spec.runs.seeds import NEW_SEED, inherited_seed
from s2r_spec.trace import Trace

FILE, TABLE, SCHEMA = "campaign.json", "rollouts.csv", "s2r.campaign/1"
TRACES = "[!.]*.npz"
"""Definition: names of the traces; hidden files are incomplete."""
REAL, ANSWER = "real", "diagnosis.json"
"""In the folder of a run: the folder of the real rollouts, and the file of the diagnosis."""


class CampaignJournal:
    """The attempts of a campaign so far, in a folder, which is made if needed.

    ``units`` are the machine's: parameter → unit.

    Raises:
        UsageError: the folder has recordings of no campaign or of another seed, or its journal is damaged.
    """

    def __init__(self, folder: Path, units: Mapping[str, str], seed: int) -> None:
        self._folder, self._units, self._seed = folder, units, seed
        self._steps: list[dict[str, Any]] = []
        self._rows: list[dict[str, str]] = []
        folder.mkdir(parents=True, exist_ok=True)
        path, instead = folder / FILE, f"diagnose its recordings with --real log:{folder}"
        if not path.exists():
            if (folder / TABLE).exists() or any(folder.glob(TRACES)):
                raise UsageError(f"{folder} has recordings and no {FILE}; use an empty folder, or {instead}")
            return
        try:
            contents = _read(path)
            self._steps = [_step(_experiment(each), str(each["refused"])) for each in contents["steps"]]
        except (ValueError, KeyError, TypeError, AttributeError):
            raise UsageError(f"{path} is not the journal of a campaign; restore it, or {instead}") from None
        if (recorded := self.seed_in(folder)) is not None:
            inherited_seed(folder, recorded, seed)

    @staticmethod
    def seed_in(folder: Path) -> int | None:
        """Return the seed of the campaign in a folder; None without a campaign, or without a seed in its journal."""
        try:
            seed = _read(folder / FILE).get("seed")
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            return None
        return seed if isinstance(seed, int) else None

    def experiment(self, number: int) -> Experiment | None:
        """Return an experiment that has begun, with the simulator's parameters; None if none has this number."""
        return _experiment(self._steps[number]) if number < len(self._steps) else None

    def refused(self, number: int) -> str:
        """Return why the machine refused an experiment; "" if it did not."""
        return str(self._steps[number]["refused"])

    def run(
        self, number: int, experiment: Experiment, params: Mapping[str, float], run: Callable[[], Trace]
    ) -> Trace | None:
        """Return the trace of an experiment, from the disk if it is there; None if the machine refuses a protocol.

        Args:
            number: its place in the campaign.
            experiment: with the simulator's parameters.
            params: the machine's.
            run: runs it on the machine.

        Raises:
            UsageError: the journal has another experiment, the machine refuses a test, or a file cannot be written.
        """
        path, begun = self._folder / f"{number:04d}.npz", self.experiment(number)
        if begun is None:
            self._save([*self._steps, _step(experiment)])
        elif not _is_same(begun, experiment):
            raise UsageError(
                f"{path} was recorded with {begun}, but this run plans {experiment} in its place. Use the spec, "
                f"budget, protocols and seed of the first run, or diagnose its recordings with "
                f"--real log:{self._folder}"
            )
        if self.refused(number):
            return None
        if not path.exists():
            try:
                trace = run()
            except (UsageError, NotBegunError) as error:
                if not experiment.protocol:
                    raise
                self._steps[number]["refused"] = str(error)
                self._save(self._steps)
                return None
            logs.write(trace, path)
        named = {f"{n} [{self._units[n]}]" if self._units.get(n) else n: repr(v) for n, v in params.items()}
        self._rows.append({"id": path.stem, PROTOCOL: experiment.protocol} | named)
        if len(self._rows) >= len(list(self._folder.glob(TRACES))):
            self._tabulate()
        return logs.read(path)  # as a resumed campaign reads it

    def _save(self, steps: list[dict[str, Any]]) -> None:
        self._steps = steps
        save(
            self._folder / FILE,
            json.dumps({"schema": SCHEMA, "seed": self._seed, "steps": steps}, indent=1) + "\n",
        )

    def _tabulate(self) -> None:
        left_out = () if any(row[PROTOCOL] for row in self._rows) else (PROTOCOL,)
        columns = dict.fromkeys(name for row in self._rows for name in row if name not in left_out)
        text = io.StringIO(newline="")
        writer = csv.DictWriter(text, columns, extrasaction="ignore")
        writer.writeheader()
        writer.writerows(self._rows)
        save(self._folder / TABLE, text.getvalue())


def _read(path: Path) -> dict[str, Any]:
    contents: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    if contents["schema"] != SCHEMA:
        raise ValueError
    return contents


def _step(experiment: Experiment, refused: str = "") -> dict[str, Any]:
    return {"protocol": experiment.protocol, "params": dict(experiment.params), "refused": refused}


def _experiment(step: Mapping[str, Any]) -> Experiment:
    values = {name: float(value) for name, value in step["params"].items()}
    return Experiment(str(step["protocol"]), tuple(sorted(values.items())))


def _is_same(one: Experiment, other: Experiment) -> bool:
    here, there = dict(one.params), dict(other.params)
    return (one.protocol, here.keys()) == (other.protocol, there.keys()) and all(
        math.isclose(here[name], there[name], rel_tol=1e-9, abs_tol=1e-12) for name in here
    )


def begun_in(folder: Path) -> Path:
    """Return the folder of a diagnosis to continue, from that folder or from its folder of real rollouts.

    Raises:
        UsageError: nothing was recorded there.
    """
    run = folder.parent if folder.name == REAL and not (folder / REAL).exists() else folder
    real = run / REAL
    if not (run / ANSWER).exists() and not (real.is_dir() and any(real.iterdir())):
        raise UsageError(
            f"no run to resume in {folder}: there is no rollout in {real} and no {ANSWER}; begin a new run with --run"
        )
    return run


def seed_of(run: Path | None, seed: int | None) -> int:
    """Return the seed of a diagnosis: the user's, else that of the run to continue, else that of a new one.

    Raises:
        UsageError: the run has another seed.
    """
    if run is not None:
        recorded = CampaignJournal.seed_in(run / REAL)
        with suppress(OSError, ValueError, KeyError, TypeError):
            if recorded is None:
                answer = json.loads((run / ANSWER).read_text(encoding="utf-8"))
                recorded = int(answer["provenance"]["seed"])
        if recorded is not None:
            return inherited_seed(run, recorded, seed)
    return NEW_SEED if seed is None else seed


def campaign_seed(folder: Path | None, seed: int | None) -> int:
    """Return the seed of the campaign in a folder, or that of a new one; a UsageError refuses another one."""
    if folder is not None and (recorded := CampaignJournal.seed_in(folder)) is not None:
        return inherited_seed(folder, recorded, seed)
    return NEW_SEED if seed is None else seed
