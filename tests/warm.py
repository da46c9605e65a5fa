"""What most commands import and make before anything else: preloaded, see :mod:`tests.forked`."""

import gpytorch  # noqa: F401
import numba  # noqa: F401

import s2r_spec.certify.check
import s2r_spec.cli
import s2r_spec.report.html  # noqa: F401
from s2r_spec.spec import parse_spec

parse_spec("signal x {m/s}\nparam p {rad} in [0, 1]\nrequire r: always[0 s, 1 s] (x <= 1 {m/s})\n")
