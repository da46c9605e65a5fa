"""What is left of a machine that the improved simulator does not do, and where.

A cause that the catalogue lacks is imitated by its members in everything that is a mean over a rollout; at one place,
in one window of time or above one voltage it is not. So what a machine does is averaged over cells (:mod:`.cells`), and
so is what the simulator with the posterior means of all effects does at the same tests. Their difference is compared
with what is allowed for: scatter, laws that are off, a little of everything, and other numerics (:mod:`.channels`).
"""

from s2r_spec.diagnose.remainder.find import remainders
from s2r_spec.diagnose.remainder.found import Remainder

__all__ = ["Remainder", "remainders"]
