"""The `twin` backend: simulations of four places, each a named mixture of effects.

They stand in for the places in which the paper ran its robot: a laboratory
floor, grass, sand and a ramp. They are simulations, tuned so that their gap to
the nominal simulator has about the size and the place that the paper reports
for hardware; nothing that was measured on a twin was measured on a robot.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType

from s2r_sim.backend import SimBackend, write_options
from s2r_sim.effects import CATALOGUE
from s2r_spec.effects import Values, choose
from s2r_spec.errors import UsageError, did_you_mean, one_of

PLACES: MappingProxyType[str, Values] = MappingProxyType(
    {
        "lab": {"motor_strength": {"factor": 0.6}, "dry_friction": {"torque": 0.5}, "latency": {"delay": 0.004}},
        "grass": {
            "foot_drag": {"coefficient": 15.0}, "ground_friction": {"factor": 0.625}, "soft_ground": {"sink": 0.02},
        },
        "sand": {
            "foot_drag": {"coefficient": 12.0}, "ground_friction": {"factor": 0.5}, "soft_ground": {"sink": 0.03},
            "shear_creep": {"stiffness": 0.1},
        },
        "ramp": {"slope": {"angle": -4.0}, "attitude_bias": {"pitch": -3.0}, "dry_friction": {"torque": 0.5}},
    }
)  # fmt: skip


@dataclass(frozen=True)
class TwinBackend(SimBackend):
    """A stand-in for the robot in one of four places: ``twin:lab``, ``twin:grass``, ``twin:sand``, ``twin:ramp``.

    It is the same simulator with effects that its traces do not list. Options may
    follow: ``twin:lab,feedback=estimate``.
    """

    place: str = ""

    def __post_init__(self, options: str) -> None:
        """Read the place, and leave the rest to the simulator."""
        place, _, options = options.partition(",") if options or not self.place else (self.place, "", "")
        if place not in PLACES:
            raise UsageError(
                f"there is no twin of a place {place!r}{did_you_mean(place, PLACES)}; there is {one_of(PLACES)}"
            )
        if not self.place:
            object.__setattr__(self, "place", place)
            object.__setattr__(self, "added", choose("sim", CATALOGUE.values(), self.added, PLACES[place]))
        super().__post_init__(options)

    @property
    def name(self) -> str:
        """Name from which ``load_backend`` builds this backend: the place, and the added effects."""
        own = choose("sim", CATALOGUE.values(), (), PLACES[self.place])
        beyond = tuple(effect for effect in self.added if effect not in own)
        return ":".join(("twin", ",".join(filter(None, (self.place, write_options(self.settings, beyond))))))

    def chosen(self) -> dict[str, dict[str, float]]:
        """Return no effects: a twin stands in for a robot, whose differences are unknown."""
        return {}
