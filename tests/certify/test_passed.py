"""A backend passed as an object gives what the installed one of the same code gives."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
import s2r_toy

import s2r_spec as s2r
from s2r_spec.backend import Channel, Parameter
from s2r_spec.errors import BackendError, UsageError
from s2r_spec.runs.passed import PassedBackend
from s2r_spec.trace import Trace
from s2r_spec.workers.pools import process_pool
from tests.cli.conftest import SPEC
from tests.errors import naming, states

pytestmark = pytest.mark.usefixtures("toy")
KEYWORDS = {"budget": 8}
TEXT = SPEC.replace("LIMIT", "0.1")


def one_thread():
    return ThreadPoolExecutor(1)


@pytest.fixture
def spec():
    return s2r.parse_spec(TEXT, "spec.stl")


@pytest.fixture(scope="module")
def named(tmp_path_factory):
    """The check and the gap of installed backends, by their names."""
    spec, place = s2r.parse_spec(TEXT, "spec.stl"), tmp_path_factory.mktemp("named")
    check = s2r.check(spec, "toy", place / "check", executor=one_thread, **KEYWORDS)
    return check, s2r.gap(spec, "toy", "toy:drag", place / "gap", executor=one_thread, **KEYWORDS)


def glides(params, seed):
    return s2r_toy.Toy().with_duration(1.5).rollout(params, seed)


def local():
    """Return a toy of a class that no other process can import, as in a notebook."""

    class Local(s2r_toy.Toy):
        pass

    return Local()


@pytest.mark.parametrize("made", [s2r_toy.Toy, local])
def test_an_object_gives_the_certificate_of_the_installed_backend(spec, tmp_path, made, named):
    passed = s2r.check(spec, made(), tmp_path, **KEYWORDS)
    assert passed.certificate == named[0].certificate
    assert passed.lowest.rho == named[0].lowest.rho
    # What no other process can load was repeated in this one alone, and says so.
    assert ("assumptions" in passed.provenance) == (made is local)
    assert passed.provenance.items() >= named[0].provenance.items()


def test_only_a_class_of_a_module_goes_to_another_process():
    assert PassedBackend(s2r_toy.Toy()).portable
    assert not PassedBackend(local()).portable


def test_processes_that_cannot_import_the_class_are_refused_with_the_remedy(spec, tmp_path):
    with pytest.raises(BackendError, match=naming("'toy'", "executor", "module")) as caught:
        s2r.check(spec, local(), tmp_path, executor=process_pool(1), **KEYWORDS)
    assert "\n" not in str(caught.value)


def test_gap_and_certify_take_objects_on_either_side(spec, tmp_path, named):
    passed = s2r.gap(spec, local(), s2r_toy.Toy("drag"), tmp_path / "passed", **KEYWORDS)
    assert passed.certificate == named[1].certificate
    assert passed.provenance["real"] == named[1].provenance["real"]
    assert passed.provenance["sim"].items() >= named[1].provenance["sim"].items()
    found = s2r.certify(spec, s2r_toy.Toy(), "toy:drag", tmp_path / "both", executor=one_thread, **KEYWORDS)
    assert (found.real, found.gap.lower, found.gap.tested) == ("toy:drag", named[1].lower, named[1].tested)


def test_a_measure_takes_an_object(tmp_path):
    def search():
        return s2r.Search(
            {"vd": (-0.2, 0.3)},
            kernel=s2r.Kernel("rbf", 0.4),
            B=0.5,
            R=0.02,
            delta=1e-3,
            epsilon=0.5,
            budget=8,
        )

    def last(trace, test):
        return trace["vx"][-1]

    named, passed = (
        s2r.check_measure(
            last, "m", robot, search(), tmp_path / str(k), fall=-1.0, executor=one_thread if k == 0 else None
        )
        for k, robot in enumerate(("toy", local()))
    )
    *own, here = passed.assumptions
    assert named == replace(passed, assumptions=tuple(own))
    assert states(here, "toy", "process")


def test_a_run_of_an_object_goes_on_and_its_rollouts_are_repeated(spec, tmp_path):
    robot = s2r.FunctionBackend(glides)
    first = s2r.check(spec, robot, tmp_path, executor=one_thread, **KEYWORDS)
    again = s2r.check(spec, robot, tmp_path, executor=one_thread, resume=True, **KEYWORDS)
    assert again.certificate == first.certificate
    lowest = f"{first.folder}#{first.lowest.query}.{first.lowest.replicate}"
    again = s2r.replay(lowest, robot)
    assert again.same
    assert again.trace["vx"].shape == (151,)
    with pytest.raises(UsageError, match=naming("'glides'", "s2r.replay(rollout, backend)")):
        s2r.replay(lowest)


def test_a_function_is_a_backend_with_the_interface_of_the_spec(spec, tmp_path, named):
    robot = s2r.FunctionBackend(glides)
    passed = s2r.check(spec, robot, tmp_path / "passed", executor=one_thread, **KEYWORDS)
    assert passed.certificate == named[0].certificate
    assert robot.name == "glides"
    other = s2r.FunctionBackend(lambda params, seed: glides(params, seed))
    assert other.model_hash != robot.model_hash
    assert not PassedBackend(other).portable
    assert s2r.check(spec, other, tmp_path / "other", **KEYWORDS).certificate == named[0].certificate


def test_what_is_no_function_has_no_hash(spec):
    class Callable:
        def __call__(self, params, seed):
            return glides(params, seed)

    with pytest.raises(UsageError, match=naming("model_hash")):
        s2r.FunctionBackend(Callable())
    assert s2r.FunctionBackend(Callable(), model_hash="1").model_hash == "1"
    with pytest.raises(UsageError, match="3"):
        s2r.FunctionBackend(3)


class Short:
    name, deterministic, duration, cost, model_hash = "short", True, 1.5, 1e-3, "1"
    channels = (Channel("vx", "m/s", "speed"),)
    parameters = (Parameter("vd", "m/s", -0.5, 0.5, 0.0, "commanded speed"),)

    def rollout(self, params, seed):
        return Trace(np.arange(151) / 100, {"vx": np.full(151, params["vd"])})


class WithoutHash(Short):
    @property
    def model_hash(self):
        raise AttributeError


class WithoutSeed(Short):
    def rollout(self, params):
        raise AssertionError


class WithNames(Short):
    channels = ("vx",)


class WithAMapping(Short):
    parameters = {"vd": (-0.5, 0.5)}  # noqa: RUF012


class NotAMethod(Short):
    rollout = 3


@pytest.mark.parametrize(
    ("given", "facts"),
    [
        (WithoutHash(), ("model_hash",)),
        (WithoutSeed(), ("(params)", "rollout(params, seed)")),
        (WithNames(), ("channels", "'vx'")),
        (WithAMapping(), ("parameters",)),
        (NotAMethod(), ("rollout",)),
        (Short, ("Short()",)),
        (glides, ("s2r.FunctionBackend(f)",)),
    ],
)
def test_what_breaks_the_protocol_is_named_before_anything_runs(spec, tmp_path, given, facts):
    for call in (
        lambda: s2r.check(spec, given, tmp_path),
        lambda: s2r.gap(spec, "toy", given, tmp_path),
        lambda: s2r.certify(spec, given, "toy", tmp_path),
    ):
        with pytest.raises(UsageError, match=naming(*facts)) as caught:
            call()
        assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())


class Raises(Short):
    def rollout(self, params, seed):
        raise ZeroDivisionError("the gyroscope")


def test_an_error_of_the_object_names_the_rollout_and_the_test(spec, tmp_path):
    with pytest.raises(BackendError, match=naming("'short'", "ZeroDivisionError", "vd", "seed")):
        s2r.check(spec, Raises(), tmp_path, executor=one_thread, **KEYWORDS)


class Machine(Short):
    exclusive, deterministic = True, False


def test_a_machine_whose_process_cannot_import_it_is_refused(spec, tmp_path):
    class Local(Machine):
        pass

    with pytest.raises(UsageError, match=naming("short", "module")):
        s2r.check(spec, Local(), tmp_path, **KEYWORDS)
