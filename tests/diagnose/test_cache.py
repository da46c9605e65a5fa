"""What a diagnosis keeps on disk is data: a file that holds something else runs nothing, and is made again."""

import io
import os
import pickle
import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest
from s2r_cart import SPEC, Cart, real

import s2r_spec as s2r
from s2r_spec.diagnose import bank as banks
from s2r_spec.diagnose import judge as judges
from s2r_spec.diagnose.cache import Cache
from s2r_spec.diagnose.classifiers import Forest, Network
from s2r_spec.diagnose.prepare import bench_of

pytestmark = pytest.mark.filterwarnings("ignore::sklearn.exceptions.ConvergenceWarning")


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


def runs():
    tests = [{"vd": 0.2 + 0.02 * k, "acc": 2.0} for k in range(9)]
    return [(test, real(test, k, {})) for k, test in enumerate(tests)]


@pytest.fixture(scope="module")
def kept(cache):
    """Every file that a diagnosis keeps, by the folder that it is in."""
    s2r.diagnose(s2r.parse_spec(SPEC), Cart(), runs(), cache=cache, where=False)
    own = f"{banks.key(bench_of(s2r.parse_spec(SPEC), 'tracking', Cart()))}.npz"
    files = {folder.name: next(folder.iterdir()) for folder in cache.iterdir()}
    return files | {"banks": cache / "banks" / own}


LOADS = {"banks": (banks.load, banks.save), "judges": (judges.load, judges.save)}


def test_all_that_is_kept_is_arrays_and_text(kept):
    assert set(kept) == set(LOADS)
    for path in kept.values():
        with np.load(path, allow_pickle=False) as arrays:
            assert all(not arrays[name].dtype.hasobject for name in arrays)


@pytest.mark.parametrize("place", LOADS)
@pytest.mark.parametrize("spoil", [pickled, pickled_inside, cut, flipped, of_other_shape, empty])
def test_a_damaged_or_hostile_file_runs_nothing_and_is_made_again(kept, tmp_path, place, spoil):
    load, save = LOADS[place]
    good, marker = kept[place], tmp_path / "touched"
    path = tmp_path / place / "x.npz"
    path.parent.mkdir()
    path.write_bytes(spoil(good.read_bytes(), marker))
    own = Cache(tmp_path)
    made = own.kept(f"{place}/x.npz", load, lambda: load(good), save)
    assert not marker.exists()
    [sentence] = own.said
    assert str(path) in sentence
    assert "made again" in sentence
    again = Cache(tmp_path)
    read = again.kept(f"{place}/x.npz", load, lambda: pytest.fail("it was not kept"), save)
    assert not again.said
    assert type(read) is type(made)
    assert os.listdir(path.parent) == ["x.npz"]


def test_a_diagnosis_runs_no_file_and_names_the_one_that_it_made_again(kept, tmp_path):
    marker = tmp_path / "touched"
    for name, path in kept.items():
        shutil.copytree(path.parent, tmp_path / name)
    bank = tmp_path / "banks" / kept["banks"].name
    bank.write_bytes(pickled(b"", marker))
    (tmp_path / "judges" / kept["judges"].with_suffix(".pkl").name).write_bytes(pickled(b"", marker))
    found = s2r.diagnose(s2r.parse_spec(SPEC), Cart(), runs(), cache=tmp_path, where=False)
    assert not marker.exists()
    assert [str(bank) in note for note in found.notes if "made again" in note] == [True]
    assert np.array_equal(banks.load(bank).nominal, banks.load(kept["banks"]).nominal, equal_nan=True)


def test_a_folder_that_cannot_be_written_costs_no_answer(tmp_path):
    (tmp_path / "file").write_text("")
    own = Cache(tmp_path / "file")
    assert own.kept("banks/x.npz", banks.load, lambda: "made", lambda made, path: path.touch()) == "made"
    assert "could not be written" in own.said[0]


def test_arrays_predict_what_scikit_learn_does():
    from sklearn.ensemble import ExtraTreesClassifier
    from sklearn.neural_network import MLPClassifier

    rng = np.random.default_rng(0)
    x, other = rng.normal(size=(120, 5)), rng.normal(size=(50, 5))
    for labels in (1, 3):
        y = (x[:, :labels] + 0.3 * rng.normal(size=(120, labels)) > 0.0).astype(int)
        network = MLPClassifier((8, 6), max_iter=30, random_state=1).fit(x, y.squeeze())
        expected = network.predict_proba(other)
        mine = Network.of(network).probabilities(other)
        assert np.array_equal(mine, expected[:, 1:] if labels == 1 else expected)
    trees = ExtraTreesClassifier(20, min_samples_leaf=4, random_state=2).fit(
        x, y[:, 0], sample_weight=rng.uniform(0.1, 2.0, 120)
    )
    assert np.array_equal(Forest.of(trees).probabilities(other), trees.predict_proba(other)[:, 1])


def test_a_forest_that_never_ends_is_refused():
    table = {"column": np.zeros(2, int), "threshold": np.zeros(2), "share": np.zeros(2)}
    with pytest.raises(ValueError, match="rows that it lacks"):
        Forest(np.array([0]), np.array([0, -1]), np.array([1, -1]), **table)
