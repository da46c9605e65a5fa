"""``s2r log``: the topics of a log, with rates, gaps and units."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from s2r_spec.base.json_values import line
from s2r_spec.cli.options.logs import Columns, TimeUnit
from s2r_spec.cli.options.search import AsJson
from s2r_spec.cli.terminal.common import note, sentences
from s2r_spec.cli.terminal.terminal import say

SHOWN = 8
"""Definition: episodes of a topic that are listed."""

if TYPE_CHECKING:
    from s2r_spec.logs.summary import TopicSummary


def log(
    file: Annotated[
        Path,
        typer.Argument(
            help="A log: ROS bag (a file, or the folder of a ROS 2 bag), MCAP, ULog, HDF5, .mat, CSV, Parquet or NPZ.",
            show_default=False,
        ),
    ],
    columns: Columns = None,
    time_unit: TimeUnit = None,
    as_json: AsJson = False,
) -> None:
    """List the topics of a log, with their fields, rates, gaps and units."""
    with sentences(as_json):
        from s2r_spec.logs.options import read_map
        from s2r_spec.logs.summary import summary
        from s2r_spec.report.records.log import LogObject

        description = summary(file, read_map(columns or []), time_unit)
        if as_json:
            print(line(LogObject(log=str(file), topics=description.topics, notes=description.notes)))
            return
        for sentence in description.notes:
            note(f"{file}: {sentence}")
        for topic in description.topics:
            for text in _lines(topic):
                say(text)


def _lines(topic: TopicSummary) -> list[str]:
    kind = f" ({topic.kind})" if topic.kind else ""
    head = f"{topic.name or 'table'}{kind}: {topic.messages} {'messages' if topic.name else 'rows'}"
    if topic.episodes > 1:
        head += f" in {topic.episodes} episodes"
    if topic.messages:
        head += f" from {topic.begins}"
    if topic.period is not None:
        head += f", {topic.span:.6g} s, every {topic.period:.4g} s, longest gap {topic.gap:.4g} s"
    lines = [head]
    if topic.episodes > 1:
        lines += [
            f"  {number}: {run.messages} from {run.begins}, {run.span:.6g} s"
            for number, run in enumerate(topic.runs[:SHOWN], 1)
        ]
        lines += [f"  and {topic.episodes - SHOWN} more"] * (topic.episodes > SHOWN)
    for field in topic.fields:
        unit = f" [{field.unit}]" if field.unit else ""
        missing = f", {field.missing} missing" if field.missing else ""
        vector = f", {field.components} components" if field.components is not None else ""
        lines.append(f"  {field.name}{unit}{vector}{missing}")
    return [*lines, *(f"  left out: {sentence}" for sentence in topic.left_out)]
