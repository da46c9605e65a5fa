"""A Gymnasium environment is certified from a spec and one command."""

from tests.gym.test_gym import SWING_UP

SPEC = """\
signal cos_theta
param  m in [0.9, 1.1]
require upright: always[4 s, 10 s] (cos_theta >= 0.9)
certify upright: delta = 1e-3, epsilon = 0.05, B = 0.5, R = 0.02, kernel = rbf(0.2), fall = -2
"""


def test_a_pendulum_swings_up(s2r):
    (s2r.folder / "pd.py").write_text(SWING_UP)
    words = (
        "check",
        s2r.spec(text=SPEC),
        "-b",
        "gym:Pendulum-v1,policy=pd.py:act",
        "--workers",
        2,
        "--stop",
        "decided",
        "-q",
    )
    (result,) = s2r.json(*words, code=0)["results"]
    assert result["verdict"] == "holds"
