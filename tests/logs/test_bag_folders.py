"""``log:FOLDER`` with bags: recordings, certificate and diagnosis are those of the backend that made the bags."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from s2r_cart import SPEC as CART

import s2r_spec as s2r_package
from s2r_spec.base.verdict import Verdict
from s2r_spec.certify.real_machine import certify
from s2r_spec.errors import TraceError, UsageError
from s2r_spec.recordings.log_folder import LogError
from s2r_spec.recordings.recorded import LogBackend
from tests.cli.conftest import FINE
from tests.cli.conftest import s2r as s2r  # the command line in a folder of its own
from tests.errors import states
from tests.logs.robot_logs import bag_of

pytestmark = pytest.mark.filterwarnings("ignore::s2r_spec.errors.TraceNote")

READ = "map=vx=/vx.data&clock=vx"
CUT = f"{READ}&map=on=/on.data&when=on > 0.5&duration=1.5&param=vd=/vd.data@0"
SPEEDS = [vd / 40 for vd in range(-8, 13) for _ in range(4)]


@pytest.fixture
def rollouts(toy):
    machine = s2r_package.load_backend("toy:drag")
    return [({"vd": vd}, machine.rollout({"vd": vd}, 3000 + k).only(["vx"])) for k, vd in enumerate(SPEEDS)]


def same(recordings, rollouts):
    for recording, (params, trace) in zip(recordings, rollouts, strict=True):
        assert dict(recording.params) == params
        np.testing.assert_allclose(recording.trace.times, trace.times, atol=1e-9)
        np.testing.assert_array_equal(recording.trace["vx"], trace["vx"])


def test_episodes_of_long_bags_are_the_rollouts(rollouts, tmp_path):
    for number in range(3):
        bag_of(rollouts[28 * number : 28 * (number + 1)], tmp_path / f"bag{number}")
    backend = LogBackend(f"{tmp_path}?{CUT}")
    same(backend.recordings, rollouts)
    (assumption,) = backend.assumptions
    assert states(assumption, "84 episodes", "3 logs", "on > 0.5")


def test_a_bag_for_each_rollout_takes_its_test_from_a_topic_or_from_the_table(rollouts, tmp_path):
    few = rollouts[::40]
    rows = ["id,vd [m/s]"]
    for number, one in enumerate(few):
        bag_of([one], tmp_path / f"run{number}")
        rows.append(f"run{number},{one[0]['vd']!r}")
    cut = "map=on=/on.data&when=on > 0.5&duration=1.5"
    same(LogBackend(f"{tmp_path}?{READ}&{cut}&param=vd=/vd.data@0").recordings, few)
    (tmp_path / "rollouts.csv").write_text("\n".join(rows) + "\n")
    same(LogBackend(f"{tmp_path}?{READ}&{cut}").recordings, few)
    with pytest.raises(LogError, match="vd"):
        LogBackend(f"{tmp_path}?{READ}&{cut}&param=vd=/vd.data@0")
    (tmp_path / "run0").rename(tmp_path / "other")
    with pytest.raises(LogError, match="line 2"):
        LogBackend(f"{tmp_path}?{READ}&{cut}")


def test_a_folder_of_bags_without_any_word_on_their_tests_is_refused(rollouts, tmp_path):
    bag_of(rollouts[:2], tmp_path / "bag")
    with pytest.raises(UsageError, match=r"rollouts\.csv"):
        LogBackend(f"{tmp_path}?{READ}")
    with pytest.raises(UsageError, match="duration"):
        LogBackend(f"{tmp_path}?{READ}&map=on=/on.data&when=on > 0.5&param=vd=/vd.data@0")
    with pytest.raises(TraceError, match="/speed"):
        LogBackend(f"{tmp_path}?{CUT}".replace("/vd.data", "/speed.data"))


def recorded(rollouts, folder):
    """Write rollouts as files with a table of tests."""
    folder.mkdir()
    rows = ["id,vd [m/s]"]
    for number, (params, trace) in enumerate(rollouts):
        s2r_package.write_trace(trace, folder / f"{number:03}.npz")
        rows.append(f"{number:03},{params['vd']!r}")
    (folder / "rollouts.csv").write_text("\n".join(rows) + "\n")
    return f"log:{folder}"


def test_the_certificate_from_bags_is_that_of_the_live_rollouts(rollouts, tmp_path):
    bag_of(rollouts, tmp_path / "night" / "bag")
    spec = s2r_package.parse_spec(FINE.replace("LIMIT", "0.15"))
    results = [
        certify(spec, "toy", real, tmp_path / str(number), executor=lambda: ThreadPoolExecutor(1))
        for number, real in enumerate([recorded(rollouts, tmp_path / "live"), f"log:{tmp_path}/night?{CUT}"])
    ]
    live, bags = results
    assert live.verdict is bags.verdict is Verdict.HOLDS
    assert bags.composition.lower == pytest.approx(live.composition.lower, abs=1e-9)
    assert bags.composition.upper == pytest.approx(live.composition.upper, abs=1e-9)
    assert any("84 episodes" in sentence for sentence in bags.gap.assumptions)


def test_the_commands_pass_the_options_on(rollouts, s2r):
    bag_of(rollouts, s2r.folder / "night" / "bag")
    spec = s2r.spec(0.15, FINE)
    read = ["-m", "vx=/vx.data", "-m", "on=/on.data", "--clock", "vx", "-p", "vd=/vd.data@0", "--when"]
    checked = s2r.json("check", spec, "-b", "log:night", *read, "on > 0.5", "-q", code=0)["results"][0]
    assert checked["search"]["rollouts"] == len(rollouts)
    assert any("84 episodes" in sentence for sentence in checked["assumptions"])
    assert "log:" in s2r("check", spec, "-b", "toy", "--when", "on > 0.5", code=2).stderr


@pytest.mark.slow  # beside it, the recordings are held equal to the rollouts
def test_the_diagnosis_from_bags_is_that_of_the_live_rollouts(tmp_path, cache, toy):
    machine = s2r_package.load_backend("cart:real.coulomb=1.5")
    tests = [{"vd": vd, "acc": acc} for vd in (0.3, 0.5, 0.7, 0.9) for acc in (1.0, 2.5)]
    rollouts = [(test, machine.rollout(test, seed)) for seed, test in enumerate(tests)]
    bag_of(rollouts, tmp_path / "bag")
    channels = "&".join(f"map={name}=/{name}.data" for name in rollouts[0][1].channels)
    first = next(iter(rollouts[0][1].channels))
    duration = rollouts[0][1].duration
    text = f"log:{tmp_path}?{channels}&map=on=/on.data&clock={first}&when=on > 0.5&duration={duration}"
    bags = s2r_package.load_backend(f"{text}&param=vd=/vd.data@0&param=acc=/acc.data@0")
    spec = s2r_package.parse_spec(CART)
    found = [s2r_package.diagnose(spec, "cart", real, cache=cache, where=False) for real in (rollouts, bags)]
    assert found[0].verdict is found[1].verdict
    assert found[0].which.answer == found[1].which.answer
    for effect, values in found[0].patch.items():
        assert found[1].patch[effect] == pytest.approx(values, rel=1e-6)
