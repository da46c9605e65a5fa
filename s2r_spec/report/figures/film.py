"""The real robot beside the simulated one at the worst test: tiles, and a short video, as data for a page."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from s2r_spec.backend import HasTracePictures
from s2r_spec.base.errors import UsageError, require
from s2r_spec.diagnose.gap.where import WorstPair

if TYPE_CHECKING:
    from PIL import Image

TILES = 4
"""Definition: instants that are shown as tiles, evenly over the rollouts."""
FRAMES_PER_SECOND = 12.5
"""Budget: frames of the video in a second."""
LONGEST = 6.0
"""Budget: time of the video [s]; of a longer test it shows the last seconds."""
WIDTH = 320
"""Budget: width of a robot's picture in the page [pixels]."""
QUALITY = 60
"""Budget: quality of compression, of 100."""

Images = NDArray[np.uint8]


@dataclass(frozen=True)
class Tile:
    """Both robots at one time: data of their pictures."""

    when: str
    real: str
    simulated: str


@dataclass(frozen=True)
class Film:
    """Both robots, the real one left.

    Attributes:
        video: data of the animated picture.
        still: data of one frame, for readers who want nothing to move.
        size: width and height of the video [pixels].
        notes: what the log lacks, or why there are no pictures; each in one sentence.
    """

    title: str
    caption: str
    tiles: tuple[Tile, ...] = ()
    video: str = ""
    still: str = ""
    size: tuple[int, int] = (0, 0)
    notes: tuple[str, ...] = ()


def film(pair: WorstPair, test: str) -> Film | None:
    """Return both robots at the worst test; None if the simulator cannot draw a trace."""
    if not isinstance(pair.backend, HasTracePictures):
        return None
    title = "The robot at the worst test"
    end = max(one.duration for one in (pair.real, pair.simulated))
    first = max(0.0, end - LONGEST)
    moving = np.arange(first, end, 1.0 / FRAMES_PER_SECOND)
    still = np.linspace(0.0, end, TILES + 1)[1:]
    times = [*moving.tolist(), *still.tolist()]
    try:
        require("pictures need", "PIL")
        drawn = [
            pair.backend.draw_trace(trace, pair.params, times, pair.simulated)
            for trace in (pair.real, pair.simulated)
        ]
    except UsageError as error:
        return Film(title, "", notes=(str(error),))
    sides = [[_small(image) for image in one.images] for one in drawn]
    both = [_beside(*pictures) for pictures in zip(*sides, strict=True)]
    number = len(moving)
    tiles = zip(still, *(side[number:] for side in sides), strict=True)
    ended = [
        f"the {name} rollout ended after {one.duration:.2g} s, and keeps its last pose"
        for name, one in (("real", pair.real), ("simulated", pair.simulated))
        if one.duration < end - 1.5 / FRAMES_PER_SECOND
    ]
    return Film(
        title,
        f"Left the real robot, posed from its own log; right the simulated one{f', at {test}' if test else ''}. The "
        f"video shows {f'the last {LONGEST:g} s' if first else 'the whole rollout'}, in real time and again and again.",
        tuple(Tile(f"{when:.1f} s", _data([real]), _data([other])) for when, real, other in tiles),
        _data(both[:number]),
        _data(both[-1:]),
        both[0].size,
        (*drawn[0].missing, *ended),
    )


def _small(image: Images) -> Image.Image:
    from PIL import Image

    picture = Image.fromarray(image)
    return picture.resize((WIDTH, round(picture.height * WIDTH / picture.width)), Image.Resampling.LANCZOS)


def _beside(left: Image.Image, right: Image.Image) -> Image.Image:
    from PIL import Image

    return Image.fromarray(np.hstack([np.asarray(left), np.asarray(right)]))


def _data(images: Sequence[Image.Image]) -> str:
    """Return pictures as the address of one, which moves if there are several."""
    file, (first, *rest) = BytesIO(), images
    more = {"save_all": True, "append_images": rest, "duration": round(1e3 / FRAMES_PER_SECOND), "loop": 0}
    first.save(file, format="WEBP", quality=QUALITY, method=4, **(more if rest else {}))
    return f"data:image/webp;base64,{b64encode(file.getvalue()).decode()}"
