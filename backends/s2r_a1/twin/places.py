"""The environments of a robot's twin: the places of the backend `twin`, and one without effects."""

from __future__ import annotations

from s2r_sim.effects import CATALOGUE, with_effects
from s2r_sim.plant.physics import Physics
from s2r_sim.twins import PLACES as _TWINS
from s2r_spec.effects import choose
from s2r_spec.errors import UsageError, did_you_mean, one_of

NOMINAL = "nominal"
"""A definition: the environment with the plant of the backend `sim`."""
PLACES = (NOMINAL, *_TWINS)


def physics(place: str) -> Physics:
    """Return the physics of an environment; raise UsageError if there is no such environment."""
    if place not in PLACES:
        raise UsageError(
            f"there is no twin of a place {place!r}{did_you_mean(place, PLACES)}; use one of {one_of(PLACES)}"
        )
    return (
        Physics()
        if place == NOMINAL
        else with_effects(Physics(), choose("sim", CATALOGUE.values(), (), _TWINS[place]))
    )
