"""From real rollouts to probabilities of sets of effects: everything that is the same for every question."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from importlib.metadata import version
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from s2r_spec.backend import Backend, Effect, HasDuration, load_backend
from s2r_spec.diagnose import bank as banks
from s2r_spec.diagnose import judge as judges
from s2r_spec.diagnose.ask import refuse_machine
from s2r_spec.diagnose.asked import Heard
from s2r_spec.diagnose.cache import Cache
from s2r_spec.diagnose.catalogue import Catalogue
from s2r_spec.diagnose.evidence import (
    ALLOWED,
    LARGE,
    Evidence,
    Linear,
    Set,
    believed,
    evidence,
    ground,
    linear,
    posterior,
    solved,
)
from s2r_spec.diagnose.joint import (
    PLACES,
    SOME,
    Joint,
    Model,
    joint_fit,
    misfit,
    seen_through,
)
from s2r_spec.diagnose.judge import Judge, Sets, describe, temperature
from s2r_spec.diagnose.layout import SHOTS, Layout, functions
from s2r_spec.diagnose.models import Part, Simulator, nominal_rows
from s2r_spec.diagnose.signatures import LEVEL, Signatures
from s2r_spec.diagnose.simulate import Bench
from s2r_spec.diagnose.told import log_evidence
from s2r_spec.diagnose.training import train
from s2r_spec.diagnose.view import View
from s2r_spec.effects import catalogue_of
from s2r_spec.errors import BackendError
from s2r_spec.rollouts.compatibility import check_compatibility
from s2r_spec.spec import Spec
from s2r_spec.trace import Trace

FloatArray = NDArray[np.float64]
Progress = Callable[[str, int, int], None]

SOURCES = (
    "axes", "catalogue", "classifiers", "design", "evidence", "joint", "judge", "layout", "logs", "models", "practice",
    "signatures", "training",
)  # fmt: skip
"""Modules on which a judge depends."""
ELSEWHERE = 0.3
"""A coordinate by which the bank's best value of an effect lies elsewhere than the fit, so that both are tried."""
MOSTLY = 0.5
"""An effect that alone explains more than this part of the data is where the joint fit starts."""
TREND = 0.7
"""Where a few functions of the test hold less than this part of the data, every test is seen by itself."""
AT_MOST = 1.5
"""Times its variance that scatter may have: it is known from few replicates, or from the simulator."""
FREE = 5
"""Degrees of freedom from which on replicates say how much a machine scatters."""
WILDEST = 50.0
"""A machine that scatters by more times than this still has its tests weighed as if it did not."""
UNSTEADY = 4.0
"""Scatter, in units of the nominal one's, from which on a look at a dear simulator is the mean of several rollouts."""
FAITHFUL = 2.0
"""The bank stands for a dear simulator where its own fit leaves no more than this of the data, in units of what is
believed: then a fit of everything by the simulator, which takes minutes, changes hardly a name."""
TRIED = 3
"""Sets that are fitted alone at first, to begin where the best of them is."""
FURTHER = 2
"""Effects that are tried with what a fit leaves, those that could explain most of it."""
WORTH = 0.1
"""Part of what it leaves that an effect must explain to be tried."""
LEFT = 0.3
"""What the best of the likeliest sets should leave of the data, in units of what is believed."""
LEAST = 0.03
"""Part of the usual variance that is believed at least."""
DISTRUSTED = (1.0, 2.0, 4.0, 8.0)
"""Multiples of the usual error that the equations' coordinates may have."""
USUALLY = 10.0
"""Degrees of freedom that it is worth that all numbers scatter by the same multiple of the simulator's scatter."""


@dataclass(frozen=True)
class State:
    """What one set of real rollouts gives rise to."""

    signatures: Signatures
    smooth: View
    """Through a few functions of the test: what the networks know, and what isolability is of."""
    view: View
    """What is fitted: the same, or every test by itself where rollouts are cheap enough."""
    judge: Judge
    data: Linear
    found: Evidence
    memberships: FloatArray | None
    """Votes of the networks; None where they abstain."""
    sets: Sets
    unknown: float
    simulator: Simulator
    fitted: Joint
    temperature: float
    reached: Mapping[int, float] = field(default_factory=dict)
    """Lines that do nothing near nominal → the coordinate at which they explain most of what the fit leaves."""

    wide: State | None = None
    """The same as the data are usually believed, where they are believed nearer than that: for values."""

    tried: Mapping[Set, Joint] = field(default_factory=dict)
    """Sets → fits to the same data, believed otherwise: where the next ones start."""

    heard: Heard | None = None
    """What the equations of motion ask for, if they do."""

    usual: FloatArray | None = None
    """(q, k) variance of the data as it is believed of any simulator, where they are believed otherwise."""

    by_bank: bool = False
    """Whether the bank stands for the simulator, which is then asked of the few likeliest sets alone."""

    @property
    def nominal_rho(self) -> FloatArray:
        """Return (rollouts,) mean ρ of the nominal simulator at the test of each real rollout."""
        return self.simulator.nominal_rho[self.smooth.layout.place]

    @property
    def count(self) -> float:
        """How many numbers the data are, for the temperature."""
        return _counted(self.view, self.smooth)

    @property
    def astray(self) -> bool:
        """Whether the fit of everything leaves more than is believed possible: it is no place to look from."""
        return self.fitted.misfit > 1.0

    @property
    def ground(self) -> FloatArray:
        """Return (K,) coordinates of no effect at all, each acting as it does in the fit."""
        return np.where(self.view.surrogate.catalogue.based, self.fitted.at, 0.0)

    def believed_less(self, times: float) -> State:
        """Return the same, its data believed so many times less, all numbers together."""
        view = replace(self.view, variance=times * self.view.variance)
        return replace(
            self,
            view=view,
            data=self.data.believed_less(times),
            temperature=max(self.temperature / times, 1.0),
        )

    def beside(self, effects: Sequence[int], near: Joint | None = None) -> Joint:
        """Return the best fit with these effects as causes, and of all others no more than a little each.

        ``near`` is another such fit, to start from as well; a dear simulator starts where these effects alone fit best.
        """
        catalogue, view = self.view.surrogate.catalogue, self.view
        mean, _ = posterior(self.data, effects)
        mine = np.isin(catalogue.owner, effects)
        begin = np.clip(self.data.around + mean, catalogue.lower, catalogue.upper)
        starts = [(begin, self.fitted.jacobian)] + ([(near.at, near.jacobian)] if near else [])
        if self.simulator.dear and effects:
            before = self.tried.get(tuple(effects))
            starts = [(before.at, before.jacobian) if before else self._alone(effects, begin)]
        elif len(effects) == 1:
            # A phase has more than one valley, and a limit that is not reached no slope: also start from the bank.
            others = np.where(mine | catalogue.based, 0.0, begin)
            rest = view.data - np.tensordot(others, self.fitted.jacobian, 1)
            turned = view.surrogate.turned(rest, view.variance)
            found, _ = view.surrogate.scanned(rest, view.variance, effects[0], turned)
            there = np.where(mine, found, begin)
            if np.abs(there - begin)[mine].max() > ELSEWHERE:
                slopes = np.where(mine[:, None, None], view.surrogate.jacobian(there), self.fitted.jacobian)
                starts.append((there, slopes))
        spread = np.where(mine, LARGE, ALLOWED)
        if limits := [line for line in self.reached if mine[line]]:
            if self.astray:  # each was asked alone
                limits = limits[:1]
            there = self.ground if self.astray else begin.copy()
            there[limits] = [self.reached[line] for line in limits]
            slopes = self.fitted.jacobian.copy()
            only = np.array(limits, dtype=np.intp)
            slopes[only] = self.simulator.jacobian(there, only)[only]
            starts.append((there, slopes))
        fits = [
            joint_fit(
                self.simulator,
                view.data,
                view.variance,
                view.nuisances,
                at,
                slopes,
                spread,
                exact=True,
            )
            for at, slopes in starts
        ]
        return min(fits, key=lambda fit: fit.cost)

    def _alone(self, effects: Sequence[int], begin: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return where these effects fit best with no other, and derivatives there: the simulator's own for them."""
        view = self.view
        part = Part(self.simulator, effects, np.zeros_like(begin))
        first = view.surrogate.jacobian(begin)[part.lines]
        found = joint_fit(part, view.data, view.variance, view.nuisances, begin[part.lines], first, LARGE)
        at = part.all(found.at)
        slopes = view.surrogate.jacobian(at)
        slopes[part.lines] = found.jacobian
        return at, slopes

    def missing(self, rest: FloatArray, members: Sequence[int]) -> list[int]:
        """Return the effects that could explain most of what a fit leaves, over all of their range by the bank."""
        view = self.view
        turned = view.surrogate.turned(rest, view.variance)
        gains = {
            k: view.surrogate.scanned(rest, view.variance, k, turned)[1]
            for k in range(len(self.judge.effects))
            if k not in members
        }
        return [k for k in sorted(gains, key=lambda k: -gains[k])[:FURTHER] if gains[k] > WORTH]


def bench_of(spec: Spec, requirement: str, sim: Backend | str) -> Bench:
    """Set a spec up on a simulator.

    Raises:
        UsageError: the simulator declares no effects, or lacks what the spec needs.
    """
    backend = load_backend(sim) if isinstance(sim, str) else sim
    refuse_machine(backend)
    horizon = spec.horizon(requirement)
    if isinstance(backend, HasDuration) and math.isfinite(horizon) and horizon > 0:
        backend = backend.with_duration(horizon)
    _of_different_names(backend.name, catalogue_of(backend))
    return Bench(backend, spec, requirement, check_compatibility(spec, requirement, backend))


def _of_different_names(backend: str, effects: Sequence[Effect]) -> None:
    """Refuse a catalogue in which a name stands for two things.

    Raises:
        BackendError: it does.
    """
    names = [effect.name for effect in effects]
    of_one = [(effect.name, [p.name for p in effect.parameters]) for effect in effects]
    for what, among in [
        ("effects", names),
        *((f"parameters of the effect {name!r}", of) for name, of in of_one),
    ]:
        if twice := [name for n, name in enumerate(among) if name in among[:n]]:
            raise BackendError(
                f"backend {backend!r} has two {what} named {twice[0]!r}; give each its own name"
            )


@dataclass(frozen=True)
class Compared:
    """Real rollouts beside the simulator at the same tests: what there is to be explained, before anything is.

    Attributes:
        rows: (n, 1 + p) of the real rollouts.
        available: (1 + p,) which columns are known of most of them.
        asked_error: see :func:`equations_error`.
        signatures: of these columns.
        level: (tests, 1 + p) mean of the nominal simulator.
        own: (k,) variance of the simulator's numbers from run to run.
        machine: (k,) the same of the machine's.
        smooth: the data through a few functions of the test.
        view: the data as they are fitted; see :class:`State`.
        simulator: seen likewise.
    """

    rows: FloatArray
    available: NDArray[np.bool_]
    asked_error: float
    signatures: Signatures
    level: FloatArray
    own: FloatArray
    machine: FloatArray
    smooth: View
    view: View
    simulator: Simulator


def compare(
    bench: Bench,
    bank: banks.Bank,
    seen: list[tuple[dict[str, float], Trace]],
    executor: Callable[[], Executor] | None,
    tell: Progress,
) -> Compared:
    """Run the nominal simulator at the tests of the rollouts in ``seen``, and see both alike."""
    rows = np.array([bench.measure(trace, test) for test, trace in seen])
    complete = np.array([trace.failure is None for _, trace in seen])
    usable = rows[complete] if complete.any() else rows
    available = np.isfinite(usable).mean(axis=0) > 0.5
    asked_error = equations_error(
        bench, [rollout for rollout, ran in zip(seen, complete, strict=True) if ran] or seen
    )
    signatures = Signatures.of(bank, available, asked_error)
    tests = [test for test, _ in seen]
    layout = Layout.of(bench.spec.space, bank.tests, tests)
    tell("the simulator at the real tests", 0, 0)
    nominal = nominal_rows(bench, layout.tests, SHOTS, executor)
    level = np.nanmean(nominal, axis=0)
    components = signatures.components(rows, level[layout.place][:, signatures.kept])
    own = np.diag(signatures.noise)
    inflation, machine = _of_replicates(layout, components, signatures)
    layout = Layout.of(bench.spec.space, bank.tests, tests, inflation)
    means = layout.mean(components)
    catalogue = Catalogue.of(signatures.curves)
    smooth = view = View.of(signatures, catalogue, layout, layout.project @ means, machine, own)
    simulator = Simulator(bench, signatures, smooth.surrogate, layout, nominal, executor)
    each = layout.each(inflation)
    if _trend(layout, each, means, signatures, machine) < TREND and not simulator.too_dear_for(
        len(layout.tests)
    ):
        # What happens at a few tests only, or varies without a trend, is not seen through a few functions.
        view = View.of(signatures, catalogue, each, means, machine, own)
        simulator = Simulator(bench, signatures, view.surrogate, view.layout, nominal, executor)
    return Compared(rows, available, asked_error, signatures, level, own, machine, smooth, view, simulator)


def prepare(
    bench: Bench,
    bank: banks.Bank,
    seen: list[tuple[dict[str, float], Trace]],
    seed: int,
    cache: Cache | None,
    executor: Callable[[], Executor] | None,
    tell: Progress,
) -> State:
    """Fit the whole catalogue to the rollouts in ``seen``, and weigh every set of effects."""
    compared = compare(bench, bank, seen, executor, tell)
    signatures, simulator = compared.signatures, compared.simulator
    smooth, view = compared.smooth, compared.view
    judge = judge_of(bench, signatures, compared.available, compared.asked_error, seed, cache, tell)
    # The networks learnt from data with a trend: where what has none matters, too, they abstain.
    p = judge.memberships(describe(smooth.data)[None])[0] if view is smooth else None
    tell("fitting the whole catalogue", 0, 0)
    begin = _beginning(smooth, not simulator.dear)
    first = view.surrogate.jacobian(begin)
    heard = None
    if simulator.dear or bank.features.instrumented:
        nominal = compared.level[smooth.layout.place]
        weights = bench.weights([test for test, _ in seen])
        heard = Heard.of(bank, compared.rows, nominal, compared.asked_error, weights)
    if not simulator.dear:
        state = _state(signatures, smooth, view, judge, p, simulator, simulator, begin, first, heard=heard)
        return _closer(state, view, view.layout.variance(compared.machine, compared.own))
    state = _state(signatures, smooth, view, judge, p, simulator, view.surrogate, begin, first, heard=heard)
    if state.fitted.misfit <= FAITHFUL:
        return replace(state, by_bank=True)
    # Where derivatives are the bank's, the fit of everything at once goes astray; that of a few effects does not.
    likely = [members for members, _ in state.sets.ranked()[:TRIED]]
    tried = {members: state.beside(members) for members in likely}
    best = min(tried.values(), key=lambda fit: fit.cost)
    # A gait that a cause has made unsteady scatters as the nominal one does not.
    there = _shrunk(*simulator.scattered(best.at), compared.own)
    if there.sum() > UNSTEADY * compared.own.sum():
        simulator = simulator.steadier(SHOTS)
    steady = np.zeros_like(compared.own)
    scatter = smooth.layout.variance(compared.machine, steady) + simulator.variance(there)
    view = replace(view, variance=_nearer(view, scatter, best))
    found = _state(
        signatures, smooth, view, judge, p, simulator, simulator, best.at, best.jacobian, True, heard
    )
    usual = believed(scatter, view.layout.level(view.data))
    return replace(found, tried=tried, usual=usual)


def _closer(wide: State, view: View, scatter: FloatArray) -> State:
    """Fit the whole catalogue again, from where one of the likeliest sets leads, and believed as far as that bears out.

    Where the simulator is nearly right, two effects that it can hardly tell apart leave data of which most would be
    taken for a law that is not ours. What the best set leaves says that this is not so.
    """
    wide = replace(wide, reached=_reached(wide))
    likely = [members for members, _ in wide.sets.ranked()[:TRIED]]
    owner = wide.view.surrogate.catalogue.owner
    more = [*wide.missing(wide.fitted.rest, ()), *(int(owner[line]) for line in wide.reached)]
    likely += [(k,) for k in dict.fromkeys(more) if (k,) not in likely]
    best = min((wide.beside(members) for members in likely), key=lambda fit: fit.cost)
    if wide.astray and best.misfit < wide.fitted.misfit:
        # What everything at once left was the fit's doing, and says nothing of unknown causes.
        again = _state(
            wide.signatures,
            wide.smooth,
            view,
            wide.judge,
            wide.memberships,
            wide.simulator,
            wide.simulator,
            best.at,
            best.jacobian,
            heard=wide.heard,
        )
        wide = replace(again, reached=wide.reached)
    near = replace(view, variance=_nearer(view, scatter, best))
    found = _state(
        wide.signatures,
        wide.smooth,
        near,
        wide.judge,
        wide.memberships,
        wide.simulator,
        wide.simulator,
        best.at,
        best.jacobian,
        heard=wide.heard,
        unknown=wide.unknown,  # its detector learnt from data that were believed as usual
    )
    return replace(found, reached=wide.reached, wide=wide)


def _reached(state: State) -> dict[int, float]:
    """Return the lines that do nothing near nominal, but far from it explain some of what the fit leaves, and where.

    The simulator is asked all along such a line: between the bank's tests it is not known where a limit is reached.
    Where the fit of everything went astray, any line may be all there is, and each is asked alone.
    """
    view, size = state.view, state.view.data.size
    catalogue, begin = view.surrogate.catalogue, state.ground if state.astray else state.fitted.at
    places = PLACES // 2 if state.astray else PLACES
    gains: dict[int, float] = {}
    found = {}
    for line in np.flatnonzero(~catalogue.based).tolist() if state.astray else view.surrogate.idle():

        def cost(x: float, line: int = line) -> float:
            at = begin.copy()
            at[line] = x
            rest = view.data - state.simulator.change(at)
            return misfit(rest, view.variance, view.nuisances) * size + (x / LARGE) ** 2

        ends = (view.surrogate.lower[line], view.surrogate.upper[line])
        away = np.concatenate([np.linspace(0.0, end, places + 1)[1:] for end in ends if end])
        costs = {0.0: cost(0.0)} | {float(x): cost(float(x)) for x in away}
        best = min(costs, key=lambda x: costs[x])
        step = float(np.abs(away).max()) / places
        for part in (0.5, 0.25):
            for x in (best - part * step, best + part * step):
                if best and ends[0] <= x <= ends[1]:
                    costs[x] = cost(x)
            best = min(costs, key=lambda x: costs[x])
        if costs[best] < costs[0.0] - SOME:
            found[line], gains[line] = best, costs[0.0] - costs[best]
    most = sorted(found, key=lambda line: -gains[line])[: TRIED if state.astray else None]
    return {line: found[line] for line in most}


def _nearer(view: View, scatter: FloatArray, best: Joint) -> FloatArray:
    """Return (q, k) variance by which the data are to be believed, from what a fit of a few effects leaves of them."""
    level = view.layout.level(view.data)
    left = misfit(best.rest, believed(scatter, level), view.nuisances)
    return believed(scatter, level, float(np.clip(left / LEFT, LEAST, 1.0)))


def _state(
    signatures: Signatures,
    smooth: View,
    view: View,
    judge: Judge,
    p: FloatArray | None,
    simulator: Simulator,
    model: Model,
    begin: FloatArray,
    first: FloatArray,
    exact: bool = False,
    heard: Heard | None = None,
    unknown: float | None = None,
) -> State:
    """Fit the whole catalogue by a model, and weigh every set of effects; ``unknown`` if that is not to be asked."""
    catalogue = view.surrogate.catalogue
    fitted, plain, variance = solved(
        model, catalogue, view.data, view.variance, view.nuisances, begin, first, exact
    )
    found = through = evidence(plain)
    if unknown is None and view.layout.apart:
        of_smooth = seen_through(fitted, smooth.layout.project, smooth.variance, smooth.nuisances)
        more = ground(catalogue, of_smooth, smooth.data, smooth.variance, smooth.nuisances)
        wider = smooth.variance + more**2
        of_smooth = seen_through(fitted, smooth.layout.project, wider, smooth.nuisances)
        through = evidence(linear(catalogue, of_smooth, smooth.data, wider, smooth.nuisances))
    warmth = temperature(_counted(view, smooth), fitted.misfit, judge.weights)
    unknown = judge.unknown(through, p) if unknown is None else unknown
    return State(
        signatures,
        smooth,
        replace(view, variance=variance),
        judge,
        plain,
        found,
        p,
        judge.sets(found, p, warmth, unknown, by_equations(heard, judge.effects, found.members)),
        unknown,
        simulator,
        fitted,
        warmth,
        heard=heard,
    )


def by_equations(heard: Heard | None, effects: Sequence[str], members: Sequence[Set]) -> FloatArray | None:
    """Return (sets,) log evidence by what the equations of motion ask for, if they are asked by themselves."""
    if heard is None:
        return None
    return log_evidence(heard.asked, heard.seen, [[effects[k] for k in chosen] for chosen in members])


def _counted(view: View, smooth: View) -> float:
    """Return how many numbers the data count as; tests that are each by themselves hang together, too."""
    return float(np.sqrt(view.data.size * smooth.data.size))


def _trend(
    layout: Layout, each: Layout, means: FloatArray, signatures: Signatures, machine: FloatArray
) -> float:
    """Return the part of the data (n, k) beyond scatter that a few functions of the test hold.

    Corrected for how many functions these are. What scatter may have left is no lack of a trend: of a small effect
    that is most of it.
    """
    scatter = each.variance(machine, np.diag(signatures.noise))
    variance = believed(scatter)
    rest = means - functions(layout.points) @ (layout.project @ means)
    n, q = len(means), len(layout.project)
    if n <= q:
        return 1.0
    alone = float((scatter / variance).sum()) / n
    whole = float((means**2 / variance).sum()) / n - alone
    left = float((rest**2 / variance).sum()) / (n - q) - AT_MOST * alone
    return 1.0 - left / max(whole, 1e-12) if left > 0.0 else 1.0


def equations_error(bench: Bench, rollouts: list[tuple[dict[str, float], Trace]]) -> float:
    """Return by how much a coordinate may be off for which the equations ask: as far as these leave residuals open.

    The error of a regression grows with what it leaves. One of a few values, for networks practise with it.
    """
    left = np.array([bench.unexplained(trace, test) for test, trace in rollouts])
    if not np.isfinite(left).any():
        return LEVEL
    times = float(np.sqrt(np.nanmedian(left)))
    return LEVEL * min(DISTRUSTED, key=lambda level: abs(np.log(level / max(times, 1e-9))))


def _beginning(view: View, beside: bool) -> FloatArray:
    """Return (K,) coordinates for the joint fit to start from: one effect, if it explains most of the data alone.

    ``beside`` says that how each acts begins where it fits beside all others: for a fit with derivatives of its own.
    """
    turned = view.surrogate.turned(view.data, view.variance)
    effects = range(len(view.surrogate.catalogue.effects))
    scans = [view.surrogate.scanned(view.data, view.variance, k, turned) for k in effects]
    best, part = max(scans, key=lambda scan: scan[1])
    begin = best if part > MOSTLY else turned
    if beside:
        catalogue = view.surrogate.catalogue
        there = begin[catalogue.first] != 0  # of one that is there, this was looked for with it
        begin = np.where(
            catalogue.based & ~there, view.surrogate.turned(view.data, view.variance, True), begin
        )
    return begin


def _of_replicates(
    layout: Layout, components: FloatArray, signatures: Signatures
) -> tuple[float, FloatArray]:
    """Return how the machine's rollouts of one test scatter: as a multiple of the simulator's, and (k,) each number."""
    own = np.diag(signatures.noise)
    squares, free = layout.scattered(components)
    if free < FREE:
        return 1.0, own
    multiple = float(np.clip(squares.sum() / max(float(own.sum()), 1e-12), 1.0, WILDEST))
    return multiple, _shrunk(squares, free, own)


def _shrunk(squares: FloatArray, free: int, own: FloatArray) -> FloatArray:
    """Return (k,) variances that were estimated from few rollouts, drawn towards a multiple of the simulator's."""
    multiple = max(float(squares.sum()) / max(float(own.sum()), 1e-12), 1.0)
    return (USUALLY * multiple * own + free * squares) / (USUALLY + free)


def judge_of(
    bench: Bench,
    signatures: Signatures,
    available: NDArray[np.bool_],
    asked_error: float,
    seed: int,
    cache: Cache | None,
    tell: Progress,
) -> Judge:
    """Return the judge of this bank and these columns in these units, from disk if it was trained before."""
    digest = hashlib.sha256(
        banks.key(bench).encode() + available.tobytes() + f"{asked_error} {seed}".encode()
    )
    for name in SOURCES:
        digest.update((Path(__file__).parent / f"{name}.py").read_bytes())
    digest.update(f"{version('scikit-learn')} {version('numpy')}".encode())
    return (cache or Cache.usual()).kept(
        f"judges/{digest.hexdigest()}.npz",
        judges.load,
        lambda: train(
            signatures, bench.spec.space, seed=seed, progress=lambda done, of: tell("practising", done, of)
        ),
        judges.save,
    )
