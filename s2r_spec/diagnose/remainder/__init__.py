"""What is left of a machine that no effect leaves of the improved simulator, and where.

A cause that the catalogue lacks is imitated by its members in everything that is a mean over a rollout; at one
place, in one window of time or above one voltage it is not. So what a machine does is averaged over cells (`cells`),
and so is what the simulator does that has the likeliest effects and a little of all others, at the same tests. Their
difference is held against what is allowed for: scatter, laws that are off, a little of everything, and other
numerics. That is done of all that is recorded (`channels`) and, where the nominal model has residuals that know the
effects, of what its equations of motion leave of these (`motion`).
"""

from s2r_spec.diagnose.remainder.find import remainders
from s2r_spec.diagnose.remainder.found import Remainder

__all__ = ["Remainder", "remainders"]
