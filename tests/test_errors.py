"""An error that a worker process raises reaches the user as it was raised."""

import pickle

import pytest

from s2r_spec.errors import MissingPackageError, NoTimesError, UnknownBackendError, UsageError
from s2r_spec.lang.diagnostics import SpecError
from s2r_spec.spec import parse_spec


def of_a_spec():
    with pytest.raises(SpecError) as caught:
        parse_spec("signal vx {m/s}\nrequire walking: always (vy > 0)")
    return caught.value


@pytest.mark.parametrize(
    "error",
    [
        UsageError("no test"),
        UnknownBackendError("smi", ["sim", "log"]),
        MissingPackageError("sim", "mujoco"),
        NoTimesError("no column t", "time"),
        of_a_spec(),
    ],
    ids=lambda error: type(error).__name__,
)
def test_an_error_survives_the_way_from_a_worker(error):
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is type(error)
    assert str(again) == str(error)
    assert vars(again) == vars(error)
    assert again.exit_code == error.exit_code
