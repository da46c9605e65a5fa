"""How large the effects of a set are, with a little of everything else beside them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.asked import Heard
from s2r_spec.diagnose.catalogue import Catalogue
from s2r_spec.diagnose.estimate import COVER, Sized, by_linear
from s2r_spec.diagnose.evidence import ALLOWED, FORM, Set
from s2r_spec.diagnose.joint import Joint, joint_fit, misfit, polished, reach, rephased
from s2r_spec.diagnose.models import Part
from s2r_spec.diagnose.prepare import State
from s2r_spec.diagnose.together import Together

FloatArray = NDArray[np.float64]

WIDE = 3.0
"""Standard deviation of a named effect, in parts of its typical size, once its value is all that is asked for."""
PULLED = 4.0
"""Mean square of the other effects' coordinates, in units of what is allowed, from which on they are not a little."""
LESS, AT_MOST = 4.0, 256.0
"""Then the data are believed so many times less, and again; up to the second."""


def sized(state: State, weighed: Together, members: Set) -> Sized:
    """Return where a set fits best, the set being given."""
    found = weighed.fits.get(members) or state.beside(members)
    if state.wide is not None:
        # Names are told apart by data that are believed nearer than usual; a law that is not ours moves values by more.
        state = state.wide
        found = state.beside(members, found)
    usual = state.view.variance if state.usual is None else state.usual
    warmth, free = state.temperature, found.at
    if members:
        state, found = _with_a_little(state, members, found)
    deviation = by_linear(state.data, members, state.temperature).deviation
    best = Sized(found.at, deviation, free=None if found.at is free else free)
    if not members:
        return best
    if not state.simulator.dear:
        return _looked(state, members, best)
    heard = state.heard
    names = state.view.surrogate.catalogue.effects
    deaf = tuple(k for k in members if heard is None or names[k] not in heard.effects)
    if deaf:
        best = _looked(state, deaf, best)
    # A closed loop is off as a whole: by the part of itself up to which a number is believed, times the roots of how
    # many numbers count as one and of what the fit leaves of them in units of what is believed.
    left = misfit(found.rest, usual, state.view.nuisances)
    doubt = FORM * np.sqrt(warmth * left)
    best = replace(best, deviation=np.hypot(best.deviation, doubt * best.at))
    return best if heard is None or len(deaf) == len(members) else _told(state, members, best, found, heard)


def pulled(catalogue: Catalogue, members: Set, at: FloatArray) -> float:
    """Return the mean square of all other effects' coordinates (K,), in units of what is allowed."""
    others = ~np.isin(catalogue.owner, members) & ~catalogue.based
    return float(((at[others] / ALLOWED) ** 2).mean()) if others.any() else 0.0


def _with_a_little(state: State, members: Set, found: Joint) -> tuple[State, Joint]:
    """Believe the data less until no more than a little of everything else is asked for beside the set.

    What no effect of the catalogue explains is shared out among all that can imitate some of it, and the named ones
    would lose most of their size to the others.
    """
    times = 1.0
    while times < AT_MOST and pulled(state.view.surrogate.catalogue, members, found.at) > PULLED:
        times *= LESS
        state = state.believed_less(LESS)
        found = state.beside(members, found)
    return state, found


def _looked(state: State, effects: Set, best: Sized) -> Sized:
    """Put the coordinates of these effects right by looks along their lines, the others held."""
    view = state.view
    part = Part(state.simulator, effects, best.at)
    known = (view.data, view.variance, view.nuisances)
    begin = best.at[part.lines]
    if state.simulator.dear:
        return replace(best, at=part.all(polished(part, *known, begin, WIDE)))
    at = polished(part, *known, rephased(part, *known, begin, WIDE), WIDE)
    near = COVER**2 * state.temperature
    based = np.flatnonzero(part.based).tolist()
    ends = {int(part.lines[k]): reach(part, *known, at, k, near) for k in based}
    return replace(best, at=part.all(at), ends=ends)


def _told(state: State, members: Set, best: Sized, found: Joint, heard: Heard) -> Sized:
    """Let the equations of motion say how large these effects are, and fit a little of all others beside them."""
    view, catalogue = state.view, state.view.surrogate.catalogue
    lines = np.flatnonzero(np.isin(catalogue.owner, members) & ~catalogue.based)
    chosen = [catalogue.effects[k] for k in members]

    def simulated(x: FloatArray) -> FloatArray:
        alone = np.zeros_like(best.at)
        alone[catalogue.based] = best.at[catalogue.based]
        alone[lines] = x
        return state.simulator.row_change(alone)

    weights = state.simulator.weights()
    size, covariance = heard.sized(chosen, best.at[lines], best.deviation[lines] ** 2, simulated, weights)
    at, deviation = best.at.copy(), best.deviation.copy()
    at[lines], deviation[lines] = size, np.sqrt(np.diag(covariance))
    others = [k for k in range(len(catalogue.effects)) if k not in members]
    rest = Part(state.simulator, others, at)
    little = joint_fit(
        rest,
        view.data,
        view.variance,
        view.nuisances,
        at[rest.lines],
        found.jacobian[rest.lines],
        ALLOWED,
        exact=True,
    )
    return replace(best, at=rest.all(little.at), deviation=deviation)
