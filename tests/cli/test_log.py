"""``s2r log``: what a log holds, before anybody knows its names."""

import pytest

from tests.errors import states
from tests.logs import robot_logs


def topics(found):
    return {topic["name"]: topic for topic in found["topics"]}


def test_it_lists_topics_with_rates_and_gaps(s2r):
    robot_logs.ros2(s2r.folder / "bag", "MCAP")
    found = topics(s2r.json("log", "bag", code=0))
    odom, command = found["/odom"], found["/cmd_vel"]
    assert (odom["messages"], command["messages"]) == (400, 160)
    assert (odom["period"], command["period"]) == pytest.approx((0.02, 0.05))
    assert odom["span"] == pytest.approx(7.98)
    assert "/odom.twist.linear.x" in [field["name"] for field in odom["fields"]]
    shown = s2r("log", "bag", code=0).stdout
    assert states(shown, "/odom", "400 messages", "/cmd_vel.linear.x")


def test_it_needs_no_name_of_the_times_and_says_which_one_to_map(s2r):
    robot_logs.plotjuggler(s2r.folder / "drive.csv")
    found = s2r.json("log", "drive.csv", code=0)
    (table,) = found["topics"]
    assert {field["name"]: field["missing"] for field in table["fields"]} == {"/odom/vx": 80, "/cmd/vx": 320}
    assert any("--map t=__time" in note for note in found["notes"])
    assert any("--join" in note for note in found["notes"])


def test_it_counts_the_episodes_of_a_table(s2r):
    robot_logs.lerobot(s2r.folder / "data.parquet")
    (table,) = s2r.json("log", "data.parquet", code=0)["topics"]
    assert (table["messages"], table["episodes"]) == (300, 3)
    assert [run["messages"] for run in table["runs"]] == [100, 100, 100]
    assert states(s2r("log", "data.parquet", code=0).stdout, "1: 100 from", "3: 100 from")
    assert table["fields"][0] == {"name": "observation.state", "unit": None, "missing": 0, "components": 2}


@pytest.mark.parametrize(
    "name", ["night.mcap", "night.bag", "night.ulg", "night.h5", "night.mat", "night.txt"]
)
def test_what_is_no_log_is_a_sentence(s2r, name):
    (s2r.folder / name).write_bytes(b"\x00not a log\n" * 9)
    shown = s2r("log", name, code=2).stderr
    assert shown.startswith("error:")
    assert name in shown
    assert "Traceback" not in shown
