"""The controller's law at recorded poses is the law that drove the robot."""

import numpy as np
import pytest

from s2r_turtlebot.effects import turtlebot


@pytest.mark.parametrize("ox", [-0.3, 0.1])
@pytest.mark.parametrize("oy", [-0.4, -0.05, 0.0, 0.15, 0.9])
def test_the_law_gives_the_commands_of_a_rollout(ox, oy):
    test = {"ox": ox, "oy": oy}
    trace = turtlebot().rollout(test, 3)
    law = turtlebot().commands(trace, test)
    for name in ("v", "w"):
        known = np.isfinite(law[name])
        assert known.sum() >= len(trace) - 1
        assert law[name][known] == pytest.approx(trace[name][known], abs=1e-9)


def test_the_law_sees_what_the_sensors_of_the_machine_see():
    test = {"ox": 0.1, "oy": 0.15}
    biased = turtlebot("heading_bias.angle=0.2")
    trace = biased.rollout(test, 3)
    (own, other) = (one.commands(trace, test)["w"] for one in (biased, turtlebot()))
    known = np.isfinite(own)
    assert own[known] == pytest.approx(trace["w"][known], abs=1e-9)
    assert np.abs(other[known] - trace["w"][known]).max() > 0.1
