"""The formats of logs of topics, by the ending of the file's name; a ROS 2 bag may be a folder."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING

from s2r_spec.base.errors import one_of
from s2r_spec.logs.options import TimeOptions

if TYPE_CHECKING:
    from s2r_spec.logs.topics.topic import TopicLog

METADATA = "metadata.yaml"
"""Definition: the file that marks a folder as a ROS 2 bag."""
_BAG = "rosbag:RosBag"
ARRAYS = {".mat": "matlab:open_matlab", ".h5": "hdf5:open_hdf5", ".hdf5": "hdf5:open_hdf5"}
"""Definition: ending of a file of arrays, whose times may be plain numbers → what opens it, a name of this package."""
FORMATS = {".bag": _BAG, ".db3": _BAG, ".mcap": _BAG, ".ulg": "ulog:ULog", **ARRAYS}
"""Definition: ending of a log of topics → what opens it."""


def why_not_a_bag(folder: Path) -> str:
    """Return why a folder cannot be read as one log, with what to do."""
    files = [file.name for file in folder.iterdir() if file.suffix.lower() in FORMATS]
    if not files:
        return f"{folder} is a folder, and no ROS 2 bag: it has no {METADATA}; name a file or a bag in it"
    parts = ", each a part of the recording" if len(files) > 1 else ""
    return (
        f"{folder} has no {METADATA}, so its recording did not end well: `ros2 bag reindex {folder}` writes one; "
        f"or name one of its files{parts}: {one_of(files)}"
    )


def opener(path: Path, options: TimeOptions | None = None) -> Callable[[Path], TopicLog] | None:
    """Return what opens a log of topics; None if a path is none by its name.

    Args:
        path: the file, or the folder of a ROS 2 bag.
        options: what the user says of the times, for files of arrays; None for nothing.
    """
    if (path / METADATA).is_file():
        return _opener(_BAG)
    ending = path.suffix.lower()
    if ending not in FORMATS:
        return None
    found = _opener(FORMATS[ending])
    return found if options is None or ending not in ARRAYS else partial(found, options=options)


def _opener(name: str) -> Callable[..., TopicLog]:
    found: Callable[..., TopicLog] = resolve_name(f"{__package__}.{name}")
    return found
