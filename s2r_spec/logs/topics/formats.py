"""The formats of logs of topics, by the ending of the file's name; a ROS 2 bag may be a folder."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from s2r_spec.base.errors import one_of
from s2r_spec.logs.topics.arrays import TimeOptions
from s2r_spec.logs.topics.hdf5 import open_hdf5
from s2r_spec.logs.topics.matlab import open_matlab
from s2r_spec.logs.topics.rosbag import METADATA, RosBag
from s2r_spec.logs.topics.topic import TopicLog
from s2r_spec.logs.topics.ulog import ULog

ARRAYS: dict[str, Callable[..., TopicLog]] = {".mat": open_matlab, ".h5": open_hdf5, ".hdf5": open_hdf5}
"""Definition: endings of files of arrays, whose times may be plain numbers."""
FORMATS: dict[str, Callable[[Path], TopicLog]] = {
    ".bag": RosBag, ".db3": RosBag, ".mcap": RosBag, ".ulg": ULog, **ARRAYS,
}  # fmt: skip


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
        return RosBag
    ending = path.suffix.lower()
    if options is not None and ending in ARRAYS:
        return partial(ARRAYS[ending], options=options)
    return FORMATS.get(ending)
