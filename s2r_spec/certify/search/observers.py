"""Observers of a search: they show its progress and change nothing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from s2r_spec.certify.bound.certificate import Certificate
from s2r_spec.certify.bound.settings import SearchSettings
from s2r_spec.certify.search.search import Query
from s2r_spec.runs.journal import Record


@dataclass(frozen=True)
class Phase:
    """One search, as an observer shows it.

    ``symbol`` is that of the bounded quantity, "ρ" or "Δ". ``backend`` is the one whose rollouts are counted; the
    operator of an ``attended`` one answers at the terminal. Without ``settings`` nobody forecasts the end.
    """

    symbol: str
    unit: str
    backend: str
    units: Mapping[str, str]
    budget: int | None
    attended: bool = False
    settings: SearchSettings | None = None


class Observer:
    """Receives each step of a search, and shows nothing."""

    def begin(self, phase: Phase) -> None:
        """Receive the search that begins."""

    def batch(self, queries: list[Query], certificate: Certificate) -> None:
        """Receive the next batch, and the certificate from all batches before it."""

    def rollout(self, record: Record, new: bool = True) -> None:
        """Receive a rollout that is on disk; ``new`` is false if an earlier process ran it."""

    def crash(self, record: Record) -> None:
        """Receive a rollout without a trace: its worker died, or did not end in time."""


@dataclass(frozen=True)
class OnlyCrashes(Observer):
    """Passes crashes to another observer, and nothing else."""

    observer: Observer

    def crash(self, record: Record) -> None:
        """Pass the crash on."""
        self.observer.crash(record)
