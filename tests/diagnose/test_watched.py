"""Every stage of a diagnosis has a name before its first rollout, and a count while it runs."""

from s2r_cart import SPEC, Cart

import s2r_spec as s2r
from s2r_spec.diagnose import bank as banks
from s2r_spec.diagnose.axes import lines
from s2r_spec.diagnose.simulate import Bench
from s2r_spec.diagnose.simulate import Job, run_jobs
from s2r_spec.diagnose.watched import Watched

BENCH = Bench.of(s2r.parse_spec(SPEC), "tracking", Cart())
TEST = {"vd": 0.5, "acc": 2.0}


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


def test_a_bank_says_what_it_does_before_its_first_rollout(monkeypatch):
    progress, ran = [], []
    rollout = Cart.rollout

    def counted(self, params, seed):
        ran.append(len(progress))
        return rollout(self, params, seed)

    few = lines(Cart().effects()[:1])
    monkeypatch.setattr(banks, "lines", lambda *_: few)
    monkeypatch.setattr(Cart, "rollout", counted)
    banks.simulate(BENCH, progress=lambda *now: progress.append(now))
    assert ran[0] > 0
    assert progress[0][0] == "trying each effect"
    assert progress[-1][0] == "simulating effects"
    assert progress[-1][1] == progress[-1][2]
