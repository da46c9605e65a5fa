"""Failures of a rollout in the specification language: ``failure.fell = "height < 0.2 {m}"``."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property

from s2r_spec.backend import Channel
from s2r_spec.errors import UsageError
from s2r_spec.spec import Spec, SpecError, parse_spec
from s2r_spec.trace import Trace

LONGEST = 200
"""Budget: characters of a condition in a message."""


class Failures:
    """The conditions of a robot file under which a rollout has failed, each evaluated at every sample."""

    def __init__(self, conditions: Mapping[str, str], channels: tuple[Channel, ...], source: str) -> None:
        self._conditions, self._channels, self._source = dict(conditions), channels, source

    @cached_property
    def _specs(self) -> dict[str, Spec]:
        return {name: self._parse(name, text) for name, text in self._conditions.items()}

    def check(self) -> None:
        """Parse every condition; a UsageError shows the place of a mistake."""
        _ = self._specs

    def _parse(self, name: str, text: str) -> Spec:
        signals = [
            f"signal {one.name}{f'[{one.width}]' if one.width > 1 else ''}{f' {{{one.unit}}}' if one.unit else ''}"
            for one in self._channels
        ]
        try:
            return parse_spec(
                "\n".join([*signals, f"require {name}: {text}\n"]), f"{self._source}: failure.{name}"
            )
        except SpecError as error:
            first = error.diagnostics[0]
            words = "; ".join(filter(None, (first.message, first.fix)))
            raise UsageError(f"{self._source}: failure.{name} = {text[:LONGEST]!r}: {words}") from None

    def first(self, trace: Trace) -> tuple[str, int] | None:
        """Return the failure that comes first and its sample; None without one."""
        found = []
        for name, spec in self._specs.items():
            margins = spec.robustness_signal(trace.only(spec.channels(name)), name)
            holds = margins > 0.0
            if holds.any():
                found.append((int(holds.argmax()), name))
        return (min(found)[1], min(found)[0]) if found else None
