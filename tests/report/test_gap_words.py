"""Sentences on a gap: the worst test, the parts of the machine, and how far the gap shrinks."""

from dataclasses import replace

import numpy as np

import s2r_spec as s2r
from s2r_spec.diagnose.gap.held_out import compare
from s2r_spec.diagnose.residuals.shifts import Body, BodyPart, Shift
from s2r_spec.report.gap_words import body_words, gap_title, place_words, shrink_rows, where_words
from tests.report.made import SPACES, rollout, spec_of, where_in, where_of


def part_of(line):
    return line.partition(":")[0].partition("at ")[2]


def test_where_to_look_is_the_part_that_shifts_most_and_not_the_clearest():
    small = Shift("torque", 0, "rms", "N*m", 0.0, 2.0, 0.4, 0.4, 90.0, 1e-9, 1e-6)
    large = Shift("torque", 1, "rms", "N*m", 0.5, 1.0, 1.1, 1.1, 20.0, 1e-9, 1e-6)
    other = Shift("wrench", 0, "rms", "N", 0.0, 2.0, 9.0, 9.0, 10.0, 1e-9, 1e-6)
    parts = [BodyPart("RR thigh", (small,)), BodyPart("FL calf", (large,)), BodyPart("base", (other,))]
    _, plain = where_of(1)
    found = replace(plain, body=Body(tuple(parts), 10, 2.0, 100))
    assert "acts from 0.5 to 1 s at FL calf (torque)" in place_words((), found)
    assert [part_of(line) for line in body_words(found)] == ["RR thigh", "FL calf", "base"]
    clearer = [BodyPart(f"{leg} hip", (small,)) for leg in ("FL", "FR", "RL", "RR")]
    found = replace(plain, body=Body((*clearer, *parts), 10, 2.0, 100))
    lines = body_words(found)
    assert [part_of(line) for line in lines] == ["FL hip", "FR hip", "RL hip", "FL calf"]
    assert "1.1" in lines[-1]


def test_a_push_comes_before_the_motion_that_answers_it():
    push = Shift("wrench", 0, "mean", "N", 0.8, 0.85, 179.0, 180.0, 40.0, 1e-9, 1e-6)
    answer = Shift("wrench", 0, "mean", "N", 0.9, 1.4, 220.0, 225.0, 60.0, 1e-9, 1e-6)
    body = Body((BodyPart("arm", (answer,)), BodyPart("base", (push,))), 10, 2.0, 100)
    found = replace(where_of(1)[1], body=body)
    assert "acts from 0.8 to 0.85 s at base" in place_words((), found)
    assert [part_of(line) for line in body_words(found)] == ["base", "arm"]


def test_the_text_names_the_worst_of_all_tests_beside_that_of_those_that_were_run():
    _, place = where_of(2)
    spec = spec_of(2)
    assert "vd = 0 m/s, load = 0 kg: expected |Δρ| 0.050 ± 0.010 m" in where_words(place, spec)[-1]
    nowhere = where_words(replace(place, space=None), spec)
    assert nowhere == where_words(place, spec)[:-1]


def test_a_gap_that_a_fall_makes_is_in_no_window():
    _, place = where_of(2)
    pair = replace(
        place.pair, ended=-5.0, delta=place.pair.delta - 5.0, reason="the real rollout ended with 'fall'"
    )
    fallen = replace(place, pair=pair)
    assert place.pair.window in place.pair.windows()
    assert fallen.pair.window is None
    lines = where_words(fallen, spec_of(2))
    part = round(100 * pair.ended / pair.delta)
    (ended,) = [line for line in lines if "the real rollout ended with 'fall'" in line]
    assert ended.startswith(f"{part} % of it")
    assert not any(" to " in line and line.endswith(" s") for line in lines)


def test_small_gaps_are_not_rounded_to_nothing():
    tests = [{"vd": k / 9} for k in range(9)]
    rho = 1e-5 * np.linspace(1.0, 2.0, 9)
    far = compare(rho, [np.zeros(9), np.zeros(9)], tests, 1e-7, 0.0, "m")
    assert "in µm" in gap_title(far)
    assert dict(shrink_rows(far))["before"].startswith("15.0 (95 %: ")
    assert dict(shrink_rows(far))["before"].endswith("20.0 at the worst test")


def test_rho_at_the_worst_test_is_given_where_one_predicate_decides_it():
    spec = s2r.parse_spec(
        f"signal x {{m}}\n{SPACES[1]}\nrequire near: always[0, 1 s] (abs(x) <= 0.5)\n", "a.stl"
    )
    rng = np.random.default_rng(1)
    real, simulated = rollout(rng, 0.5), rollout(rng, 0.1)
    rhos = [spec.robustness(trace, {"vd": 0.5})["near"] for trace in (real, simulated)]
    found = where_in(spec, [{"vd": 0.5}], [real], [simulated])
    first = where_words(found, spec)[0]
    assert f"{rhos[1]:+.3g} m in simulation" in first
    assert f"{rhos[0]:+.3g} m on the real machine".replace("-", "−") in first
    assert "in simulation" not in where_words(replace(found, pair=replace(found.pair, delta=9.0)), spec)[0]
