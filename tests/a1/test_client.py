"""A rollout without a guard that was armed: no rollout, and a sentence."""

import pytest

from s2r_a1.backend import A1Backend
from s2r_spec.errors import NotBegunError, UsageError

TWIN = "host=127.0.0.1,velocity=onboard,operator=auto,clock=lockstep"


def test_without_a_guard_nothing_begins(monkeypatch, tmp_path):
    monkeypatch.setenv("S2R_A1_RUN", str(tmp_path))
    with pytest.raises(NotBegunError, match="guard"):
        A1Backend(TWIN).rollout({"vd": 0.1}, 0)
    assert not list(tmp_path.glob("**/*.a1log"))


def test_a_test_that_no_robot_can_do_is_refused_before_anything_is_opened(monkeypatch):
    monkeypatch.setenv("S2R_A1_RUN", "/nowhere")
    with pytest.raises(UsageError, match="friction"):
        A1Backend(TWIN).rollout({"friction": 0.5}, 0)
    with pytest.raises(UsageError, match="vd"):
        A1Backend(TWIN).rollout({"vd": 5.0}, 0)
