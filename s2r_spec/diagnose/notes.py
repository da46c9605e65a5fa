"""What the real rollouts lack for a diagnosis: channels, tests, rollouts that ended whole."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from s2r_spec.backend import HasResiduals
from s2r_spec.base.errors import TraceError
from s2r_spec.diagnose.data.rollouts import CUT, READ_AT
from s2r_spec.diagnose.data.split import ENOUGH, TrainHeldOut
from s2r_spec.diagnose.gap.breaking import nearest_curves
from s2r_spec.diagnose.gap.nominal import Nominal
from s2r_spec.diagnose.quality.finding import Finding
from s2r_spec.diagnose.simulator.bench import Bench, Test, TestRun, places_of
from s2r_spec.diagnose.simulator.open_loop import OpenLoop
from s2r_spec.diagnose.simulator.response import ResponseLibrary
from s2r_spec.trace import SHOWN, Trace


def notes(
    bench: Bench,
    rollouts: Sequence[TestRun],
    parts: TrainHeldOut,
    idle: Sequence[str] = (),
    why: str = "",
    odd: Sequence[Finding] = (),
    alone: Sequence[Test] = (),
) -> tuple[str, ...]:
    """Return what these rollouts lack for a diagnosis, a sentence each.

    ``idle`` effects change nothing in any experiment. ``why`` says what may have ended rollouts early
    (:func:`early_ends`). ``odd`` are suspected mistakes of the recordings. The simulator ends early at the tests of
    ``alone``, and the machine does not.
    """
    sentences = [each.text for each in odd]
    if idle:
        one = len(idle) == 1
        sentences.append(
            f"in these experiments, {', '.join(idle)} {'changes' if one else 'change'} nothing in the "
            f"simulator, so no data can show {'it' if one else 'them'}"
        )
    if isinstance(bench.backend, OpenLoop):
        said = [[one.words for one in bench.backend.loop(run) if one.level == "note"] for _, run in rollouts]
        sentences += [words for words in said[0] if all(words in each for each in said)] if said else []
    if not rollouts:
        return (*sentences, "no test of the specification was run, so the gap in ρ was not measured")
    used = len(parts.train.tests) + len(parts.held_out)
    sentences += _early_notes(rollouts, used < len(rollouts), why)
    tests = places_of([test for test, _ in rollouts])
    if alone:
        where = " and ".join(
            ", ".join(f"{k} = {v:.4g}" for k, v in test.items()) or "the only test" for test in alone[:SHOWN]
        )
        sentences.append(
            f"without any effect, the simulator ends early at {len(alone)} of {len(tests)} tests where no real rollout "
            f"does ({where}). There the gap in ρ is the cost of a fall and shows few causes. Make the simulator stand "
            f"at these tests first, or use a smaller test space"
        )
    traces = [trace for _, trace in rollouts]
    if longer := [trace.meta[CUT] for trace in traces if CUT in trace.meta]:
        sentences.append(
            f"{len(longer)} of {len(traces)} real rollouts are longer than the simulator's; only their first "
            f"{longer[0]:g} s are used"
        )
    if apart := [trace.meta[READ_AT] for trace in traces if READ_AT in trace.meta]:
        sentences.append(
            f"a window of the spec is shorter than the sample period of {len(apart)} of {len(traces)} real rollouts. "
            f"They are interpolated linearly at the simulator's period of {apart[0]:g} s, which may change ρ a little"
        )
    sentences += _channels(bench, traces)
    sentences += _without_residuals(bench, rollouts)
    if len(tests) == 1 and bench.spec.space.dim:
        sentences.append("all real rollouts repeat one test, so nothing is known about other tests")
    if not parts.held_out:
        takes, here = f"{ENOUGH[1]} rollouts of {ENOUGH[0]} different tests", f" of {len(tests)}"
        if not bench.spec.space.dim:
            # There is one test, and rollouts of it are all there is to hold out.
            takes, here = f"{ENOUGH[0]} rollouts", ""
        sentences.append(
            f"no rollouts were held out, so the reduction of the gap was not measured: it takes {takes}, and there are "
            f"{len(rollouts)}{here}"
        )
    return tuple(sentences)


def _early_notes(rollouts: Sequence[TestRun], left_out: bool, why: str) -> Iterator[str]:
    fell = [trace.failure is not None for _, trace in rollouts]
    if not any(fell):
        return
    tests = [[fell[n] for n in own] for own in places_of([test for test, _ in rollouts]).values()]
    always = sum(len(own) > 1 and all(own) for own in tests)
    again = ""
    if always and sum(map(any, tests)) == 1:
        again = ", every time at one test, so it is no accident"
    elif always:
        again = f", at {sum(map(any, tests))} tests, and in every repetition at {always} of them, so it is no accident"
    kinds = ", ".join(sorted({str(trace.failure) for _, trace in rollouts if trace.failure is not None}))
    early = f"{sum(fell)} of {len(rollouts)} real rollouts ended early ({kinds}{again})"
    if left_out:
        early += f", and {'is' if sum(fell) == 1 else 'are'} left out"
    else:
        early += ". The cause also rests on their samples before the end, which say little"
    yield f"{early}. {why}" if why else early


def early_ends(
    bench: Bench, library: ResponseLibrary, rollouts: Sequence[TestRun], nominal: Nominal
) -> tuple[str, list[Test]]:
    """Return what may have ended real rollouts early, in a sentence, and the tests at which the simulator alone does.

    The library's tests nearest to real ones stand for them; one nearest to both counts among those of early ends. An
    effect is suspected if the smallest of its simulated sizes that ends the simulator early at all of these does so at
    a third of the others at most. Without others, nothing tells effects apart, and nothing is said.
    """
    places = places_of([test for test, _ in rollouts])
    fell = [any(rollouts[n][1].failure is not None for n in own) for own in places.values()]
    early, stood = (
        [dict(key) for key, own in zip(places, fell, strict=True) if own is of] for of in (True, False)
    )
    alone: list[Test] = [test for test in stood if nominal.ends(test)]
    curves = nearest_curves(bench, library, places)
    if not early or not stood or not curves:
        return "", alone
    if all(map(nominal.ends, early)):
        return "The simulator ends early at these tests, too", alone
    near = {id(one) for one, of in zip(curves, fell, strict=True) if of}
    simulated = {id(one): one for one in curves}
    if not (others := len(simulated) - len(near)):
        return "", alone
    suspects = []
    for k, axis in enumerate(library.parameters):
        ends = {
            n: {*one[k].coordinates[one[k].ended].tolist()} if k in one else set[float]()
            for n, one in simulated.items()
        }
        always = set.intersection(*(ends[n] for n in near))
        apart = {x: sum(x in own for n, own in ends.items() if n not in near) for x in always}
        for side in ([x for x in always if x < 0.0], [x for x in always if x > 0.0]):
            if side and 3 * apart[least := min(side, key=abs)] <= others:
                value = f"{axis.value(least):.3g} {axis.unit}".rstrip()
                suspects.append((abs(least), f"{axis.name} = {value}", apart[least]))
    suspects.sort()
    if not suspects:
        return (
            "No simulated size of a single effect ends the simulator early at the nearest simulated tests and not at "
            "others",
            alone,
        )
    few = max(count for *_, count in suspects[:SHOWN])
    others_too = f"no more than {few}" if few else "none"
    words = (
        f"Each of these alone ends the simulator early at the nearest simulated tests, and at {others_too} of "
        f"{others} other{'s' * (others > 1)}: {_some([name for _, name, _ in suspects])}"
    )
    return words, alone


def _channels(bench: Bench, traces: Sequence[Trace]) -> Iterator[str]:
    """Yield which channels all rollouts lack, and which some lack or have gaps in, by the number of rollouts."""
    known = [channel.name for channel in bench.backend.channels]
    finite = {
        name: [np.isfinite(trace[name]) if name in trace.channels else np.zeros(1, bool) for trace in traces]
        for name in known
    }
    lacking = [name for name in known if not any(there.any() for there in finite[name])]
    if lacking:
        # One of the channels that the simulator does not know may be what is lacking.
        others = sorted({name for trace in traces for name in trace.channels} - set(known))
        unread = f". The simulator has no {_some(others)}: is a name misspelt?" if others else ""
        yield (
            f"the real rollouts have no {_some(lacking)}. An effect that only these would show "
            f"cannot be found{unread}"
        )
    holes: dict[int, list[str]] = {}
    for name in known:
        count = sum(not there.all() for there in finite[name])
        if count and name not in lacking:
            holes.setdefault(count, []).append(name)
    for count, names in holes.items():
        verbs = ("is missing or has", "is") if len(names) == 1 else ("are missing or have", "are")
        yield (
            f"{_some(names)} {verbs[0]} gaps in {count} of {len(traces)} real rollouts, and {verbs[1]} not used "
            f"{'there' if 2 * count < len(traces) else 'at all'}"
        )


def _some(names: Sequence[str]) -> str:
    more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    return f"{', '.join(names[:SHOWN])}{more}"


def _without_residuals(bench: Bench, rollouts: Sequence[TestRun]) -> list[str]:
    """Return that no real rollout has residuals; nothing where the simulator's own have none, as with contacts."""
    if not isinstance(bench.backend, HasResiduals):
        return []
    why = ""
    for test, trace in rollouts:
        try:
            bench.backend.residuals(trace, bench.matched.to_backend(test))
            return []
        except TraceError as error:
            why = str(error)
    try:
        bench.backend.residuals(bench.run({}, rollouts[0][0], 0), bench.matched.to_backend(rollouts[0][0]))
    except TraceError:
        return []
    return [
        f"residuals of the equations of motion cannot be computed for any real rollout ({why}). The answer rests "
        f"on the channels alone"
    ]
