"""Episodes of a robot's log for Python: what ``s2r monitor --when`` evaluates."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping
from pathlib import Path

from s2r_spec.base.errors import TraceNote
from s2r_spec.logs.topics.join import Joining
from s2r_spec.recordings.log_episodes import EpisodeSettings, read_log_episodes, read_sources
from s2r_spec.spec import Spec
from s2r_spec.trace import Trace


def read_episodes(
    path: str | os.PathLike[str],
    spec: Spec,
    columns: Mapping[str, str] | None = None,
    *,
    when: str | None = None,
    duration: float | None = None,
    params: Mapping[str, str] | None = None,
    joining: Joining | None = None,
) -> list[tuple[dict[str, float], Trace]]:
    """Return (test, trace) of every episode of a log, as :func:`s2r_spec.diagnose` takes them.

    The reader warns (:class:`TraceNote`) of how topics were joined, how episodes were cut, and what was left out.

    Args:
        path: the file, or the folder of a ROS 2 bag.
        spec: the specification; its signals are read.
        columns: signal, another name in ``when``, or ``t`` → name of its column or field.
        when: condition that begins an episode where it becomes true ("vx_cmd > 0.05"); None for one trace.
        duration: length of an episode [s]; None for as long as the requirements look ahead.
        params: test parameter → its field and time after the episode's start, such as "/cmd_vel.linear.x@0".
        joining: how topics come to common stamps; None for the defaults.

    Raises:
        TraceError: the file cannot be read, lacks a signal, or has no complete episode.
        SpecError: the condition is not valid.
        UsageError: the length of an episode is not known, or a value of ``params`` is not a field and a time.
    """
    stated, sources = read_sources(f"{name}={text}" for name, text in (params or {}).items())
    values = spec.read_params(stated)
    widths = {signal.name: signal.dim if signal.vector else None for signal in spec.signals.values()}
    reading = EpisodeSettings(columns or {}, None, joining, when, None, duration, sources)
    log = read_log_episodes(Path(path), spec.signals, widths, spec.horizon(), reading)
    for note in (*log.notes, *log.silences):
        warnings.warn(f"{path}: {note}", TraceNote, stacklevel=2)
    return [({**values, **spec.read_params(one.texts())}, one.trace) for one in log.episodes]
