"""The twins: named places, found by name, each a simulation of its own; and options of the backend."""

import pytest

from s2r_sim import SimBackend, TwinBackend
from s2r_sim.effects import CATALOGUE
from s2r_sim.twins import PLACES
from s2r_spec.backend import Backend, HasDuration, load_backend
from s2r_spec.errors import UsageError
from tests.errors import naming


@pytest.mark.parametrize("place", PLACES)
def test_a_twin_is_a_backend_that_does_not_say_what_is_different(place):
    twin = TwinBackend(place).with_duration(0.1)
    assert isinstance(twin, Backend)
    assert isinstance(twin, HasDuration)
    assert twin.name == f"twin:{place}"
    trace = twin.rollout({"vd": 0.3}, 0)
    assert trace.meta["backend"] == twin.name
    assert "effects" not in trace.meta
    assert (trace["vx"] != SimBackend(duration=0.1).rollout({"vd": 0.3}, 0)["vx"]).any()


def test_places_are_made_of_the_catalogue_and_differ_in_their_hash():
    assert all(set(effects) <= set(CATALOGUE) for effects in PLACES.values())
    hashes = {TwinBackend(place).model_hash for place in PLACES} | {SimBackend().model_hash}
    assert len(hashes) == 5


def test_a_twin_keeps_its_place_when_it_is_made_longer_and_takes_options():
    twin = TwinBackend("sand,feedback=estimate").with_duration(2.0)
    assert twin.added == TwinBackend("sand").added
    assert twin.settings.feedback == "estimate"
    assert twin.name == "twin:sand,feedback=estimate"


@pytest.mark.parametrize("text", ["", "beach"])
def test_an_unknown_place_is_refused_with_the_known_ones(text):
    with pytest.raises(UsageError, match=naming(f"'{text}'", "grass, lab, ramp, sand")):
        TwinBackend(text)


def test_options_are_read_from_the_name():
    backend = SimBackend("feedback=estimate,form=full")
    assert (backend.settings.feedback, backend.settings.form) == ("estimate", "full")
    assert backend.name == "sim:feedback=estimate,form=full"
    assert backend.model_hash != SimBackend().model_hash


@pytest.mark.parametrize(
    "backend",
    [
        SimBackend(),
        SimBackend("feedback=estimate").with_effects(
            {"payload": {"mass": 1.3, "x": 0.1}, "slope": {"angle": 2.0}}
        ),
        TwinBackend("lab"),
        TwinBackend("ramp,feedback=estimate").with_effects({"payload": {"mass": 1.0}}),
    ],
    ids=lambda backend: backend.name,
)
def test_a_backend_is_found_again_by_its_name(backend):
    again = load_backend(backend.name)
    assert again == backend
    assert again.with_duration(0.1).name == backend.name


def test_effects_may_be_given_in_the_name():
    by_name = SimBackend("latency.delay=0.004,payload.mass=1")
    assert by_name == SimBackend().with_effects({"payload": {"mass": 1.0}, "latency": {"delay": 0.004}})
    assert (
        by_name.with_effects({"latency": {"delay": 0.008}}).name == "sim:latency.delay=0.008,payload.mass=1.0"
    )


@pytest.mark.parametrize(
    ("text", "facts"),
    [
        ("feedbak=truth", ["'feedbak'", "did you mean 'feedback'", "form"]),
        ("latency.dely=0.1", ["'latency'", "'dely'", "did you mean 'delay'"]),
        ("latency.delay=soon", ["latency.delay=soon", "'soon'"]),
        ("feedback=guess", ["feedback", "'guess'", "estimate, truth"]),
    ],
)
def test_a_bad_option_is_refused_with_the_valid_ones(text, facts):
    with pytest.raises(UsageError, match=naming(*facts)):
        SimBackend(text)
