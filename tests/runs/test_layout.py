"""Which folder a run is, for any of its folders."""

from pathlib import Path

import pytest

from s2r_spec.runs.layout import places, run_of, with_any


@pytest.fixture
def runs(tmp_path, monkeypatch):
    """A check, a gap and a certify, as their commands lay them out; of journals only the folders."""
    monkeypatch.chdir(tmp_path)
    for folder in ("check/walking", "gap/sim", "gap/real", "c/simulation", "c/gap/sim", "c/gap/real", "free"):
        Path(folder).mkdir(parents=True)
        (Path(folder) / "journal").touch()


def is_run(folder: Path) -> bool:
    return (folder / "journal").exists()


@pytest.mark.parametrize(
    ("journal", "header", "run"),
    [
        ("check/walking", {"requirement": "walking"}, "check"),
        ("free", {"requirement": "walking"}, "free"),
        ("free", {"measure": "m"}, "free"),
        ("gap/real", {"requirement": "walking", "side": "real"}, "gap"),
        ("c/gap/sim", {"requirement": "walking", "side": "sim"}, "c"),
        ("c/simulation", {"requirement": "walking"}, "c"),
    ],
)
def test_a_journal_says_its_run(runs, journal, header, run):
    assert run_of(Path(journal), header) == Path(run)


@pytest.mark.parametrize(
    ("given", "inside", "run"),
    [
        ("c", ["simulation"], "c"),
        ("c/simulation", ["simulation"], "c"),
        ("c/gap", ["simulation"], "c"),
        ("c/gap/real", ["simulation"], "c"),
        ("c/gap/real", ["sim", "real"], "c/gap"),
        ("gap", ["sim", "real"], "gap"),
        ("gap/sim", ["sim", "real"], "gap"),
        ("nowhere", ["sim", "real"], "nowhere"),
        ("free", ["sim", "real"], "free"),
    ],
)
def test_any_folder_leads_to_the_whole_run(runs, given, inside, run):
    assert with_any(Path(given), inside, is_run).absolute() == Path(run).absolute()


def test_requirements_lie_beside_each_other_or_in_the_folder_that_python_was_given():
    both = ["walking", "still"]
    assert places(Path("r"), both, None) == {name: Path("r", name) for name in both}
    assert places(Path("r/walking"), both, "walking") == {name: Path("r", name) for name in both}
    assert places(Path("mine"), ["walking"], "walking") == {"walking": Path("mine")}
