"""What the A1's protocols are, in words and figures; :mod:`s2r_sim.protocols.references` has their motions."""

from __future__ import annotations

from s2r_spec.backend import Parameter
from s2r_spec.protocols import Place, Protocol

AMPLITUDE = Parameter("amplitude", "", 0.25, 1.0, 1.0, "amplitude, as a share of the full one")
GAIN = Parameter(
    "gain", "", 0.5, 2.0, 1.0, "factor on the stiffness of the joints; damping follows its square root"
)

HELD = "The base is held above the ground, so that no foot touches it."
SLIPS = "feet slip and may wear; the gears take sudden loads"

_COST = 0.08
"""[s] time of one core per simulated second, measured on a 2-core cloud machine."""


def _protocol(name: str, words: str, place: Place, duration: float, risk: str = "") -> Protocol:
    return Protocol(name, words, place, duration, _COST * duration, risk, (AMPLITUDE, GAIN))


PROTOCOLS = (
    _protocol("air_sine", f"{HELD} Every joint follows two sines of 1.3 to 8 Hz.", "air", 2.0),
    _protocol("air_coast", f"{HELD} The legs move out; after 0.6 s the motors are off.", "air", 0.9, "the legs drop"),
    _protocol(
        "air_low",
        "The base is held so low that the feet swing 3 cm above the ground, each at its own rate.",
        "air",
        1.6,
        "a foot may touch an uneven ground",
    ),
    _protocol("squat", "The robot stands and moves its base up and down by 35 mm.", "ground", 2.0),
    _protocol("sway", "The robot stands and moves its base forward by 45 mm and its hips to the side.", "ground", 2.0),
    _protocol("squeeze", "The robot stands and pushes its hips outward until the feet slip.", "ground", 1.9, SLIPS),
    _protocol("hold", "The robot stands low for ten seconds, so that its motors carry load.", "ground", 10.0,
              "the motors get warm"),
)  # fmt: skip
"""Every protocol, in the order of a campaign: those in the air first."""
