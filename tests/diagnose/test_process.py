"""What a diagnosis leaves of its process, and what it loads."""

import subprocess
import sys

import pytest

import s2r_spec as s2r
from tests.diagnose.toy import Toy

TOY = s2r.parse_spec("param v in [0, 1]\nsignal x {N}\nrequire small: always[0, 0.9 s] (abs(x) <= 2 {N})")


def test_linear_algebra_has_one_thread_and_gives_the_others_back(tmp_path, monkeypatch):
    import scipy.linalg  # noqa: F401
    from threadpoolctl import threadpool_info, threadpool_limits

    class ReachedError(Exception):
        pass

    def threads():
        return [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]

    def reached(*_, **__):
        raise ReachedError(threads())

    with threadpool_limits(2):
        before = threads()
        for name in ("library", "estimate"):
            with monkeypatch.context() as patched:
                patched.setattr(sys.modules["s2r_spec.diagnose.run"], name, reached)
                with pytest.raises(ReachedError) as error:
                    s2r.diagnose(TOY, Toy(), Toy(), 10, cache=tmp_path)
            assert set(error.value.args[0]) == {1}
        assert threads() == before


def test_the_diagnosis_cannot_see_a_label():
    code = "import s2r_spec.diagnose.run, sys; print(' '.join(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not [name for name in done.stdout.split() if name.startswith("benchmarks")]
