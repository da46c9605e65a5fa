"""The check of a backend, for its author; see :mod:`s2r_spec.testing.conformance`."""

from s2r_spec.base.arrays import FloatArray as FloatArray
from s2r_spec.testing.conformance import EXPLAINED as EXPLAINED
from s2r_spec.testing.conformance import SEED_SHARE as SEED_SHARE
from s2r_spec.testing.conformance import TINY as TINY
from s2r_spec.testing.conformance import check_conformance as check_conformance
from s2r_spec.testing.subject import HALF as HALF
from s2r_spec.testing.subject import SEED as SEED
from s2r_spec.testing.subject import SLACK as SLACK
from s2r_spec.testing.subject import Check as Check
from s2r_spec.testing.subject import Values as Values
