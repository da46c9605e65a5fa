"""The public face: what a specification knows, and ρ of hand-made traces worked out by hand."""

import hashlib
import math
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from s2r_spec.errors import TraceError, UsageError
from s2r_spec.lang.diagnostics import SpecError
from s2r_spec.spec import CertifySettings, KernelChoice, load_spec, parse_spec
from s2r_spec.trace import Trace
from tests.errors import naming

A1 = Path(__file__).parents[2] / "specs" / "a1_velocity.stl"
TIMES = np.arange(4) * 0.5  # 0, 0.5, 1, 1.5 s: the windows of the paper are samples 0–1 and 1–3


def walk(*vx: float, unit: str | None = "m/s") -> Trace:
    return Trace(TIMES[: len(vx)], {"vx": vx}, {} if unit is None else {"vx": unit})


@pytest.mark.parametrize(
    ("vd", "vx", "rho"),
    [
        # settles 0.01 below: 0.045 − 0.01, and 0.03 − (−0.01) is more
        (0.3, (0.0, 0.29, 0.29, 0.29), 0.035),
        # 0.02 over the command at 0.5 s: overshoot leaves 0.03 − 0.02
        (0.3, (0.0, 0.32, 0.3, 0.3), 0.01),
        # 0.05 over at the start only; the later windows do not see it
        (0.3, (0.35, 0.3, 0.3, 0.3), -0.02),
        # 0.1 below at 1.5 s: 0.045 − 0.1
        (0.3, (0.0, 0.3, 0.3, 0.2), -0.055),
        # backwards: over is below; −0.22 is 0.02 over −0.2
        (-0.2, (0.0, -0.22, -0.2, -0.2), 0.01),
        # backwards and slow: no overshoot at all, 0.04 from the command
        (-0.2, (0.0, -0.16, -0.16, -0.16), 0.005),
        # at 0 the overshoot is one-sided, forwards: −0.04 costs settling only
        (0.0, (-0.04, 0.0, 0.0, 0.0), 0.03),
        (0.0, (0.04, 0.0, 0.0, 0.0), -0.01),
    ],
)
def test_the_papers_specification_by_hand(vd: float, vx: tuple[float, ...], rho: float) -> None:
    spec = load_spec(A1)
    assert spec.robustness(walk(*vx), params={"vd": vd}) == {"walking": pytest.approx(rho, abs=1e-12)}
    assert spec.robustness_signal(walk(*vx), "walking", {"vd": vd})[0] == pytest.approx(rho, abs=1e-12)


def test_what_the_papers_specification_declares() -> None:
    spec = load_spec(A1)
    assert spec.name == str(A1)
    assert spec.requirements == ("walking",)
    assert spec.channels() == spec.channels("walking") == ("vx",)
    assert spec.horizon() == 1.5
    assert spec.unit("walking") == "m/s"
    assert (spec.signals["vx"].unit, spec.signals["vx"].dim, spec.signals["vx"].range) == ("m/s", 1, None)
    assert [(a.name, a.low, a.high, a.unit) for a in spec.space.axes] == [("vd", -0.2, 0.3, "m/s")]
    assert spec.certify["walking"] == CertifySettings(
        delta=1e-6, epsilon=0.02, B=1.5, R=0.01, kernel=KernelChoice("matern52", (0.15,)), fall=-0.5
    )
    again = pickle.loads(pickle.dumps(spec))
    assert again.hash == spec.hash
    assert again.robustness(walk(0, 0.3, 0.3, 0.3), {"vd": 0.3}) == spec.robustness(
        walk(0, 0.3, 0.3, 0.3), {"vd": 0.3}
    )


def test_the_hash_is_of_the_text_whatever_its_line_endings() -> None:
    text = "signal x\nrequire it: x > 0\n"
    assert parse_spec(text).hash == hashlib.sha256(text.encode()).hexdigest()
    assert parse_spec(text.replace("\n", "\r\n")).hash == parse_spec(text).hash
    assert parse_spec(text + "\n").hash != parse_spec(text).hash


def test_settings_are_in_the_units_of_what_they_are_for() -> None:
    spec = parse_spec(
        "signal v {km/h} param a {m/s} in [0, 2000 {mm/s}] param b {deg} in [0, 90] param c = 1\n"
        "require it: v <= 36 {km/h} + a and a <= 1\n"
        "certify it: R = 1 {m/s}, fall = -2, kernel = rbf(0.2, 3.141592653589793 {rad}), gap_B = 2 {m/s}, gap_R = 0.1"
    )
    assert spec.unit("it") == "km/h"
    settings = spec.certify["it"]
    assert pytest.approx(3.6) == settings.R
    assert settings.fall == -2
    assert (settings.gap_B, settings.gap_R, settings.gap_epsilon) == (pytest.approx(7.2), 0.1, None)
    assert settings.kernel is not None
    assert settings.kernel.lengthscales == pytest.approx((0.2, 180))
    assert (settings.delta, settings.epsilon, settings.B) == (None, None, None)
    assert [(a.name, a.low, a.high, a.unit) for a in spec.space.axes] == [
        ("a", 0, 2, "m/s"),
        ("b", 0, 90, "deg"),
    ]
    # v = 0: 36 km/h + 1 m/s − 0, and 1 − a = 0 m/s
    assert spec.robustness(Trace([0], {"v": [0]}), {"a": 1})["it"] == pytest.approx(0)
    assert spec.robustness(Trace([0], {"v": [39]}), {"a": 0.5})["it"] == pytest.approx(36 + 1.8 - 39)


def test_margins_that_do_not_compare_are_mixed() -> None:
    spec = parse_spec("signal v {m/s} signal x {m} require it: v <= 3 and x <= 2 certify it: R = 1")
    assert spec.unit("it") == "mixed"
    assert spec.robustness(Trace([0], {"v": [1], "x": [1.5]})) == {"it": 0.5}


@pytest.mark.parametrize(("over", "unit"), [("m/s", ""), ("km/h", "m/s/(km/h)"), ("s", "m/s/s")])
def test_a_part_of_what_is_allowed_has_no_unit(over: str, unit: str) -> None:
    spec = parse_spec(f"signal vx {{m/s}}\nconst c = 2 {{{over}}}\nrequire it: vx / c <= 1")
    assert spec.unit("it") == unit


def test_units_of_the_trace_are_converted() -> None:
    spec = parse_spec("signal w {deg/s} signal T {degC} require spin: w <= 90 require cool: T <= 80 {degC}")
    trace = Trace([0], {"w": [math.pi / 4], "T": [300]}, {"w": "rad/s", "T": "K"})
    assert spec.robustness(trace) == {"spin": pytest.approx(45), "cool": pytest.approx(80 - (300 - 273.15))}
    assert (spec.unit("spin"), spec.unit("cool")) == ("deg/s", "K")
    undeclared = Trace([0], {"w": [45], "T": [30]})
    assert spec.robustness(undeclared) == {"spin": 45, "cool": 50}


def test_vectors() -> None:
    spec = parse_spec(
        "signal u[2] {V} signal w[2] {V} require a: norm(u - w) <= 12 require b: u[1] >= 1 {mV}"
    )
    trace = Trace([0, 1], {"u": [[3, 5], [0, 0]], "w": [[0, 1], [0, 0]]})
    assert spec.robustness(trace) == {"a": 7, "b": pytest.approx(5 - 0.001)}
    with pytest.raises(TraceError, match=naming("'u'", "2")):
        spec.robustness(Trace([0], {"u": [1], "w": [[0, 0]]}))


def test_overshoot_from_an_origin() -> None:
    spec = parse_spec("signal x {m} signal r {m} require it: overshoot(x, r, init(x)) <= 1")
    # from 5 down to 2: 1.5 is 0.5 over, although the command is positive
    assert spec.robustness_signal(Trace([0, 1], {"x": [5, 1.5], "r": [2, 2]}), "it").tolist() == [4, 0.5]


def test_a_fall_has_the_declared_robustness() -> None:
    fallen = Trace([0.0], {"vx": [0.1]}, meta={"failure": "fall"})
    assert load_spec(A1).robustness(fallen, {"vd": 0.3}) == {"walking": -0.5}
    with pytest.raises(UsageError, match=naming("'fall'", "a.stl", "certify it: fall = -1")):
        parse_spec("signal vx require it: vx > 0", "a.stl").robustness(fallen)


def test_a_short_trace_is_not_evaluated_silently() -> None:
    spec = load_spec(A1)
    with pytest.raises(TraceError, match=naming("'walking'", "1.5 s", "1 s", "partial=True")):
        spec.robustness(walk(0, 0.3, 0.3), {"vd": 0.3})
    assert spec.robustness(walk(0, 0.3, 0.3), {"vd": 0.3}, partial=True) == {"walking": pytest.approx(0.03)}


def test_past_the_end_windows_are_cut_or_the_last_sample_is_held() -> None:
    spec = parse_spec("signal x require it: always[0.5, 1] (x > 0)")
    trace = Trace(TIMES, {"x": [1, 2, 3, 4]})
    assert spec.robustness_signal(trace, "it").tolist() == [2, 3, 4, math.inf]
    assert spec.robustness_signal(trace, "it", end="hold").tolist() == [2, 3, 4, 4]


def test_horizons() -> None:
    spec = parse_spec(
        "signal x let p := x > 0\n"
        "require a: always[0, 2] eventually[0, 500 ms) p  require b: p until[1, 3] once[0, 2] p\n"
        "require c: always p  require d: always[1, 2] historically[2, 5] p  require e: (always[0, 1] p) since[1, 2] p"
    )
    assert [spec.horizon(name) for name in spec.requirements] == [2.5, 3, math.inf, 2, 1]
    assert spec.horizon() == math.inf
    # an unbounded window takes what there is; an open end does not need its sample
    rho = spec.robustness(Trace(np.arange(31) * 0.1, {"x": np.ones(31)}))
    assert rho == {"a": 1, "b": 1, "c": 1, "d": 1, "e": -math.inf}  # e: nothing was before the first sample


@pytest.mark.parametrize(
    ("trace", "params", "facts"),
    [
        (walk(0, 0, 0, 0), {}, ["'vd'", "params", "--param"]),
        (walk(0, 0, 0, 0), {"vd": 0, "vq": 1}, ["'vq'", "vd"]),
        (walk(0, 0, 0, 0), {"vd": math.nan}, ["vd", "nan"]),
        (walk(0, 0, 0, 0), {"vd": "fast"}, ["vd", "'fast'"]),
        (walk(0, 0, 0, 0), {"vd": "0.3 kg"}, ["vd", "kg", "m/s"]),
        (walk(0, math.nan, 0, 0), {"vd": 0}, ["'vx'", "NaN", "sample 1", "0.5 s", "--nan hold"]),
        (walk(0, 0, 0, 0, unit="m"), {"vd": 0}, ["'vx'", "m", "m/s"]),
        (walk(0, 0, 0, 0, unit="mm/x"), {"vd": 0}, ["'vx'", "'mm/x'"]),
    ],
)
def test_what_does_not_fit_is_named(trace: Trace, params: dict[str, float], facts: list[str]) -> None:
    with pytest.raises(UsageError, match=naming(*facts)) as caught:
        load_spec(A1).robustness(trace, params)
    assert caught.value.exit_code == 2


def test_wrong_words() -> None:
    spec, trace = load_spec(A1), walk(0, 0, 0, 0)
    with pytest.raises(TraceError, match=naming("'vx'", "vy")):
        spec.robustness(Trace([0], {"vy": [0]}), {"vd": 0})
    with pytest.raises(UsageError, match=naming("'walkin'", "did you mean 'walking'")):
        spec.robustness_signal(trace, "walkin", {"vd": 0})
    with pytest.raises(UsageError, match=naming("interpolation", "spline", "samples", "hold", "linear")):
        spec.robustness_signal(trace, "walking", {"vd": 0}, interpolation="spline")  # type: ignore[arg-type]
    with pytest.raises(UsageError, match=naming("end", "wrap", "clip", "hold", "nan", "error")):
        spec.robustness_signal(trace, "walking", {"vd": 0}, end="wrap")  # type: ignore[arg-type]


def test_a_predicate_without_a_value() -> None:
    spec = parse_spec("signal x\nrequire it: always sqrt(x) >= 0", "a.stl")
    with pytest.raises(TraceError, match=naming("`sqrt(x) >= 0`", "line 2 of a.stl", "sample 2", "1 s")):
        spec.robustness(Trace(TIMES, {"x": [1, 1, -1, 1]}))


def test_sample_times_are_snapped_to_a_grid() -> None:
    spec = parse_spec("signal x require it: always[0, 0.3] (x > 0)")
    x = [5, 4, 3, 2, 1]
    for times in (np.arange(5) * 0.1, np.cumsum([7.3, 0.1, 0.1, 0.1, 0.1]), [0, 0.1004, 0.2, 0.2996, 0.4]):
        assert spec.robustness(Trace(times, {"x": x})) == {"it": 2}
    thirds = parse_spec("signal x require it: always[0, 1] (x > 0)")
    assert thirds.robustness(Trace([0, 0.333, 0.667, 1, 1.333], {"x": x})) == {"it": 2}


def test_a_mesh_is_recognised(tmp_path: Path) -> None:
    binary, ascii_ = tmp_path / "binary.stl", tmp_path / "ascii.stl"
    binary.write_bytes(b"\0" * 80 + (2).to_bytes(4, "little") + b"\1" * 100)
    ascii_.write_text("solid cube\n facet normal 0 0 1\n")
    for path in (binary, ascii_):
        with pytest.raises(UsageError, match=naming(str(path), "mesh")):
            load_spec(path)


def test_a_file_that_is_no_text(tmp_path: Path) -> None:
    path = tmp_path / "a.stl"
    with pytest.raises(UsageError, match=naming(str(path), "No such file")):
        load_spec(path)
    path.write_bytes(b"signal v\xff")
    with pytest.raises(UsageError, match=naming(str(path), "UTF-8", "byte 8", "0xff")):
        load_spec(path)
    path.write_bytes("\ufeffsignal v require it: v > 0".encode())
    assert load_spec(path).requirements == ("it",)


def test_mistakes_can_be_pickled_and_read_one_by_one() -> None:
    with pytest.raises(SpecError) as caught:
        parse_spec("signal v {m/s}\nrequire a: v <= w\nrequire b: v", "a.stl")
    again = pickle.loads(pickle.dumps(caught.value))
    assert str(again) == str(caught.value)
    assert [(d.code, d.span.line, d.span.column) for d in again.diagnostics] == [
        ("E02", 2, 17),
        ("E05", 3, 12),
    ]
    assert again.exit_code == 2


def test_importing_is_light() -> None:
    heavy = "{'lark', 'pint', 'torch', 'scipy', 'mujoco'} & set(__import__('sys').modules)"
    code = f"import s2r_spec.spec; loaded = {heavy}; assert not loaded, loaded"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_imports(tmp_path: Path) -> None:
    (tmp_path / "parts").mkdir()
    units, robot, main = tmp_path / "parts/units.stl", tmp_path / "parts/robot.stl", tmp_path / "main.stl"
    units.write_text("const top {m/s} = 2\n")
    robot.write_text('import "units.stl"\nsignal v {m/s}\nsignal G\nrequire slow: v <= top\n')
    main.write_text(
        'import "parts/robot.stl"\nimport "parts/units.stl"\nrequire it: slow and G <= top / top\n'
    )
    spec = load_spec(main)
    assert spec.requirements == ("slow", "it")
    assert list(spec.imported) == [str(units), str(robot)]
    assert spec.robustness(Trace([0], {"v": [0.5], "G": [0]})) == {"slow": 1.5, "it": 1}
    before = spec.hash
    units.write_text("const top {m/s} = 3\n")
    assert load_spec(main).hash != before
    robot.write_text('import "../main.stl"\nsignal v {furlong}\nrequire slow: w > 0\n')
    with pytest.raises(SpecError) as caught:
        load_spec(main)
    found = {
        (mistake.code, mistake.span.source.name, mistake.span.line, mistake.span.column): mistake.message
        for mistake in caught.value.diagnostics
    }
    assert f"`{main}`" in found["E21", str(robot), 1, 8]
    assert "`w`" in found["E02", str(robot), 3, 15]


def test_one_certify_line_for_every_requirement() -> None:
    spec = parse_spec(
        "signal v {m/s} signal x {m} require a: v <= 1 require b: x <= 1\n"
        "certify: delta = 0.1, B = 2 certify b: B = 30 {cm}, R = 0.1"
    )
    assert spec.certify["a"] == CertifySettings(delta=0.1, B=2)
    assert spec.certify["b"] == CertifySettings(delta=0.1, B=0.3, R=0.1)


def test_a_parameter_may_be_a_time_bound() -> None:
    spec = parse_spec(
        "signal x param T {ms} in [500, 1000] param a = 0.5 in [0, 2]\n"
        "require it: always[0, T] (x <= 3) require late: eventually[a, 1 s] x >= 3", "a.stl"
    )  # fmt: skip
    trace = Trace(TIMES, {"x": [1, 2, 3, 4]})
    assert spec.horizon("it") == 1
    assert spec.robustness(trace, {"T": 500}) == {"it": 1, "late": 0}
    assert spec.robustness(trace, {"T": 1000, "a": 0}) == {"it": 0, "late": 0}
    assert spec.evaluate(trace, "it", {"T": 500}).horizon == 0.5
    assert spec.explain(trace, "it", {"T": 1000}).instant == 1
    assert [axis.name for axis in spec.space.axes] == ["T"]
    with pytest.raises(UsageError, match=naming("a = 1.5", "`[a, 1 s]`", "line 2 of a.stl", "1.5 s", "1 s")):
        spec.robustness(trace, {"T": 500, "a": 1.5})
