"""PX4's ULog, read by ``pyulog`` (the extra ``logs``). Stamps are microseconds since the autopilot started.

The first instance of a topic has its name, ``sensor_accel``; the others a number, ``sensor_accel_1``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from s2r_spec.errors import TraceError, shortened
from s2r_spec.logs.library import library
from s2r_spec.logs.table import Column, affordable, few, regular
from s2r_spec.logs.topics.topic import Stamps, Topic, TopicHead
from s2r_spec.printable import one_line

_STAMP = "timestamp"


class ULog:
    """A log of PX4; see :class:`s2r_spec.logs.topics.topic.TopicLog`.

    Raises:
        TraceError: pyulog is not installed, or the file is not a ULog.
    """

    def __init__(self, path: Path) -> None:
        regular(path)
        self.sortable = True
        pyulog = library("pyulog", "ULog files")
        try:
            with path.open("rb") as stream:
                log = pyulog.ULog(stream)
        except OSError:
            raise
        except Exception as error:  # pyulog lets errors of numpy, struct and of its own through
            reason = shortened(one_line(str(error)) or type(error).__name__)
            raise TraceError(f"this is not a ULog file: {reason}") from None
        self._data = {_name(one): one.data for one in log.data_list}
        few(sum(len(data) for data in self._data.values()))
        self.heads = tuple(
            TopicHead(name, tuple(field for field in data if field != _STAMP), len(data[_STAMP]))
            for name, data in self._data.items()
        )
        last = max((int(data[_STAMP].max()) for data in self._data.values() if len(data[_STAMP])), default=0)
        self._end = np.timedelta64(last * 1000, "ns")
        self.notes = (
            ["parts of the file are damaged, and their messages are lost"] if log.file_corruption else []
        )

    def read(self, wanted: Mapping[str, Sequence[str]], stamps: Stamps) -> dict[str, Topic]:
        """Read fields of topics; see :meth:`s2r_spec.logs.topics.topic.TopicLog.read`."""
        affordable(sum(len(self._data[name][_STAMP]) * (1 + len(fields)) for name, fields in wanted.items()))
        return {
            name: Topic(
                name,
                (np.array(self._data[name][_STAMP], dtype=np.int64) * 1000).view("m8[ns]"),
                {field: Column(np.array(self._data[name][field])) for field in fields},
                log_end=self._end,
            )
            for name, fields in wanted.items()
        }


def _name(data: object) -> str:
    name, instance = data.name, data.multi_id  # type: ignore[attr-defined]
    return f"{name}_{instance}" if instance else str(name)
