"""Every stage of a diagnosis has a name before its first rollout, and a count while it runs."""

import pytest
from s2r_cart import SPEC, Cart, Machine

import s2r_spec as s2r
from s2r_spec.diagnose.simulator.bench import Bench, Job, run_jobs
from s2r_spec.diagnose.watched import Watched

BENCH = Bench.of(s2r.parse_spec(SPEC), "tracking", Cart())
TEST = {"vd": 0.5, "acc": 2.0}


class Short(Cart):
    """A cart whose catalogue has two effects."""

    def effects(self):
        return tuple(e for e in super().effects() if e.name in ("tilt", "viscous"))


def test_rollouts_of_a_stage_without_a_count_are_told():
    progress = []
    tell = Watched(lambda *now: progress.append(now))
    jobs = [Job({}, ((TEST, seed), (TEST, seed + 1))) for seed in range(3)]
    with tell.watching():
        tell("fitting", 0, 0)
        run_jobs(BENCH, jobs)
        tell("where", 1, 30)
        run_jobs(BENCH, jobs)
    run_jobs(BENCH, jobs)
    assert progress == [("fitting", n, 0) for n in (0, 2, 4, 6)] + [("where", 1, 30)]


def test_a_diagnosis_names_its_stages_and_counts_to_the_end_of_each(tmp_path):
    progress = []
    s2r.diagnose(
        s2r.parse_spec(SPEC),
        Short(),
        Machine(),
        9,
        cache=tmp_path,
        progress=lambda *now: progress.append(now),
    )
    stages = list(dict.fromkeys(stage for stage, _, _ in progress))
    assert stages[:3] == ["trying each effect", "simulating every effect", "real rollouts"]
    assert {"estimating sizes", "gap before and after", "unexplained motion", "where"} <= set(stages)
    for stage in stages:
        counts = [(done, of) for name, done, of in progress if name == stage]
        assert all(done <= of for done, of in counts if of)
        assert [done for done, _ in counts] == sorted(done for done, _ in counts)
        assert counts[-1][1] == 0 or counts[-1][0] == counts[-1][1]
    # A diagnosis that finds its library tells nothing of it.
    progress.clear()

    def until_the_estimate(*now):
        progress.append(now)
        if now[0] == "estimating sizes":
            raise InterruptedError

    with pytest.raises(InterruptedError):
        s2r.diagnose(s2r.parse_spec(SPEC), Short(), Machine(), 9, cache=tmp_path, progress=until_the_estimate)
    assert "simulating every effect" not in {stage for stage, _, _ in progress}
