"""The cart's gap for tests of reports, without a simulation."""

import functools
from dataclasses import replace

import numpy as np

import s2r_spec as s2r
from s2r_spec.attribution.attribute import attribute
from s2r_spec.diagnose.gap.materiality import RolloutsAtTest, materiality
from s2r_spec.diagnose.gap.surface import Band, GapSurface, LargestGap, gap_surface
from s2r_spec.diagnose.gap.where import Where
from s2r_spec.diagnose.residuals.shifts import Body, BodyPart, Shift
from s2r_spec.trace import Trace
from tests.report.conftest import undrawn
from tests.report.test_html import Page

SPACES = {
    0: "",
    1: "param vd {m/s} in [0, 1]",
    2: "param vd {m/s} in [0, 1]\nparam load {kg} in [0, 5]",
    3: "param vd {m/s} in [0, 1]\nparam load {kg} in [0, 5]\nparam slope {deg} in [-5, 5]",
}
NO_BODY = "the simulator has no residuals"


def spec_of(dim):
    text = f"signal x {{m}}\nsignal u[2] {{V}}\n{SPACES[dim]}\n"
    text += "require near: always[0, 1 s] (abs(x) <= 0.5 and u[1] <= 3)\n"
    return s2r.parse_spec(text, "specs/a spec.stl")


def rollout(rng, size):
    t = np.linspace(0, 1, 41)
    x = size * np.exp(-((t - 0.6) ** 2) / 0.01) + 0.01 * rng.normal(size=t.size)
    return Trace(t, {"x": x, "u": np.column_stack([x, 2 * x])}, {"x": "m", "u": "V"})


@functools.cache
def where_of(dim, n=10, size=0.4):
    """Return tests and where; over two parameters and more the test space's answer is made up, for it takes long."""
    spec = spec_of(dim)
    rng = np.random.default_rng(1)
    axes = spec.space.axes
    tests = [{a.name: float(rng.uniform(a.low, a.high)) for a in axes} for _ in range(n)]
    real, simulated = ([rollout(rng, scale) for _ in tests] for scale in (size, 0.1))
    if dim < 2:
        return tests, where_in(spec, tests, real, simulated)
    pair = attribute(spec, "near", real[0], simulated[0], tests[0])
    return tests, Where(made_up(spec.space, tests), tests[0], pair, no_body=NO_BODY)


def where_in(spec, tests, real, simulated):
    """Return where the gap of pairs of rollouts lies, one pair a test."""
    rho = [
        np.array([spec.robustness(trace, test)["near"] for trace, test in zip(side, tests, strict=True)])
        for side in (real, simulated)
    ]
    worst = int(np.abs(rho[0] - rho[1]).argmax())
    gaps = (
        [RolloutsAtTest(dict(t), rho[0][[n]], rho[1][[n]]) for n, t in enumerate(tests)] if any(tests) else ()
    )
    pair = attribute(spec, "near", real[worst], simulated[worst], tests[worst])
    return Where(
        gap_surface(spec.space, tuple(gaps), "m") if gaps else None, tests[worst], pair, no_body=NO_BODY
    )


def made_up(space, tests):
    grid = space.grid({2: (21, 21), 3: (7, 7, 7)}[space.dim])
    mean = 0.1 * (grid[:, 0] - 0.5)
    band = Band(mean, mean - 0.03, mean + 0.03)
    gaps = tuple(
        RolloutsAtTest(test, np.array([0.1]), np.array([0.1 + 0.1 * (test["vd"] - 0.5)])) for test in tests
    )
    worst = space.point(grid[0])
    ends = {name: (value, value) for name, value in worst.items()}
    return GapSurface(
        space,
        "m",
        gaps,
        grid,
        band,
        0.01,
        worst,
        0.9,
        ends,
        LargestGap(0.05, 0.04, 0.06, "m"),
        0.02,
        (),
    )


def body_of(names):
    shift = Shift("torque", 1, "mean", "N*m", 0.25, 0.75, -1.25, 1.3, 12.0, 1e-9, 1e-6)
    wave = replace(shift, channel="speed", kind="rms", unit="rad/s", mean=0.01, size=0.2, sigma=2.0)
    parts = [BodyPart(names[0], (shift, wave)), BodyPart(names[1], (wave,))]
    return Body((*parts, *(BodyPart(name, ()) for name in names[2:])), 10, 1.0, 534)


@functools.cache
def materiality_of(dim):
    """Return a gap of 12 µm of a margin of 0.4 mm at the last test, and one rollout that ended early."""
    tests, _ = where_of(dim)
    rho = 4e-4 + 1e-8 * np.random.default_rng(3).normal(size=(len(tests), 6))
    runs = [
        RolloutsAtTest(test, own[:1], own, int(n == 0))
        for n, (test, own) in enumerate(zip(tests, rho, strict=True))
    ]
    return materiality([*runs[:-1], replace(runs[-1], real=rho[-1, :1] - 12e-6)], "m", 0.002)


def page_of(render, found, spec):
    """Return a page whose pictures are painted, but not written down."""
    with undrawn():
        return Page(render(found, spec))
