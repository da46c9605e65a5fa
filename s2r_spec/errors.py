"""The errors that s2r raises on purpose, for backends and for ``except``; see :mod:`s2r_spec.base.errors`."""

from s2r_spec.base.errors import LONGEST_NAME as LONGEST_NAME
from s2r_spec.base.errors import MOST_NAMES as MOST_NAMES
from s2r_spec.base.errors import BackendError as BackendError
from s2r_spec.base.errors import ErrorCode as ErrorCode
from s2r_spec.base.errors import MissingPackageError as MissingPackageError
from s2r_spec.base.errors import NotBegunError as NotBegunError
from s2r_spec.base.errors import NoTimesError as NoTimesError
from s2r_spec.base.errors import S2RError as S2RError
from s2r_spec.base.errors import SamplingError as SamplingError
from s2r_spec.base.errors import StoppedError as StoppedError
from s2r_spec.base.errors import TraceError as TraceError
from s2r_spec.base.errors import TraceNote as TraceNote
from s2r_spec.base.errors import UndecidedError as UndecidedError
from s2r_spec.base.errors import UnknownBackendError as UnknownBackendError
from s2r_spec.base.errors import UsageError as UsageError
from s2r_spec.base.errors import did_you_mean as did_you_mean
from s2r_spec.base.errors import not_installed as not_installed
from s2r_spec.base.errors import one_of as one_of
from s2r_spec.base.errors import require as require
from s2r_spec.base.errors import shortened as shortened
from s2r_spec.base.errors import suggest as suggest
