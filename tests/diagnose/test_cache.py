"""What a diagnosis keeps on disk is data: a file that holds something else runs nothing, and is made again."""

import io
import pickle
import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest

import s2r_spec as s2r
from s2r_spec.diagnose.simulator.cache import Cache
from s2r_spec.diagnose.simulator.library import library
from tests.diagnose.toy import SHOW, TEST, Toy


class Touch:
    """What makes a file when it is unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return Path.touch, (self.path,)


def pickled(good, marker):
    return pickle.dumps(Touch(marker))


def pickled_inside(good, marker):
    """An archive with every member of a good one, each an array of objects that run when they are read."""
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(good)) as archive, zipfile.ZipFile(out, "w") as other:
        for name in archive.namelist():
            member = io.BytesIO()
            np.save(member, np.array([Touch(marker)], dtype=object), allow_pickle=True)
            other.writestr(name, member.getvalue())
    return out.getvalue()


def cut(good, marker):
    return good[: len(good) // 2]


def flipped(good, marker):
    middle = len(good) // 2
    return good[:middle] + bytes([good[middle] ^ 0xFF]) + good[middle + 1 :]


def of_other_shape(good, marker):
    """A good archive but for its arrays of more than one axis, which lack a row."""
    with np.load(io.BytesIO(good)) as arrays:
        less = {name: each[:-1] if each.ndim > 1 else each for name, each in arrays.items()}
    out = io.BytesIO()
    np.savez(out, **less)
    return out.getvalue()


def empty(good, marker):
    return b""


EXPERIMENTS = (TEST, SHOW)


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """The folder of a response library."""
    folder = tmp_path_factory.mktemp("kept")
    library(Toy(), EXPERIMENTS, cache=Cache(folder))
    return folder


def files(folder):
    """Return the files of a folder, below it."""
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}


def one_of(folder, kind):
    """Return a file: of the responses, or of the parameters that act."""
    return sorted((folder / kind).glob("*.npz"))[0]


def same(one, other):
    return all(
        np.allclose(a.nominal, b.nominal)
        and all(np.allclose(x.values, y.values, atol=1e-5) for x, y in zip(a.curves, b.curves, strict=True))
        and np.allclose(a.practice.values, b.practice.values, atol=1e-4)
        for a, b in zip(one.responses, other.responses, strict=True)
    )


def test_all_that_is_kept_is_arrays_and_text(kept):
    assert {name.partition("/")[0] for name in files(kept)} == {"responses", "acting"}
    assert len(files(kept)) == len(EXPERIMENTS) + 1
    for name in files(kept):
        with np.load(kept / name, allow_pickle=False) as arrays:
            assert all(not arrays[each].dtype.hasobject for each in arrays)


@pytest.mark.parametrize("kind", ["responses", "acting"])
@pytest.mark.parametrize("spoil", [pickled, pickled_inside, cut, flipped, empty, of_other_shape])
def test_a_damaged_or_hostile_file_runs_nothing_and_is_made_again(kept, tmp_path, kind, spoil):
    if (kind, spoil) == ("acting", of_other_shape):
        pytest.skip("it has no array of more than one axis")
    folder, marker = tmp_path / "cache", tmp_path / "touched"
    shutil.copytree(kept, folder)
    path = one_of(folder, kind)
    path.write_bytes(spoil(path.read_bytes(), marker))
    cache = Cache(folder)
    made = library(Toy(), EXPERIMENTS, cache=cache)
    assert not marker.exists()
    [sentence] = cache.notes
    assert str(path) in sentence
    assert "made again" in sentence
    assert same(made, library(Toy(), EXPERIMENTS, cache=Cache(kept)))
    again = Cache(folder)
    assert same(made, library(Toy(), EXPERIMENTS, cache=again))
    assert not again.notes
    assert files(folder) == files(kept)


def test_a_diagnosis_names_the_file_that_it_made_again(tmp_path):
    spec = s2r.parse_spec(
        "signal x {N}\nparam v in [0, 1]\nrequire small: always[0, 0.9 s] (abs(x) <= 2 {N})"
    )
    marker = tmp_path / "touched"

    def diagnosed():
        return s2r.diagnose(spec, Toy(), Toy((("c", 2.0),)), 12, cache=tmp_path / "cache", where=False)

    first = diagnosed()
    spoilt = [one_of(tmp_path / "cache", kind) for kind in ("responses", "acting")]
    for path in spoilt:
        path.write_bytes(pickled(b"", marker))
    found = diagnosed()
    assert not marker.exists()
    assert not any("made again" in note for note in first.notes)
    for path in spoilt:
        assert [str(path) in note for note in found.notes if "made again" in note].count(True) == 1
    assert found.which.answer == first.which.answer == ("c",)


def test_a_folder_that_cannot_be_written_costs_no_answer(tmp_path):
    (tmp_path / "file").write_text("")
    own = Cache(tmp_path / "file")
    assert own.kept("x/x.npz", np.load, lambda: "made", lambda made, path: path.touch()) == "made"
    assert "could not be written" in own.notes[0]
