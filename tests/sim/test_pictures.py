"""Pictures of a trace, where this machine can draw."""

import importlib

import numpy as np
import pytest

from s2r_mujoco import pictures
from s2r_sim import SimBackend
from s2r_spec.base import errors
from s2r_spec.errors import UsageError
from tests.errors import naming

SHORT = SimBackend(duration=0.5)


def test_tiles_and_video_are_drawn(tmp_path):
    pil = pytest.importorskip("PIL.Image")
    try:
        trace = SHORT.render({"vd": 0.3}, 0, tmp_path / "gait.png")
    except UsageError as error:
        pytest.skip(str(error))
    with pil.open(tmp_path / "gait.png") as tiles:
        tiles.load()
    assert tiles.size == (pictures.WIDTH * pictures.TILES[0], pictures.HEIGHT * pictures.TILES[1])
    first, second = tiles.crop((0, 0, 400, 280)), tiles.crop((400, 0, 800, 280))
    assert len(np.unique(np.asarray(first).reshape(-1, 3), axis=0)) > 100
    assert first.tobytes() != second.tobytes()
    assert trace.meta["params"]["vd"] == 0.3

    SHORT.with_duration(0.2).render({"slope": 4.0}, 0, str(tmp_path / "walk.gif"))
    with pil.open(tmp_path / "walk.gif") as video:
        assert video.n_frames == 6


def test_another_ending_is_refused_with_the_known_ones(tmp_path):
    with pytest.raises(UsageError, match=naming("'walk.mp4'", ".jpg, .png", ".gif, .webp")):
        SHORT.render({}, 0, tmp_path / "walk.mp4")


def test_without_opengl_a_sentence_says_what_to_install(tmp_path, monkeypatch):
    pytest.importorskip("PIL")

    def absent(name):
        raise ImportError(name)

    monkeypatch.setattr(pictures, "import_module", absent)
    with pytest.raises(UsageError, match=naming("EGL", "OSMesa")):
        SHORT.render({}, 0, tmp_path / "gait.png")


def test_without_pillow_a_sentence_says_what_to_install(tmp_path, monkeypatch):
    find = importlib.util.find_spec
    monkeypatch.setattr(errors, "find_spec", lambda name: None if name == "PIL" else find(name))
    with pytest.raises(UsageError, match=naming("'pillow'")):
        SHORT.render({}, 0, tmp_path / "gait.png")
