"""Options for reading logs, the same in every command that takes ``log:FOLDER``."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Literal

from s2r_spec.base.errors import UsageError
from s2r_spec.cli.options.groups import log_option, options

if TYPE_CHECKING:
    from s2r_spec.recordings.log_episodes import EpisodeSettings, ParamColumn
    from s2r_spec.spec import Spec

READ = ("log:", "manual:")
"""Definition: prefixes of the backends that read logs."""
_PLAIN = "=[]+/:.@"
"""Definition: characters that stay as they are in the text after a backend's ``?``."""


TimeUnit = Annotated[
    str | None,
    log_option(
        "--time-unit",
        help="Unit of times that a log gives as plain numbers: s, ms, us, ns or min.",
        show_default="the log's own, or else s",
    ),
]
Columns = Annotated[
    list[str] | None,
    log_option(
        "--map",
        "-m",
        help="Column or field of a log for a signal or the time t: vx=/odom.speed, 'q[0]=q_0', 'w=/imu.w (rad/s)', "
        "t=sec+nanosec. `s2r log FILE` lists the names. May be repeated.",
        show_default="the signal's own name",
    ),
]


@options
class LogForm:
    """How a log becomes traces; each field is an option."""

    nan: str | None = log_option(
        None,
        "--nan",
        help="Missing samples of a log: error, or hold to repeat the sample before.",
        show_default="error",
    )
    time_unit: TimeUnit = None
    columns: Columns = None
    when: str | None = log_option(
        None,
        help="Condition on channels of a log, such as 'vx_cmd > 0.05'. An episode begins where it becomes true.",
        show_default="the whole log is one trace",
    )
    start: float | None = log_option(
        None, min=0, help="Time of a log before which no episode begins, in seconds.", show_default="0"
    )
    duration: float | None = log_option(
        None,
        min=0,
        help="Length of an episode in seconds.",
        show_default="as long as the requirement looks ahead",
    )
    join: Literal["hold", "linear"] | None = log_option(
        None,
        help="Values between the messages of a topic: hold the last one, or interpolate. For a table with empty cells, "
        "each column is a topic.",
        show_default="hold for a log of topics",
    )
    clock: str | None = log_option(
        None,
        help="Topic, or signal of a topic, whose stamps the trace has.",
        show_default="the one with the most messages",
    )
    stamps: Literal["header", "received"] | None = log_option(
        None,
        "--stamps",
        help="Stamps of ROS messages: those in their headers, or the times of receipt.",
        show_default="header if all topics have one, else received",
    )
    longest: list[str] | None = log_option(
        None,
        help="Time for which a signal's value is valid, in seconds: hit=2. May be repeated.",
        show_default="5 periods of a periodic signal, no end for one sent on change",
    )

    def episode_settings(self, sources: Mapping[str, ParamColumn]) -> EpisodeSettings:
        """Return how a log becomes traces, with the sources of its test parameters."""
        from s2r_spec.logs.options import read_map
        from s2r_spec.logs.topics.join import Joining
        from s2r_spec.recordings.log_episodes import EpisodeSettings, read_longest

        valid, columns = read_longest(self.longest or []), read_map(self.columns or [])
        joining = Joining.of_options(self.clock, self.join, self.stamps)
        cuts = self.when, self.start, self.duration
        return EpisodeSettings(columns, self.time_unit, joining, *cuts, sources, valid)


@options
class LogReading(LogForm):
    """How a command reads folders of logs; each field is an option."""

    sources: list[str] | None = log_option(
        None,
        "--param",
        "-p",
        help="Test parameter that a log holds: vd=/cmd.speed@0 is the value of this field at an episode's start. "
        "May be repeated.",
        show_default="as rollouts.csv says",
    )

    def backends(self, names: Sequence[str], spec: Spec, requirements: Sequence[str]) -> list[str]:
        """Return the names of backends, with these options after each that reads logs.

        An episode is as long as the requirements look ahead, unless its length is given.

        Raises:
            UsageError: an option is given but no backend reads logs, or its value is invalid.
        """
        values = {
            "nan": None if self.nan is None else missing(self.nan),
            "time-unit": self.time_unit,
            "when": self.when,
            "start": self.start,
            "duration": self.duration,
            "join": self.join,
            "clock": self.clock,
            "stamps": self.stamps,
        }
        given = [(key, str(value)) for key, value in values.items() if value is not None]
        for key, repeated in (("map", self.columns), ("param", self.sources), ("longest", self.longest)):
            given += [(key, text) for text in repeated or ()]
        if given and not any(name.startswith(READ) for name in names):
            raise UsageError(
                "the options for reading logs need a folder of logs, log:FOLDER or manual:FOLDER, and none is given"
            )
        horizon = max((spec.horizon(name) for name in requirements), default=math.inf)
        cuts = self.when is not None or self.start is not None
        if cuts and self.duration is None and math.isfinite(horizon):
            given.append(("duration", repr(horizon)))
        from urllib.parse import quote

        texts = "&".join(f"{key}={quote(value, safe=_PLAIN)}" for key, value in given)
        return [
            f"{name}{'&' if '?' in name else '?'}{texts}" if texts and name.startswith(READ) else name
            for name in names
        ]


def missing(nan: str | None) -> Literal["error", "hold"]:
    """Return the value of ``--nan``: "error" or "hold".

    Raises:
        UsageError: it is neither.
    """
    if nan is None or nan == "error":
        return "error"
    if nan == "hold":
        return "hold"
    raise UsageError(f"--nan must be error or hold, not {nan!r}")
