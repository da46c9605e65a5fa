"""PX4's ULog, read by ``pyulog`` (the extra ``logs``). Stamps are microseconds since the autopilot started.

The first instance of a topic has its name, ``sensor_accel``; the others a number, ``sensor_accel_1``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from s2r_spec.base.errors import TraceError
from s2r_spec.logs.library import library, reason_of
from s2r_spec.logs.table import Column, check_columns, check_file, check_size
from s2r_spec.logs.topics.topic import Stamps, Topic, TopicHead

_STAMP = "timestamp"
_FILE_HEADER, _MESSAGE_HEADER = 16, 3
"""Definition: bytes of the header of a ULog file, and of each of its messages."""


class ULog:
    """A log of PX4; see :class:`s2r_spec.logs.topics.topic.TopicLog`.

    Raises:
        TraceError: pyulog is not installed, or the file is not a ULog.
    """

    def __init__(self, path: Path) -> None:
        check_file(path)
        self.sortable = True
        pyulog = library("pyulog", "ULog files")
        try:
            with path.open("rb") as stream:
                log = pyulog.ULog(stream)
        except OSError:
            raise
        except Exception as error:  # pyulog lets errors of numpy, struct and of its own through
            raise TraceError(f"this is not a ULog file: {reason_of(error)}") from None
        self._data = {
            f"{one.name}_{one.multi_id}" if one.multi_id else str(one.name): one.data for one in log.data_list
        }
        check_columns(sum(len(data) for data in self._data.values()))
        self.heads: Sequence[TopicHead] = [
            TopicHead(name, tuple(field for field in data if field != _STAMP), len(data[_STAMP]))
            for name, data in self._data.items()
        ]
        last = max((int(data[_STAMP].max()) for data in self._data.values() if len(data[_STAMP])), default=0)
        self._end = np.timedelta64(last * 1000, "ns")
        self.notes = (
            [] if not log.file_corruption else ["parts of the file are damaged, and their messages are lost"]
        )
        whole, size = _whole_length(path), path.stat().st_size
        if whole < size:
            self.notes.append(
                f"the log is incomplete: it ends within a message, and the last {size - whole:,} of its {size:,} bytes "
                f"are not read"
            )
        if log.dropouts:
            longest = max(one.duration for one in log.dropouts)
            self.notes.append(
                f"the logger lost messages in {len(log.dropouts)} dropouts, the longest of {longest} ms: there the log "
                f"is incomplete"
            )

    def read(self, wanted: Mapping[str, Sequence[str]], stamps: Stamps) -> dict[str, Topic]:
        """Read fields of topics; see :meth:`s2r_spec.logs.topics.topic.TopicLog.read`."""
        check_size(sum(len(self._data[name][_STAMP]) * (1 + len(fields)) for name, fields in wanted.items()))
        return {
            name: Topic(
                name,
                (np.array(self._data[name][_STAMP], dtype=np.int64) * 1000).view("m8[ns]"),
                {field: Column(np.array(self._data[name][field])) for field in fields},
                log_end=self._end,
            )
            for name, fields in wanted.items()
        }


def _whole_length(path: Path) -> int:
    """Return the bytes of a file up to the end of its last whole message (PX4's ULog: a header of 3 bytes, a body)."""
    content, place = path.read_bytes(), _FILE_HEADER
    while place + _MESSAGE_HEADER <= len(content):
        end = place + _MESSAGE_HEADER + int.from_bytes(content[place : place + 2], "little")
        if end > len(content):
            break
        place = end
    return min(place, len(content)) if len(content) > _FILE_HEADER else len(content)
